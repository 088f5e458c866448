"""What each constant of detection does: `python -m touchd.model.studies constants`.

Each constant is halved and doubled while a sample of the studies is played; the table lists the figures that
move by half a point. One of SAMPLE sessions and streams is played, so half a point is less than one touch: a
figure that moves is a hint; one that stays proves nothing. Results are stored, so an interrupted run resumes.
Values computed when a module is imported, and defaults of settings, do not follow.
"""

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import monotonic
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path import monitor, pipeline
from touchd.daemon.path.events import Event, SensorEvent
from touchd.daemon.path.tracker import baseline, loose_wire, network_check, tracker
from touchd.drivers.pad import vibration
from touchd.model.classifier import SHIPPED_MODEL, Classifier, ModelState
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.results import STORED, Results
from touchd.model.studies.sessions import passing, streams
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.training import haart, second_study

FILE = STORED / "constants.json"
DETECTION = ("HAART", "robot", "hum", "breathing", "third study", "passing")
GROUPS: dict[ModuleType, tuple[str, ...]] = {
    tracker: DETECTION,
    baseline: DETECTION,
    network_check: DETECTION,
    loose_wire: ("robot", "breathing"),
    monitor: ("HAART", "robot", "noise"),
    vibration: ("hum", "motor"),
}
"""What is played for a module's constants."""
# Lengths of arrays, and units.
FIXED = {
    "TAXELS",
    "SECOND_FRAMES",
    "SMOOTH_FRAMES",
    "STRIDE_FRAMES",
    "WINDOW_FRAMES",
    "LOOK_FRAMES",
    "LINE_TAXELS",
}
FACTORS = {"halved": 0.5, "doubled": 2.0}
SAMPLE = 12
MOVED = 0.5
DISTURBED = {
    "noise": SessionSettings(noise=1.5),
    "hum": SessionSettings(hum=2.0),
    "motor": SessionSettings(motor=2.0),
    "breathing": SessionSettings(breathing=2.0),
}
FIGURES = ("missed", "merged", "split", "open", "false")
Figures = dict[str, float]


@dataclass(frozen=True)
class Remembering(Classifier):
    """Asks a network about each window once, and names no gesture."""

    answers: dict[bytes, NDArray[np.float64]] = field(default_factory=dict)

    def probabilities(self, frames: NDArray[np.generic]) -> NDArray[np.float64]:
        key = frames.tobytes()
        if key not in self.answers:
            self.answers[key] = super().probabilities(frames)
        return self.answers[key]

    def step(
        self, frames: NDArray[np.generic], state: ModelState | None = None
    ) -> tuple[NDArray[np.float64], ModelState]:
        return np.full(len(self.labels), 1 / len(self.labels)), {}


class Sample:
    """The sessions and streams that are played."""

    def __init__(self, haart_folder: Path, second: Path, third: Path) -> None:
        test = haart.realigned(haart.read_test(haart_folder))
        robot = second_study.read(second)
        plain = SessionSettings()
        self._sessions = {"HAART": _some(sessions(test, plain)), "robot": _some(sessions(robot, plain))}
        for name, settings in DISTURBED.items():
            self._sessions[name] = _some(sessions(test, settings))
        self._streams, self._passing = _some(streams.read(third)), _some(passing.sessions(test))
        loaded = Classifier.load(SHIPPED_MODEL)
        self.model = Remembering(loaded.metadata, loaded.session, loaded.states)

    def measure(self, groups: Sequence[str]) -> Figures:
        """Play these groups; return their figures."""
        figures: Figures = {}
        for group in groups:
            if group in self._sessions:
                planned = self._sessions[group]
                played = [(each, play(frames_of(each.counts), self.model, flush=True)) for each in planned]
                result = score([judge(session, events) for session, events in played])
                figures |= {f"{group}, {name}": getattr(result, name) for name in FIGURES}
                figures[f"{group}, called unwell"] = _unwell([events for _, events in played])
            elif group == "passing":
                fates = passing.score(passing.played(self._passing, self.model))
                figures |= {"passing, missed": fates.missed, "passing, several": fates.several}
            else:
                told = streams.score([(each, streams.play(each, self.model)) for each in self._streams])
                figures[f"{group}, missed"] = 100 * told.missed / max(1, told.touched)
                figures[f"{group}, several"] = 100 * told.several / max(1, told.touched)
        return figures


