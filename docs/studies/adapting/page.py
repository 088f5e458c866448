"""The page on adapting: how it is used, and the study's figures as tables and a picture for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from docs.studies.adapting.cells import DRAWS, KS, TEST_PARTICIPANTS, Study
from docs.studies.adapting.figures import (
    Gain,
    Spread,
    gains,
    new_gesture_rows,
    pad_rows,
    pull_rows,
    verdicts,
)
from docs.studies.adapting.picture import draw
from model.settings import LENGTHS

INTRODUCTION = """# Making the model yours

`touchd train --extra FOLDER` adapts the shipped model to recordings of your own: another pad, other people,
other gestures. It needs the extra `train`, no GPU and not HAART.

```sh
touchd record lab --gestures constant,notouch,hug,pat,stroke --rounds 4    # once for each participant
touchd train --extra lab --output lab.onnx
```

Then put `model: lab.onnx` into `touchd.yaml`; for the service, which sees no home folders, copy the file to
`/etc/touchd` first (`sudo install -m 644 lab.onnx /etc/touchd/`), then `sudo systemctl reload touchd`. The
shipped model stays where it is, and no file is written over. Touches kept by the daemon and labelled with
`touchd record --from-journal` may lie in the same folder.

It took 16 s of processor time for 7 recordings, 20 s for 72 by three participants, and 16 s more with
`--haart` (`time touchd train --extra FOLDER`, on a busy machine).

**What it reports.** Right answers before and after, gesture by gesture, always on recordings that nothing
was learnt from: with two participants or more, each of them is answered by a model adapted to the others;
with one, each recording by a model adapted to other recordings. Windows of one recording are never on both
sides.

| it says | because |
|---|---|
| 95 % beside a gesture | Wilson interval of "after"; a recording counts once, not each of its windows |
| 95 % interval of the difference | t interval over participants; with one participant, over recordings |
| too little to tell | that interval holds 0, so chance alone makes such a difference |
| one participant | nothing can be said of others, who may have become worse (see below) |
| fewer than 3 participants | two who change alike would make the interval vanish |
| fewer than 4 recordings | of three, all right, the interval still begins at 44 % |
| cannot be told | one recording a gesture: none can be left out |
| worse than the shipped model | the interval lies below 0; the file is written, and better not used |

**What happens to the gestures.** The new model knows those in the folder, and `notouch`, which the daemon
counts on. A known gesture keeps its row of the last layer; a new one begins as the mean of all rows. A
gesture that the folder lacks is dropped, unless `--haart FOLDER` rehearses HAART's recordings beside yours:
then all are kept, and other people are forgotten less. Gestures that occur nowhere are no evidence against
themselves: without recordings of `notouch`, what the shipped model knows of it stays.

**What is learnt.** The dense layers behind the summary of a touch, from varied crops, held to where they
were by a pull that weighs less the more recordings there are. Confidence is calibrated on what was left
out, and stays near the shipped one where that is little. A recording lasts at least 1 s; it is laid on the
model's 54 Hz grid by the pad's clock. The same folder and `--seed` give the same model.
"""

METHOD = """## What it does on HAART

