"""Measures all figures of detection and answers in use, in one file: `python -m touchd.model.studies tables`.

They decide on a change: sessions, also disturbed; streams of another pad; touches in passing; hands that
change; a firm pad; how soon a touch is found. Networks never saw the people, except for pads never met.
Results are stored one by one, so an interrupted run resumes. `--against FILE` prints what differs.

`detection` measures only the tracker, in minutes. Both fill tables of sessions.md.
"""

import argparse
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from touchd.daemon.path.events import Event, TouchBegan, epoch_s
from touchd.daemon.path.pipeline import PipelineSettings
from touchd.daemon.path.tracker import SENSITIVITIES, TouchSettings
from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, Counts
from touchd.model.classifier import Classifier
from touchd.model.studies.cases import Case, spliced
from touchd.model.studies.checks.evaluate import Split
from touchd.model.studies.folders import (
    HELD_OUT,
    SECOND,
    STUDIES,
    TEST,
    THIRD,
    folders_of,
    never_seen,
    study_parser,
)
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import DEFAULT, Player, detect, frames_of, play
from touchd.model.studies.results import STORED, Results
from touchd.model.studies.sessions import changes, firm_pad, passing, streams
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.training import second_study
from touchd.model.training.weights import FABRIC_MODEL, left_out_split

FILE, DETECTION_FILE = STORED / "tables.json", STORED / "detection.json"
DISTURBED = {
    "noise": SessionSettings(noise=1.5),
    "hum": SessionSettings(hum=2.0),
    "motor": SessionSettings(motor=2.0),
    "breathing": SessionSettings(breathing=2.0),
}
FIRM_RATES = ((12.0, 54.0), (8.0, 54.0), (12.0, 12.0))
"""How fast the firm pad's recordings ran, and how many frames a second are sent."""
NOISE_COUNTS = 1.0
PLAIN = SessionSettings()
ANSWERS = {"early", "revised", "final", "last", "first", "harmful", "t_first", "named", "right"}
"""Figures of answers, which the tracker alone does not give."""
Figures = dict[str, Any]
Table = Iterator[tuple[str, Callable[[], Figures]]]


def session_figures(split: Split, settings: SessionSettings, player: Player = play) -> Figures:
    """Play a session for each person and condition, and score them together."""
    played = [
        judge(session, player(frames_of(session.counts), model))
        for model, own in split
        for session in sessions(own, settings)
    ]
    return msgspec.structs.asdict(score(played))


def passing_figures(split: Split) -> Figures:
    """Score the touches of a visitor; see `passing.MIXED`."""
    outcomes = [outcome for model, own in split for outcome in passing.measure(own, model)]
    return msgspec.structs.asdict(passing.score([outcome for outcome in outcomes if outcome.touch.is_in_mix]))


def delay_figures(split: Split, player: Player, settings: PipelineSettings = DEFAULT) -> Figures:
    """Return how long after the first visible pressure a touch is reported, with the rest levelled."""
    delays_ms: list[float] = []
    missed = 0
    cases = [(model, case) for model, own in split for case in spliced(own, level_rest=True)]
    for model, case in cases:
        began = [epoch_s(event.time) for event in _begun(player(frames_of(_read(case)), model, settings))]
        found = [at_s for at_s in began if at_s * FRAME_RATE_HZ >= case.start]
        missed += not found
        if found:
            visible_s = (case.visible_at or case.start) / FRAME_RATE_HZ
            delays_ms.append(max(0.0, 1000.0 * (found[0] - visible_s)))
    median, most = np.quantile(delays_ms, [0.5, 0.9])
    return {
        "touches": len(cases),
        "missed": missed,
        "late": sum(ms > 1000.0 for ms in delays_ms),
        "median_ms": round(float(median), 1),
        "p90_ms": round(float(most), 1),
    }


def _read(case: Case) -> Counts:
    """Return what the pad reads until the gesture ends."""
    counts: Counts = np.clip(np.rint(case.scans[: case.stop]), 0, MAX_COUNT).astype(np.uint16)
    return counts


def _begun(events: Iterable[Event]) -> list[TouchBegan]:
    return [event for event in events if isinstance(event, TouchBegan)]


