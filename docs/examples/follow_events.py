"""Follows touchd's events: python follow_events.py, with options of `touchd run` such as -c touchd.yaml."""

import json
import subprocess
import sys


def events(*options):
    with subprocess.Popen(["touchd", "run", "--json", *options], stdout=subprocess.PIPE) as daemon:
        yield from map(json.loads, daemon.stdout)


for event in events(*sys.argv[1:]):
    if event["type"] == "prediction" and event["told"]:
        print(f"touch {event['touch']}: {event['gesture']} ({event['confidence']:.0%})", flush=True)