def _some(all_of_them: Iterator[Any]) -> list[Any]:
    return list(all_of_them)[::SAMPLE]


def _unwell(played: Sequence[Sequence[Event]]) -> float:
    """Return the percentage of sessions in which the pad was called degraded or down."""
    unwell = [any(isinstance(one, SensorEvent) and one.state != "up" for one in events) for events in played]
    return 100.0 * sum(unwell) / len(unwell)


def constants(module: ModuleType) -> list[str]:
    """Return the names of a module's own numbers."""
    source = Path(module.__file__ or "").read_text(encoding="utf-8")
    own = {
        name for names in re.findall(r"^([A-Z_, ]+) = ", source, re.MULTILINE) for name in names.split(", ")
    }
    return sorted(name for name in own - FIXED if type(getattr(module, name, None)) in (int, float))


@contextmanager
def varied(module: ModuleType, name: str, factor: float) -> Iterator[None]:
    """Multiply a constant wherever it is imported."""
    value = getattr(module, name)
    other = type(value)(max(1, round(value * factor)) if isinstance(value, int) else value * factor)
    holders = [each for each in (*GROUPS, pipeline) if getattr(each, name, None) is value]
    for each in holders:
        setattr(each, name, other)
    try:
        yield
    finally:
        for each in holders:
            setattr(each, name, value)


def _measured(results: Results, key: str, measure: Callable[[], Figures]) -> None:
    if not results.has(key):
        since = monotonic()
        try:
            values: dict[str, Any] = measure()
        except (ValueError, IndexError, ZeroDivisionError) as error:
            values = {"error": str(error)}
        results.put(key, values, monotonic() - since)


def moved(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Return the figures that moved, with their change."""
    if "error" in after:
        return "does not run"
    changes = {name: after[name] - value for name, value in before.items()}
    return "; ".join(f"{name} {change:+.1f}" for name, change in changes.items() if abs(change) >= MOVED)


def tables(results: Results) -> dict[str, str]:
    """Return the table of docs/sessions.md by its place, of what is stored."""
    rows, unmoved = [], []
    for module, groups in GROUPS.items():
        for name in constants(module):
            keys = [_key(module, name, how) for how in FACTORS]
            if all(results.has(key) for key in keys):
                before = results.get(_shipped(groups))
                cells = [moved(before, results.get(key)) for key in keys]
                if any(cells):
                    rows.append((f"`{name}`", getattr(module, name), *cells))
                else:
                    unmoved.append(f"`{name}`")
    rows.append((", ".join(unmoved), "", "none", "none"))
    return {"constants": table(("constant", "value", *FACTORS), rows)}


def _shipped(groups: Sequence[str]) -> str:
    return f"as shipped/{', '.join(groups)}"


def _key(module: ModuleType, name: str, how: str) -> str:
    return f"{module.__name__.rpartition('.')[2]}.{name}/{how}"


def main(arguments: Sequence[str]) -> int:
    """Measure what is not stored yet, and fill the table; returns 0."""
    takes = ("haart", "second-study", "third-study", "docs")
    parser = study_parser("constants", "Halves and doubles each constant of detection.", *takes)
    chosen = parser.parse_args(arguments)
    logging.disable()
    sample = Sample(chosen.haart, chosen.second_study, chosen.third_study)
    results = Results(FILE)
    for module, groups in GROUPS.items():
        measure = partial(sample.measure, groups)
        _measured(results, _shipped(groups), measure)
        for name in constants(module):
            for how, factor in FACTORS.items():
                with varied(module, name, factor):
                    _measured(results, _key(module, name, how), measure)
    fill(chosen.docs / "sessions.md", tables(results))
    return 0