def false_in_10_min(split: Split, player: Player, settings: PipelineSettings = DEFAULT) -> float:
    """Return the false touches in ten minutes of notouch on a noisier pad."""
    rng, began, minutes = np.random.default_rng(0), 0, 0.0
    for model, recordings in split:
        for scans in (one.counts for one in recordings if one.gesture == NO_TOUCH):
            noisy = (scans + NOISE_COUNTS * rng.normal(size=scans.shape)).clip(0).round()
            began += len(_begun(player(frames_of(noisy.astype(np.uint16)), model, settings)))
            minutes += len(scans) / FRAME_RATE_HZ / 60.0
    return round(10.0 * began / minutes, 2)


class Tables:
    """The recordings, the networks that never saw their people, and what `player` makes of them."""

    def __init__(self, options: argparse.Namespace, player: Player) -> None:
        folders, weights = folders_of(options), options.weights
        self._third, self._firm, self._player = folders.third_study, options.firm_pad, player
        self._splits = never_seen(folders, weights)
        self._robot = left_out_split(weights, second_study.read(folders.second_study))
        self._fabric = Classifier.load(weights / FABRIC_MODEL.name)

    def detection(self) -> Table:
        """Yield the rows that begin with how touches are found."""
        test, held_out = self._splits[TEST], self._splits[HELD_OUT]
        yield from self._sessions("sessions/HAART test", test)
        yield from self._sessions("sessions/HAART", held_out)
        for words, substrate in (("robot still", "static"), ("robot breathes", "dynamic")):
            some = [
                (model, [each for each in own if each.substrate == substrate]) for model, own in self._robot
            ]
            yield from self._sessions(f"sessions/{words}", some)
        for name, settings in DISTURBED.items():
            yield from self._sessions(f"{name}/HAART test", test, settings)
            yield from self._sessions(f"{name}/HAART", held_out, settings)
        models = streams.held_out()
        for rest, name in ((0, "held out"), (60, "held out, rests at 60")):
            yield f"streams/{name}", partial(self._streams, models, rest)
        yield "streams/never met", partial(self._streams, dict.fromkeys(models, self._fabric), 0)
        if self._firm is not None:
            for hz, rate_hz in FIRM_RATES:
                yield f"firm pad/{hz:g} Hz sent at {rate_hz:g}", partial(self._firm_pad, hz, rate_hz)
        yield "found after/HAART test", partial(delay_figures, test, self._player)
        yield "found after/HAART", partial(delay_figures, held_out, self._player)

    def answers(self) -> Table:
        """Yield the rows that need the whole pipeline."""
        names = {"HAART test": TEST, "HAART": HELD_OUT, "second study": SECOND, "third study": THIRD}
        for name, key in names.items():
            yield f"passing/{name}", partial(passing_figures, self._splits[key])
        for name in ("HAART test", "HAART", "second study"):
            yield f"changes/{name}", partial(self._changes, self._splits[names[name]])
        yield "noise of one count/HAART", self._false

    def sensitivities(self) -> Table:
        """Yield what each `touch.sensitivity` costs people held out."""
        for level in SENSITIVITIES:
            yield f"sensitivity/{level}", partial(self._sensitivity, TouchSettings(sensitivity=level))

    def _sessions(self, name: str, split: Split, settings: SessionSettings = PLAIN) -> Table:
        yield name, partial(session_figures, split, settings, self._player)

    def _streams(self, models: dict[str, Classifier], rest: int) -> Figures:
        return msgspec.structs.asdict(streams.measure(self._third, models, rest, self._player))

    def _firm_pad(self, hz: float, rate_hz: float) -> Figures:
        ((shipped, _),) = self._splits[TEST]
        return msgspec.structs.asdict(firm_pad.measure(self._firm, shipped, hz, rate_hz, self._player))

    def _changes(self, split: Split) -> Figures:
        return msgspec.structs.asdict(changes.measure(split))

    def _false(self) -> Figures:
        ((shipped, _),) = self._splits[TEST]
        everybody = [each for _, own in self._splits[HELD_OUT] for each in own]
        return {"false_in_10_min": false_in_10_min([(shipped, everybody)], self._player)}

    def _sensitivity(self, touch: TouchSettings) -> Figures:
        split, settings = self._splits[HELD_OUT], PipelineSettings(touch=touch)
        false = false_in_10_min(split, self._player, settings)
        return {**delay_figures(split, self._player, settings), "false_with_noise": false}


