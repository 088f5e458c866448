"""The fake pad: the daemon reads it as typed, without hardware."""

import json
import signal

from rigs.programs import TOUCHD, Program
from rigs.wait import WITHIN_S


def test_the_daemon_reads_a_fake_pad_and_recognises_its_hand() -> None:
    with Program(*TOUCHD, "fake-pad", "--gestures", "rub", "--every", "5") as pad:
        path = next(line.split()[1] for line in pad.stdout if line.startswith("pad: "))
        with Program(*TOUCHD, "run", "--json", "--port", path) as daemon:
            events = map(json.loads, daemon.stdout)
            assert next(event for event in events if event["type"] == "sensor")["state"] == "up"
            final = next(event for event in events if event.get("stage") == "final")
            assert final["gesture"] == "rub"
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(WITHIN_S) == 0
        pad.send_signal(signal.SIGINT)
        assert pad.wait(WITHIN_S) == 0


def test_an_unknown_gesture_is_refused_in_one_line() -> None:
    with Program(*TOUCHD, "fake-pad", "--gestures", "hug", stderr=-1) as pad:
        assert pad.wait(WITHIN_S) == 2
        assert pad.stderr is not None
        assert "'hug' is none of constant, notouch, pat" in pad.stderr.read()