Rebuild with `python -m docs.studies adapting FOLDER`, FOLDER being HAART's; it needs the networks of `touchd
train` that leave participants out. Each training participant is answered by the network that never saw
anybody of the fold, adapted to 1, 2 or 4 recordings a gesture of that one participant, of various
substrates and covers, drawn at random {draws} times. All are scored on what lies beside the first 4 of the
draw, about 8 recordings a gesture. "Others" are people whom the network never saw either. Windows and macro
accuracy as in [accuracy](accuracy.md). ± is the standard deviation over participants; intervals are 95 %,
t, over participants.

![What adapting to a person does](figures/adapt.png)
"""

CHOICE = """### What was chosen, and what was tried besides

The pull, on the same recordings (first draw), without HAART, after 144 frames: points won for that person,
and for others.
"""

BESIDES = """Deeper layers win no more. Measured once on the same participants, first draw, pull 7, after 144
frames, for 1 and 4 recordings a gesture: the dense layers +0.9 and +5.6 for that person, -1.8 and -2.3 for
others; with the transformer block too +0.3 and +6.1, -1.8 and -0.5; the whole network, 4 recordings alone,
+6.1 and -1.0, at thirty times the work. Levelling a person's pressure was not tried: half and twice the
counts cost the shipped network under a point, see [accuracy](accuracy.md).
"""


def write_page(study: Study, folder: Path) -> None:
    """Write adapt.md into an existing folder, and its picture into figures/ there."""
    (folder / "figures").mkdir(exist_ok=True)
    draw(study, folder / "figures" / "adapt.png")
    (folder / "adapt.md").write_text("\n".join(page_lines(study)) + "\n", encoding="utf-8")


def page_lines(study: Study) -> Iterable[str]:
    """Yield the page's lines."""
    yield INTRODUCTION
    yield from _in_short(study)
    yield METHOD.format(draws=DRAWS)
    training = [cell for cell in study.cells if cell.participant not in TEST_PARTICIPANTS]
    test = [cell for cell in study.cells if cell.participant in TEST_PARTICIPANTS]
    for heading, cells in (
        ("Training participants, left out", training),
        ("Test participants, the shipped network, once", test),
    ):
        yield f"### {heading}"
        yield ""
        yield from _gain_table(gains(cells))
    yield "### Each participant, after 144 frames"
    yield ""
    yield from _people_table(study)
    yield "### What the command itself would have said"
    yield ""
    yield "From the 2 or 4 recordings a gesture alone, without HAART, after 144 frames; and what was so on"
    yield "all others of that person's. With 1 none can be left out, and it says that it cannot tell."
    yield ""
    yield "| a gesture | it said | how often | truly better | mean difference there |"
    yield "|---|---|---|---|---|"
    for verdict in verdicts(study.cells):
        yield (
            f"| {verdict.each} | {verdict.said} | {verdict.times} of {verdict.out_of} "
            f"| {verdict.truly_better} of {verdict.times} | {verdict.mean_difference:+.1f} |"
        )
    yield ""
    yield "### New people, on this pad and on another"
    yield ""
    yield "Adapted to 4 recordings a gesture of each of the others in the fold, asked about a training"
    yield "participant left out; on HAART's pad, and with a row of its taxels dead."
    yield ""
    yield "| pad | frames | before | after | difference | 95 % interval |"
    yield "|---|---|---|---|---|---|"
    for on in pad_rows(study.pads):
        yield (
            f"| {'as it is' if on.pad == 'none' else on.pad} | {on.frames} | {on.before.mean:.1f} "
            f"| {on.after.mean:.1f} | {on.difference.mean:+.1f} "
            f"| {on.difference.low:+.1f} to {on.difference.high:+.1f} |"
        )
    yield ""
    yield "### A new gesture"
    yield ""
    yield "Each touching gesture in turn was struck from the last layer and learnt anew from one participant,"
    yield "beside the other gestures. The layers below had seen it, so a truly new one may be harder."
    yield ""
    yield "| a gesture | new gesture right, % | the others before, % | after, % |"
    yield "|---|---|---|---|"
    for new in new_gesture_rows(study.new_gestures):
        yield f"| {new.each} | {new.right:.1f} | {new.others_before:.1f} | {new.others_after:.1f} |"
    yield ""
    yield CHOICE
    yield "| pull | a gesture | that person | others |"
    yield "|---|---|---|---|"
    for row in pull_rows(study.pulls):
        chosen = "**" if row.pull == study.settings.pull else ""
        yield f"| {chosen}{row.pull:g}{chosen} | {row.each} | {row.own:+.1f} | {row.others:+.1f} |"
    yield ""
    yield BESIDES.rstrip()


def _in_short(study: Study) -> Iterable[str]:
    """Yield what to expect, after the last answer, in the study's own figures."""
    training = [cell for cell in study.cells if cell.participant not in TEST_PARTICIPANTS]
    last = [row for row in gains(training) if row.frames == LENGTHS[-1]]
    alone, rehearsed = ([row for row in last if row.rehearsed == with_haart] for with_haart in (False, True))
    pads = {row.pad: row for row in pad_rows(study.pads) if row.frames == LENGTHS[-1]}
    yield "## What to expect"
    yield ""
    yield "Points of macro accuracy after 2.67 s, measured on HAART as told below, mean and 95 % interval:"
    yield ""
    yield f"| adapted to | asked about | {' | '.join(f'{each} a gesture' for each in KS)} |"
    yield f"|---|---|{'---|' * len(KS)}"
    for who, of_whom, rows in (
        ("one person", "that person", [row.own for row in alone]),
        ("one person", "others", [row.others for row in alone]),
        ("one person, HAART rehearsed", "that person", [row.own for row in rehearsed]),
        ("one person, HAART rehearsed", "others", [row.others for row in rehearsed]),
    ):
        yield f"| {who} | {of_whom} | {' | '.join(_points(value) for value in rows)} |"
    for pad, who in (
        ("none", "one or two others"),
        ("one dead row", "one or two others, a row of taxels dead"),
    ):
        yield f"| {who} | somebody new |{' |' * (len(KS) - 1)} {_points(pads[pad].difference)} |"
    yield ""
    yield "So it pays, on average, for those who are in the folder, though not for each of them. Others"
    yield "lose a little, less so when HAART is rehearsed. For new people on a pad like HAART's there is"
    yield "nothing to win: use the shipped model. A dead row is not made good by so few recordings of others."
    yield "Another kind of pad than HAART's has not been measured."
    yield ""


def _points(value: Spread) -> str:
    return f"{value.mean:+.1f} ({value.low:+.1f} to {value.high:+.1f})"


def _gain_table(rows: Sequence[Gain]) -> Iterable[str]:
    yield (
        "| a gesture | HAART rehearsed | frames | before | after | difference | 95 % interval "
        "| sd over draws | others, difference | 95 % interval | calibration error before, after |"
    )
    yield "|---" * 11 + "|"
    for row in rows:
        yield (
            f"| {row.each} | {'yes' if row.rehearsed else 'no'} | {row.frames} "
            f"| {row.before.mean:.1f} ± {row.before.sd:.1f} | {row.after.mean:.1f} ± {row.after.sd:.1f} "
            f"| **{row.own.mean:+.1f}** | {row.own.low:+.1f} to {row.own.high:+.1f} | {row.sd_draws:.1f} "
            f"| {row.others.mean:+.1f} | {row.others.low:+.1f} to {row.others.high:+.1f} "
            f"| {row.calibration} |"
        )
    yield ""


def _people_table(study: Study) -> Iterable[str]:
    names = list(dict.fromkeys(cell.participant for cell in study.cells))
    last = str(LENGTHS[-1])
    yield f"| HAART rehearsed | a gesture | {' | '.join(names)} |"
    yield f"|---|---{'|---' * len(names)}|"
    befores = [
        np.mean([c.own_before.accuracy[last] for c in study.cells if c.participant == name]) for name in names
    ]
    yield f"| | 0 | {' | '.join(f'{100 * before:.1f}' for before in befores)} |"
    for rehearsed in (False, True):
        for each in KS:
            afters = [
                np.mean(
                    [
                        c.own_after.accuracy[last]
                        for c in study.cells
                        if (c.participant, c.rehearsed, c.each) == (name, rehearsed, each)
                    ]
                )
                for name in names
            ]
            said = " | ".join(f"{100 * after:.1f}" for after in afters)
            yield f"| {'yes' if rehearsed else 'no'} | {each} | {said} |"
    yield ""
