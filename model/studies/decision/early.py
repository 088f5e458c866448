"""Compares stopping rules on the same streams of probabilities: how early they tell, and their errors.

`python -m touchd.model.studies early` asks the left-out networks about both studies, and the shipped
one about the challenge's test participants, in about two minutes; fills the tables and the figure of
docs/early.md, and what `scene.sure` costs in docs/decision.md.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sklearn.linear_model import Ridge
from sklearn.svm import OneClassSVM

from touchd.daemon.decide import EARLIEST_FRAMES, SURE, Decision, DecisionSettings, sure_above
from touchd.daemon.pipeline import STAGES
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.accuracy import PAPER_ACCURACY
from touchd.model.studies.decision.measure import Told
from touchd.model.studies.decision.report import MOST_HARMED
from touchd.model.studies.decision.streams import FRAMES, Streams, collect, collect_windows
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.training import haart, metrics, second_study

Frames = NDArray[np.int64]
Stops = NDArray[np.bool_]
# Errors that a second of waiting is worth.
PRICES = (0.02, 0.05, 0.1)
LEARN_EVERY = 9
MARKS = DecisionSettings().answer_at_frames
# Confidence after a second, of the falling one.
LIMITS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)


class RuleScore(msgspec.Struct, frozen=True, kw_only=True):
    """One setting of one rule. error: of the first answer told. harmed: touches whose right answer a mark
    replaces."""

    rule: str
    setting: str
    error: float
    mean_s: float
    median_s: float
    harmonic: float
    costs: tuple[float, ...]
    harmed: float


def score(rule: str, setting: str, streams: Streams, frames: Frames) -> RuleScore:
    """Score answers told after so many frames each, (N,)."""
    named = streams.named
    rows = np.arange(len(frames))
    told = named[rows, frames - 1].argmax(axis=1)
    error = float((told != streams.truth).mean())
    seconds = frames / FRAME_RATE_HZ
    earliness = 1 - float(frames.mean()) / FRAMES
    heard, harmed = told.copy(), np.zeros(len(told), bool)
    settings = DecisionSettings()
    for mark in (length for length in MARKS if length > EARLIEST_FRAMES):
        now = named[:, mark - 1]
        best, lead = now.argmax(axis=1), now.max(axis=1) - now[rows, heard]
        sure = now.max(axis=1) >= (0.0 if mark == MARKS[-1] else settings.speak_above)
        changes = (frames < mark) & (lead >= settings.revise_margin) & sure
        harmed |= changes & (heard == streams.truth) & (best != streams.truth)
        heard = np.where(changes, best, heard)
    return RuleScore(
        rule=rule,
        setting=setting,
        error=error,
        mean_s=float(seconds.mean()),
        median_s=float(np.median(seconds)),
        harmonic=2 * (1 - error) * earliness / (1 - error + earliness),
        costs=tuple(error + price * float(seconds.mean()) for price in PRICES),
        harmed=float(harmed.mean()),
    )


class Choice(msgspec.Struct, frozen=True, kw_only=True):
    """What one of the scene's choices costs. first: of what is told first."""

    early: str
    sure: str
    first_mean_s: float
    first_median_s: float
    first_right: float
    right: float
    settled_mean_s: float
    harmed: float


def main(arguments: Sequence[str]) -> int:
    """Compare the rules on both studies, fill the pages, say which choice the figures are for; returns 0."""
    parser = study_parser("early", None, "haart", "second-study", "docs")
    parser.add_argument("--weights", type=Path, default=SHIPPED_MODEL.parent, help="of the networks left out")
    chosen = parser.parse_args(arguments)
    recordings = {
        "HAART": haart.read_training(chosen.haart),
        "second study": second_study.takes(second_study.read(chosen.second_study)),
    }
    studies = {title: collect(of_one, chosen.weights) for title, of_one in recordings.items()}
    tested = collect_windows(haart.read_test(chosen.haart), Classifier.load())
    best = write(studies, tested, chosen.docs)
    sys.stdout.write(f"{chosen.docs / 'early.md'}; the figures are for scene.early: {best}\n")
    return 0