def sensitivity_table(results: Results) -> dict[str, str]:
    """Return the table of docs/sessions.md that `detection` fills."""
    found = {level: results.get(f"sensitivity/{level}") for level in SENSITIVITIES}
    rows = [
        (
            level,
            own["missed"],
            own["late"],
            f"{own['median_ms']:g} / {own['p90_ms']:g}",
            own["false_with_noise"],
        )
        for level, own in found.items()
    ]
    headings = ("missed", "over 1 s late", "found after, median / p90 ms", "false with noise")
    return {"sensitivity": table(("`touch.sensitivity`", *headings), rows)}


def session_tables(results: Results) -> dict[str, str]:
    """Return the tables of docs/sessions.md that `tables` fills."""
    people = {
        "HAART's test people": "HAART test",
        "HAART held out": "HAART",
        "robot still": "robot still",
        "robot breathes": "robot breathes",
    }
    in_use = [results.get(f"sessions/{key}") for key in people.values()]
    figures = {
        "touches": "{n}",
        "missed": "{missed:g}",
        "merged / split": "{merged:g} / {split:g}",
        "right at the final answer": "{final:g}",
        "right in what was told last": "{last:g}",
        "told right, then wrong": "{harmful:g}",
        "false touches": "{false:g}",
    }
    rows = [(words, *(form.format(**own) for own in in_use)) for words, form in figures.items()]
    disturbed = {
        "noise of 1.5 counts": "noise",
        "mains hum of 2 counts": "hum",
        "a motor of 23 Hz, 2 counts": "motor",
        "breathing, 2 counts": "breathing",
    }
    form = "{missed:g} | {merged:g} / {split:g} | {final:g} | {false:g}"
    others = [(words, form.format(**results.get(f"{key}/HAART"))) for words, key in disturbed.items()]
    headings = ("disturbance", "missed", "merged / split", "right at the final answer", "false touches")
    return {"in-use": table(("", *people), rows), "disturbed": table(headings, others)}


def differences(now: Results, before: Results) -> Iterator[str]:
    """Yield a line for each row of which a figure differs."""
    for key in filter(before.has, now.find()):
        old, new = before.get(key), now.get(key)
        names = [name for name in new if name in old and old[name] != new[name]]
        if names:
            yield f"{key}: {', '.join(f'{name} {old[name]} -> {new[name]}' for name in names)}"


def main(arguments: Sequence[str]) -> int:
    """Measure what is not stored yet, print what differs; returns 0."""
    options = _options("tables", "Measures all figures of detection and answers in use.", arguments)
    tables = Tables(options, play)
    results = _measure(options, FILE, chain(tables.detection(), tables.answers()))
    if not options.only:
        fill(options.docs / "sessions.md", session_tables(results))
    return 0


def detection(arguments: Sequence[str]) -> int:
    """Measure what the tracker alone decides, where it is not stored yet, and fill the page; returns 0."""
    options = _options("detection", "Measures how well touches are detected.", arguments)
    tables = Tables(options, detect)
    found = ((name, partial(_only_found, figures)) for name, figures in tables.detection())
    results = _measure(options, DETECTION_FILE, chain(found, tables.sensitivities()))
    if not options.only:
        fill(options.docs / "sessions.md", sensitivity_table(results))
    return 0


def _measure(options: argparse.Namespace, file: Path, rows: Table) -> Results:
    results = Results(options.out or file)
    results.measure(row for row in rows if row[0].startswith(options.only))
    if options.against is not None:
        sys.stdout.writelines(f"{line}\n" for line in differences(results, Results(options.against)))
    return results


def _only_found(figures: Callable[[], Figures]) -> Figures:
    """Return the figures without those of answers, which the tracker alone does not give."""
    return {name: figure for name, figure in figures().items() if name not in ANSWERS}


def _options(name: str, what: str, arguments: Sequence[str]) -> argparse.Namespace:
    parser = study_parser(name, what, *STUDIES, "docs", "weights", "firm-pad")
    parser.add_argument(
        "--out", type=Path, help="where to store the figures; model/studies/stored without it"
    )
    parser.add_argument("--against", type=Path, help="an older file to compare with")
    parser.add_argument("--only", default="", help="rows whose names begin with this")
    # The daemon's log would report on every session.
    logging.disable()
    return parser.parse_args(arguments)
