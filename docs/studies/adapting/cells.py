"""What the adapting study measures, cell by cell, and the file that it stands in."""

from __future__ import annotations

from pathlib import Path

import msgspec

from model.adapt.head import AdaptSettings

SHOTS = (1, 2, 4)
"""Recordings a gesture that are adapted to; all others of that person's that are in no draw's first four."""
DRAWS = 3
PULLS = (0.0, 2.0, 7.0, 20.0)
TEST_PARTICIPANTS = ("T1", "T2", "T9")
FILE_NAME = "adapt.json"


class Accuracy(msgspec.Struct, frozen=True, kw_only=True):
    """Macro accuracy by frames, and the calibration error after 144."""

    accuracy: dict[str, float]
    calibration_error: float


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One network adapted to `each` recordings a gesture of one participant that it never saw.

    own: that participant's other recordings; others: those of others that it never saw either. told: what
    the command says of its own left-out recordings after 144 frames, difference and interval; None where it
    says that it cannot tell.
    """

    participant: str
    draw: int
    each: int
    rehearsed: bool
    own_before: Accuracy
    own_after: Accuracy
    others_before: Accuracy
    others_after: Accuracy
    told: tuple[float, float, float] | None


class NewGesture(msgspec.Struct, frozen=True, kw_only=True):
    """One gesture that the last layer was made to forget, learnt anew from one participant; after 144 frames.

    right: share of the gesture's windows. others_before, others_after: macro accuracy over the others.
    """

    participant: str
    gesture: str
    each: int
    right: float
    others_before: float
    others_after: float


class Pull(msgspec.Struct, frozen=True, kw_only=True):
    """What another pull to the start would do, without HAART: changes of macro accuracy after 144 frames."""

    participant: str
    pull: float
    each: int
    own: float
    others: float


class OtherPad(msgspec.Struct, frozen=True, kw_only=True):
    """A participant on a pad, before and after adapting to others on that pad: macro accuracy by frames."""

    participant: str
    pad: str
    before: dict[str, float]
    after: dict[str, float]


class Measured(msgspec.Struct, kw_only=True):
    """Everything measured so far. done: participants of whom there is nothing left to measure."""

    settings: AdaptSettings
    done: list[str] = []
    cells: list[Trial] = []
    new_gestures: list[NewGesture] = []
    pulls: list[Pull] = []
    pads: list[OtherPad] = []

    def has(self, participant: str, draw: int, rehearsed: bool) -> bool:
        """Return whether a draw of a participant has been measured."""
        key = (participant, draw, rehearsed)
        return any((cell.participant, cell.draw, cell.rehearsed) == key for cell in self.cells)


def read(path: Path) -> Measured:
    """Read a file of figures."""
    return msgspec.json.decode(path.read_bytes(), type=Measured)


def write(study: Measured, path: Path) -> None:
    """Write a file of figures, one cell a line."""

    def text(value: object) -> str:
        return msgspec.json.encode(value).decode()

    fields = [f'"settings": {text(study.settings)}', f'"done": {text(study.done)}']
    for name in ("cells", "new_gestures", "pulls", "pads"):
        rows = ",\n".join(text(entry) for entry in getattr(study, name))
        fields.append(f'"{name}": [\n{rows}\n]')
    path.write_text("{" + ",\n".join(fields) + "}\n", encoding="utf-8")