def write(studies: Mapping[str, Streams], tested: Streams, docs: Path) -> str:
    """Fill the pages in a folder from the streams of each study and of the challenge's test windows.

    Returns what `best_choice` says of the studies.
    """
    choices = {title: choices_of(streams) for title, streams in studies.items()}
    scores = {title: compare(streams) for title, streams in studies.items()}
    sure = sure_table(choices)
    challenge = challenge_of(tested)
    tables = {
        "touches": table(
            ("study", "people", "touches"),
            [(title, len(set(s.participants)), len(s.truth)) for title, s in studies.items()],
        ),
        "sure": sure,
        "rules": rules_table(scores),
        "challenge": table(
            ("confidence after a second", "told after, mean / median", "macro accuracy"),
            [
                (f"{limit:.2f}", f"{mean_s:.2f} / {median_s:.2f} s", f"{100 * right:.1f} %")
                for limit, mean_s, median_s, right in challenge
            ],
        ),
    }
    fill(docs / "early.md", tables)
    fill(docs / "decision.md", {"sure": sure}, others=("stages", "curve"))
    drawn = {title: (scores[title], choices[title]) for title in studies}
    draw(drawn, challenge, docs / "figures" / "early.png")
    return best_choice(choices)


def best_choice(choices: Mapping[str, Sequence[Choice]]) -> str:
    """Return the fastest `when_sure` that pays in every study, else `at_mark`.

    It pays when what is told first is right at least as often as at the mark, at most MOST_HARMED of touches
    are harmed, and the right answer that stays comes a third earlier.
    """

    def pays(place: int) -> bool:
        return all(
            choice.first_right >= rows[0].first_right
            and choice.harmed <= MOST_HARMED
            and choice.settled_mean_s <= rows[0].settled_mean_s * 2 / 3
            for rows in choices.values()
            for choice in [rows[place]]
        )

    sures = list(SURE)
    return next((f"when_sure, {sure}" for place, sure in enumerate(sures, 1) if pays(place)), "at_mark")


def compare(streams: Streams) -> list[RuleScore]:
    """Return every rule at every setting; rules that learn do so from the other people."""
    return [
        score(name, format(setting, shown), streams, _first(streams, rule(streams, setting)))
        for name, (rule, shown, settings) in RULES.items()
        for setting in settings
    ]


def challenge_of(tested: Streams) -> list[tuple[float, float, float, float]]:
    """Return how the challenge's test windows are answered, once sure.

    Confidence asked for after a second, mean and median seconds, macro accuracy as in the paper's table 3.
    """
    rows = []
    for limit in LIMITS:
        frames = _first(tested, _is_sure(tested.probabilities, limit))
        told = tested.probabilities[np.arange(len(frames)), frames - 1].argmax(axis=1)
        right = metrics.macro_accuracy(told, tested.truth, len(tested.labels))
        seconds = frames / FRAME_RATE_HZ
        rows.append((limit, float(seconds.mean()), float(np.median(seconds)), right))
    return rows


def heard(streams: Streams, settings: DecisionSettings) -> list[Told]:
    """Return what the robot would have been told of each touch, by the daemon's own decision."""
    told = []
    for said, truth, noticed in zip(streams.probabilities, streams.truth, streams.noticed, strict=True):
        decision = Decision(settings, streams.labels)
        due = dict(zip(settings.answer_at_frames, STAGES, strict=True))
        answers = []
        for frames in range(int(noticed) + 1, FRAMES + 1):
            probabilities = said[frames - 1].astype(np.float64)
            stage = due.get(frames)
            may = decision.may_be_early and "early" in due.values()
            if may and decision.is_sure(probabilities, frames):
                stage = "early"
            if stage is None:
                continue
            due = {length: name for length, name in due.items() if name != stage}
            answer = decision.answer(stage, probabilities)
            if answer.told:
                right = answer.gesture == streams.labels[truth]
                answers.append((stage, frames / FRAME_RATE_HZ, right))
        told.append(Told(tuple(answers)))
    return told


def choices_of(streams: Streams) -> list[Choice]:
    """Return what each of the scene's choices costs, `at_mark` first."""
    choices = []
    settings = [DecisionSettings(), *(DecisionSettings(early="when_sure", sure=sure) for sure in SURE)]
    for chosen in settings:
        told = heard(streams, chosen)
        first_s = [t.answers[0][1] for t in told if t.answers]
        settled_s = [t.settled_s for t in told if t.settled_s is not None]
        choices.append(
            Choice(
                early=chosen.early,
                sure=chosen.sure if chosen.early == "when_sure" else "",
                first_mean_s=float(np.mean(first_s)),
                first_median_s=float(np.median(first_s)),
                first_right=float(np.mean([t.right[0] for t in told if t.answers])),
                right=len(settled_s) / len(told),
                settled_mean_s=float(np.mean(settled_s)),
                harmed=float(np.mean([t.harmed for t in told])),
            )
        )
    return choices


