"""Prints what touchd reports to a NAO, and makes it answer a stroke: python react_to_touch.py nao.local

Polls ALMemory, since a callback would need a connection from the robot back to this computer, which NAT and
Docker prevent. For NAOqi 2.9: python react_to_touch.py tcps://pepper.local:9503 PASSWORD
With several pads the event is TouchGesture/PAD/Detail.
"""

import sys
import time

try:
    import qi
except ImportError:
    sys.exit("qi is not installed: pip install qi, on x86_64 with Python up to 3.12, or run on the robot")


class NaoqiPassword:
    """Logs in as NAOqi 2.9 asks."""

    def __init__(self, password):
        self._password = password

    def newAuthenticator(self):
        return self

    def initialAuthData(self):
        return {"user": "nao", "token": self._password}


if len(sys.argv) < 2:
    sys.exit("usage: python react_to_touch.py ADDRESS [PASSWORD], such as nao.local")
url = sys.argv[1] if "://" in sys.argv[1] else f"tcp://{sys.argv[1]}:9559"
qi.logging.setLevel(qi.logging.SILENT)
session = qi.Session()
if len(sys.argv) > 2:
    session.setClientAuthenticatorFactory(NaoqiPassword(sys.argv[2]))
try:
    session.connect(url)
except RuntimeError as error:
    sys.exit(f"{url}: {error}; is the robot on, and is this its address?")
memory = session.service("ALMemory")
speech = session.service("ALTextToSpeech")


def detail():
    """Return the last message; None before the first. No two are the same, also after touchd's restart."""
    try:
        return memory.getData("TouchGesture/Detail")
    except RuntimeError:
        return None


try:
    last = detail()
    print(f"{url}: waiting for touches", flush=True)
    while session.isConnected():
        new = detail()
        if new is not None and new != last:
            gesture, confidence, _, stage, touch, _ = last = new
            print(f"touch {touch}: {gesture} ({confidence:.0%}, {stage})", flush=True)
            if gesture == "stroke":
                speech.say("That is nice.")
        time.sleep(0.05)
except KeyboardInterrupt:
    sys.exit(0)
sys.exit(f"{url}: the robot has gone")
