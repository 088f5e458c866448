"""What `touchd teach` and labels gain for touches in passing: `python -m touchd.model.studies teaching`.

One person at a time: a network that never saw the person learns from two set-ups of that person (what is
under and over the pad), and is scored on touches in passing in the person's other set-ups, played through the
daemon's pipeline, and on windows of those recordings.
"""

import random
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import onnx
from rich.console import Console
from rich.table import Table
from torch import nn
from tqdm import tqdm

from touchd.drivers.recording import Recording, ideal_clock_ms, set_up
from touchd.model.adapt.adapt import Pretrained, logits, rehearsal
from touchd.model.adapt.backbone import CropFeatures, WindowFeatures, crops, windows
from touchd.model.adapt.head import AdaptSettings, fit
from touchd.model.adapt.measure import mean_interval
from touchd.model.adapt.optimise import one_torch_thread
from touchd.model.adapt.passing import IN_PASSING, InPassing
from touchd.model.adapt.ship import grafted
from touchd.model.classifier import Classifier
from touchd.model.studies.folders import study_parser
from touchd.model.studies.sessions.passing import PassingSession, PassingTouch, measure, rows, sessions
from touchd.model.training import checkpoint, haart
from touchd.model.training.recipe import fold_jobs, read_recipe
from touchd.model.training.ship import remember
from touchd.model.training.studies import Folders, study_of
from touchd.model.training.train import CHECKPOINT_NAME
from touchd.model.training.weights import fold_path

LEARNT_SET_UPS, SCORED_SET_UPS = 2, 4
DRAWS = 2
LONG_FRAMES = 324
"""Six seconds, as `teach` records."""
BEFORE_FRAMES, AFTER_FRAMES = 27, 43
LABELS = 10
FRAMES = 144
BEFORE, LONG, SINGLE, LABELLED = "before", "teach without single touches", "teach", "ten labels"


class Taught(msgspec.Struct, frozen=True, kw_only=True):
    """One network after learning `how` from one person; percent.

    mix, named: right of all touches in passing, and of those named. pat, stroke: right of single ones.
    windows: right after 2.67 s. others: the same two figures' mean gains for people it learnt nothing from.
    """

    participant: str
    draw: int
    how: str
    mix: float
    named: float
    pat: float
    stroke: float
    windows: float
    others_passing: float = 0.0
    others_windows: float = 0.0


@dataclass(frozen=True, eq=False)
class Other:
    """Features of the people whom neither the network nor the head has seen."""

    windows: WindowFeatures
    passing: WindowFeatures
    truth: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, pretrained: Pretrained, recordings: Sequence[Recording]) -> "Other":
        passing = [touch for session in sessions(recordings) for touch in touches_of(session)]
        whole = windows(pretrained.backbone, recordings)[FRAMES]
        short = windows(pretrained.backbone, passing)[IN_PASSING]
        labels = pretrained.labels
        return cls(
            whole,
            short,
            (
                np.array([labels.index(recordings[i].gesture) for i in whole.recordings]),
                np.array([labels.index(passing[i].gesture) for i in short.recordings]),
            ),
        )

    def right(self, head: nn.Sequential) -> tuple[float, float]:
        """Return the percentages right of touches in passing, and of windows."""
        shares = [
            100.0 * float((logits(head, own).argmax(axis=1) == truth).mean())
            for own, truth in zip((self.windows, self.passing), self.truth, strict=True)
        ]
        return shares[1], shares[0]


def touches_of(session: PassingSession, mix_only: bool = True) -> list[InPassing]:
    """Return the touches of a session as the daemon would save them, labelled."""
    return [_saved(session, touch) for touch in session.touches if touch.is_in_mix or not mix_only]


def _saved(session: PassingSession, touch: PassingTouch) -> InPassing:
    counts = session.counts[touch.start - BEFORE_FRAMES : touch.stop + AFTER_FRAMES]
    clock_ms = ideal_clock_ms(len(counts))
    over = BEFORE_FRAMES + touch.stop - touch.start
    who = (session.participant, "none", "none")
    return InPassing(*who, touch.gesture, counts, clock_ms, "live", first=BEFORE_FRAMES, over=over)


def lessons(recordings: Sequence[Recording], rng: random.Random) -> dict[str, list[Recording]]:
    """Return what is learnt in each way from the recordings of a few set-ups of one person."""
    long = [
        replace(each, counts=each.counts[:LONG_FRAMES], sensor_ms=each.sensor_ms[:LONG_FRAMES])
        for each in recordings
    ]
    kept = [
        list(zip(session.touches, touches_of(session, mix_only=False), strict=True))
        for session in sessions(recordings)
    ]
    single = [
        saved
        for session in kept
        for touch, saved in session
        if touch.kind == "one" and touch.gesture in ("pat", "stroke")
    ]
    mixed = [saved for session in kept for touch, saved in session if touch.is_in_mix]
    return {
        LONG: long,
        SINGLE: [*long, *single],
        LABELLED: rng.sample(mixed, min(LABELS, len(mixed))),
    }