def sure_table(choices: Mapping[str, Sequence[Choice]]) -> str:
    """Return what each of the scene's choices costs in seconds and in wrong answers."""
    rows = [
        (
            title,
            f"`{choice.early}`" + (f", `{choice.sure}`" if choice.sure else ""),
            f"{choice.first_mean_s:.2f} / {choice.first_median_s:.2f} s",
            f"{100 * choice.first_right:.1f} %",
            f"{100 * choice.right:.1f} %",
            f"{choice.settled_mean_s:.2f} s",
            f"{100 * choice.harmed:.1f} %",
        )
        for title, of_one in choices.items()
        for choice in of_one
    ]
    headings = ("study", "scene", "first told after, mean / median", "then right", "right at the end")
    return table((*headings, "right for good after, mean", "harmful changes"), rows)


def rules_table(studies: Mapping[str, Sequence[RuleScore]]) -> str:
    """Return each rule's settings that are cheapest at a price of waiting."""
    rows = [
        (
            title,
            entry.rule,
            entry.setting,
            f"{100 * entry.error:.1f} %",
            f"{entry.mean_s:.2f} / {entry.median_s:.2f} s",
            f"{entry.harmonic:.3f}",
            " / ".join(f"{cost:.3f}" for cost in entry.costs),
            f"{100 * entry.harmed:.1f} %",
        )
        for title, scores in studies.items()
        for entry in _cheapest(scores)
    ]
    costs = "cost at " + " / ".join(f"{price:g}" for price in PRICES) + " a second"
    headings = ("study", "rule", "setting", "wrong", "told after, mean / median", "harmonic mean", costs)
    return table((*headings, "harmful changes"), rows)


def _cheapest(scores: Sequence[RuleScore]) -> Iterator[RuleScore]:
    for name in RULES:
        own = [entry for entry in scores if entry.rule == name]
        yield from dict.fromkeys(own[place] for place in np.argmin([entry.costs for entry in own], axis=0))


def draw(
    studies: Mapping[str, tuple[Sequence[RuleScore], Sequence[Choice]]],
    challenge: Sequence[tuple[float, float, float, float]],
    path: Path,
) -> None:
    """Draw error over mean time: rules as curves, the paper's table 3 and `scene.sure` as dots."""
    figure = Figure(figsize=(4.6 * (len(studies) + 1), 4.4), layout="constrained")
    *panels, last = figure.subplots(1, len(studies) + 1, sharey=True)
    for axes, (title, (scores, choices)) in zip(panels, studies.items(), strict=True):
        for name in RULES:
            own = sorted((entry.mean_s, 100 * entry.error) for entry in scores if entry.rule == name)
            axes.plot(*zip(*own, strict=True), marker="*" if name == "oracle" else ".", label=name)
        for choice in choices:
            at = choice.first_mean_s, 100 * (1 - choice.first_right)
            axes.plot(*at, "rD")
            axes.annotate(choice.sure or "at_mark", at, textcoords="offset points", xytext=(5, 5), fontsize=8)
        axes.set(title=f"{title}, six gestures")
    curve = [(mean_s, 100 * (1 - right)) for _, mean_s, _, right in challenge]
    last.plot(*zip(*curve, strict=True), marker=".", label="falling confidence")
    paper = [(frames / FRAME_RATE_HZ, 100 - right) for frames, right in PAPER_ACCURACY.items()]
    last.plot(*zip(*paper, strict=True), "ks", label="the paper, fixed time")
    last.set(title="the challenge's test windows, seven gestures")
    for axes in (*panels, last):
        axes.legend(fontsize=7)
        axes.set(xlabel="mean time to the told answer, s", xlim=(0, 3))
    panels[0].set_ylabel("told wrong, %")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _first(streams: Streams, stops: Stops) -> Frames:
    """Return the frame at which each touch is told, (N,), from where a rule may stop."""
    stops = stops.copy()
    earliest = np.maximum(EARLIEST_FRAMES, streams.noticed + 1)
    stops[np.arange(FRAMES) < earliest[:, None] - 1] = False
    stops[:, -1] = True
    return np.asarray(stops.argmax(axis=1) + 1)


def _fixed(streams: Streams, length: int) -> Stops:
    return np.broadcast_to(np.arange(FRAMES) >= length - 1, streams.named.shape[:2])


def _confidence(streams: Streams, limit: float, patience: int = 1) -> Stops:
    best = np.where(streams.named.max(axis=2) >= limit, streams.named.argmax(axis=2), -1)
    stops: Stops = best >= 0
    for back in range(1, patience):
        stops[:, back:] &= best[:, back:] == best[:, :-back]
        stops[:, :back] = False
    return stops


