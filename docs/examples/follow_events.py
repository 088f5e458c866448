"""Follows touchd's events: python follow_events.py, with options of `touchd run` such as -c touchd.yaml."""

import json
import shutil
import subprocess
import sys
from pathlib import Path


def touchd():
    """Return the program: on the PATH, beside this Python, or in this clone."""
    clone = Path(__file__).resolve().parent / "../../.venv/bin"
    for folder in (None, Path(sys.executable).parent, clone):
        if program := shutil.which("touchd", path=folder):
            return program
    sys.exit("touchd is neither on the PATH nor in .venv; in a clone, `make setup` makes it")


def events(*options):
    with subprocess.Popen([touchd(), "run", "--json", *options], stdout=subprocess.PIPE) as daemon:
        for line in daemon.stdout:
            if line.startswith(b"{"):
                yield json.loads(line)
            else:  # the text of --help
                print(line.decode(), end="")
    if daemon.returncode:
        sys.exit(daemon.returncode)


try:
    for event in events(*sys.argv[1:]):
        if event["type"] == "prediction" and event["told"]:
            print(f"touch {event['touch']}: {event['gesture']} ({event['confidence']:.0%})", flush=True)
except (KeyboardInterrupt, BrokenPipeError):
    pass