def taught(
    name: str,
    own: Sequence[Recording],
    others: Sequence[Recording],
    base: Path,
    pretrained: Pretrained,
    rehearsed: CropFeatures,
    settings: AdaptSettings,
) -> Iterator[Taught]:
    """Yield every trial of one person."""
    conditions = sorted({set_up(each) for each in own})
    other = Other.of(pretrained, others) if others else None
    was = other.right(pretrained.head) if other else (0.0, 0.0)
    for number in range(DRAWS):
        rng = random.Random(f"{name} {number}")
        drawn = rng.sample(conditions, min(LEARNT_SET_UPS + SCORED_SET_UPS, len(conditions)))
        learnt = [each for each in own if set_up(each) in drawn[:LEARNT_SET_UPS]]
        scored = [each for each in own if set_up(each) in drawn[LEARNT_SET_UPS:]]
        held = windows(pretrained.backbone, scored)[FRAMES]
        truth = np.array([pretrained.labels.index(scored[i].gesture) for i in held.recordings])
        for how, shown in {BEFORE: [], **lessons(learnt, rng)}.items():
            head = _learnt(pretrained, shown, rehearsed, settings) if shown else pretrained.head
            gain = other.right(head) if other else (0.0, 0.0)
            right = logits(head, held).argmax(axis=1) == truth
            scores = rows(measure(scored, _classifier(base, head)))
            yield Taught(
                participant=name,
                draw=number,
                how=how,
                mix=scores["mix"].right,
                named=scores["mix"].right_of_named,
                pat=scores["pat, one"].right if "pat, one" in scores else 0.0,
                stroke=scores["stroke, one"].right if "stroke, one" in scores else 0.0,
                windows=round(100.0 * float(right.mean()), 1),
                others_passing=round(gain[0] - was[0], 2),
                others_windows=round(gain[1] - was[1], 2),
            )


def _learnt(
    pretrained: Pretrained, shown: Sequence[Recording], rehearsed: CropFeatures, settings: AdaptSettings
) -> nn.Sequential:
    features = crops(pretrained.backbone, shown, pretrained.augmentation, settings.crops, settings.seed)
    return fit(pretrained.head, pretrained.labels, [], features, rehearsed, settings)


def _classifier(base: Path, head: nn.Sequential) -> Classifier:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "adapted.onnx")
        onnx.save(grafted(base, head, Classifier.load(base).metadata), path)
        return Classifier.load(path)


def trials(folders: Folders, runs: Path, settings: AdaptSettings) -> Iterator[Taught]:
    """Yield the trials of everybody with enough set-ups, in HAART and the second study."""
    takes = folders.to_train_on(("haart", "second"))
    for job in fold_jobs(read_recipe()):
        left_out = job.settings.left_out
        if not (runs / job.name / CHECKPOINT_NAME).exists():
            continue
        saved = checkpoint.load(runs / job.name / CHECKPOINT_NAME)
        base = fold_path(Path(__file__).parents[1] / "weights", left_out)
        remembered = remember(saved, folders)
        pretrained = Pretrained.of(base, saved.network, remembered)
        rehearsed = rehearsal(remembered, pretrained.labels, haart.GESTURES, settings.seed)
        unseen = haart.only(takes, left_out)
        for name in tqdm(sorted({each.participant for each in unseen}), desc=job.name):
            own = [each for each in unseen if each.participant == name]
            if len({set_up(each) for each in own}) <= LEARNT_SET_UPS:
                continue
            others = [each for each in unseen if each.participant != name]
            yield from taught(name, own, others, base, pretrained, rehearsed, settings)


def summary(measured: Sequence[Taught]) -> list[tuple[object, ...]]:
    """Return the page's rows: the mean over people, and the interval of the change."""
    found: list[tuple[object, ...]] = []
    for group, study in (("second study", "second"), ("HAART", "haart")):
        own = [trial for trial in measured if study_of(trial.participant) == study]
        people = sorted({trial.participant for trial in own})

        def mean(
            how: str, figure: str, own: Sequence[Taught] = own, people: Sequence[str] = people
        ) -> np.ndarray:
            return np.array(
                [
                    np.mean([getattr(t, figure) for t in own if t.participant == who and t.how == how])
                    for who in people
                ]
            )

        for how in (BEFORE, LONG, SINGLE, LABELLED):
            interval = mean_interval((mean(how, "mix") - mean(BEFORE, "mix")) / 100.0)
            change = "" if interval is None else f"{100 * interval[0]:+.1f} to {100 * interval[1]:+.1f}"
            found.append(
                (
                    group,
                    how,
                    *(f"{mean(how, figure).mean():.1f}" for figure in ("mix", "pat", "stroke")),
                    change,
                    f"{mean(how, 'windows').mean():.1f}",
                    f"{mean(how, 'others_passing').mean():+.1f}",
                )
            )
    return found


HEADINGS = ("people", "learnt from", "in passing", "one pat", "one stroke", "change", "2.67 s", "others")


def main(arguments: Sequence[str]) -> int:
    """Measure everybody and print a table; returns 0."""
    parser = study_parser("teaching", __doc__, "haart", "second-study", "third-study")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="the recipe's checkpoints (runs)")
    options = parser.parse_args(arguments)
    with one_torch_thread():
        folders = Folders(options.haart, options.second_study, options.third_study)
        measured = tuple(trials(folders, options.runs, AdaptSettings()))
    shown = Table(*HEADINGS, title="right, percent; change of touches in passing: 95 % interval over people")
    for row in summary(measured):
        shown.add_row(*map(str, row))
    Console(width=110).print(shown)
    return 0