def _is_sure(said: NDArray[np.float32], limit: float) -> Stops:
    """Return whether (N, FRAMES, labels) are sure after each frame, as the daemon has it."""
    limits = [sure_above(limit, frames) for frames in range(1, FRAMES + 1)]
    return np.asarray(said.max(axis=2) >= np.array(limits))


def _sequential(streams: Streams, limit: float) -> Stops:
    """Wald's test on the log odds of the two likeliest gestures, summed every sixth of a second."""
    logs = np.log(np.maximum(streams.named, 1e-6))
    return np.asarray(_lead((logs / LEARN_EVERY).cumsum(axis=1)) >= limit)


def _lead(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how far the greatest of (N, FRAMES, labels) is above the next."""
    top = np.sort(values, axis=2)
    return np.asarray(top[:, :, -1] - top[:, :, -2])


def _learnt(streams: Streams, price: float) -> Stops:
    """Stop where waiting does not pay, as learnt from other people (after CALIMERA, Bilski 2023)."""
    wrong = streams.named.argmax(axis=2) != streams.truth[:, None]
    stops = np.zeros(wrong.shape, bool)
    for learnt, held in _folds(streams):
        to_come = wrong[learnt, -1].astype(float)
        for frame in range(FRAMES - 1 - LEARN_EVERY, EARLIEST_FRAMES - 2, -LEARN_EVERY):
            features = _features(streams, frame)
            now = wrong[learnt, frame].astype(float)
            waiting = price * LEARN_EVERY / FRAME_RATE_HZ + to_come
            model = Ridge(alpha=1.0).fit(features[learnt], waiting - now)
            stops[held, frame] = model.predict(features[held]) >= 0
            to_come = np.where(model.predict(features[learnt]) >= 0, now, waiting)
    return stops


def _two_tiers(streams: Streams, patience: int) -> Stops:
    """A one-class SVM judges each answer; accepted equal ones in a row are told (TEASER, Schäfer 2020)."""
    best = streams.named.argmax(axis=2)
    frames = range(EARLIEST_FRAMES - 1, FRAMES, LEARN_EVERY)
    accepted = np.full(best.shape, -1)
    for learnt, held in _folds(streams):
        for frame in frames:
            features = _features(streams, frame)
            right = learnt & (best[:, frame] == streams.truth)
            if right.any():
                judge = OneClassSVM(nu=0.05, gamma="scale").fit(features[right])
                accepted[held, frame] = np.where(judge.predict(features[held]) > 0, best[held, frame], -1)
    stops: Stops = accepted >= 0
    for place, frame in enumerate(frames):
        for back in range(1, patience):
            stops[:, frame] &= place >= back and accepted[:, frame] == accepted[:, frame - back * LEARN_EVERY]
    return stops


def _oracle(streams: Streams, _: str) -> Stops:
    """Stop at the first frame after which the answer stays right, at once where it never does."""
    right = streams.named.argmax(axis=2) == streams.truth[:, None]
    for_good = np.logical_and.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(for_good | ~right[:, -1:])


RULES: Mapping[str, tuple[Callable[[Streams, Any], Stops], str, Iterable[Any]]] = {
    "fixed time": (_fixed, "g", (9, 27, 54, 72, 81, 108, 144)),
    "confidence": (_confidence, ".2f", np.arange(0.4, 0.96, 0.05)),
    "confidence for 5 frames": (partial(_confidence, patience=5), ".2f", np.arange(0.4, 0.96, 0.05)),
    "falling confidence": (lambda streams, limit: _is_sure(streams.named, limit), ".2f", LIMITS),
    "margin": (lambda streams, limit: _lead(streams.named) >= limit, ".2f", np.arange(0.1, 0.96, 0.1)),
    "sequential test": (_sequential, "g", (1, 2, 4, 8, 16, 32, 64)),
    "learnt trigger": (_learnt, "g", (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)),
    "two tiers": (_two_tiers, "g", (1, 2, 3, 4, 5)),
    "oracle": (_oracle, "", ("",)),
}
"""Each rule says where it may stop, (N, FRAMES), at a setting; how a setting is written, and those tried."""


def _features(streams: Streams, frame: int) -> NDArray[np.float32]:
    said = np.sort(streams.named[:, frame], axis=1)[:, ::-1]
    return np.column_stack([said, said[:, 0] ** 2, said[:, 0] - said[:, 1]])


def _folds(streams: Streams) -> Iterator[tuple[Stops, Stops]]:
    """Yield who is trained on and who is tested, each person once."""
    people = sorted(set(streams.participants))
    for start in range(min(4, len(people))):
        held = np.isin(streams.participants, people[start::4])
        yield ~held, held
