"""The adapting study as a picture: what is won for the person adapted to, and lost for others."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from docs.studies.adapting.cells import KS, TEST_PARTICIPANTS, Study
from docs.studies.adapting.figures import gains, own_change
from model.settings import LENGTHS


def draw(study: Study, path: Path) -> None:
    """Draw how accuracy after the last answer moves, that person's and others', with what is adapted to."""
    training = [cell for cell in study.cells if cell.participant not in TEST_PARTICIPANTS]
    rows = [row for row in gains(training) if row.frames == LENGTHS[-1]]
    figure, panels = plt.subplots(1, 2, figsize=(9.6, 3.9), layout="constrained", sharey=True)
    places = np.arange(len(KS) + 1)
    for name in dict.fromkeys(cell.participant for cell in training):
        alone = [cell for cell in training if cell.participant == name and not cell.rehearsed]
        own = [np.mean([own_change(cell) for cell in alone if cell.each == each]) for each in KS]
        panels[0].plot(places, [0.0, *own], color="0.75", linewidth=1.0, zorder=1)
        panels[0].annotate(
            name, (places[-1], own[-1]), (4, -3), textcoords="offset points", color="0.5", size=7
        )
    for rehearsed, colour, beside, label in (
        (False, "C0", -0.03, "the folder alone"),
        (True, "C1", 0.03, "HAART rehearsed beside it"),
    ):
        mine = [row for row in rows if row.rehearsed == rehearsed]
        for axes, values in zip(panels, ([r.own for r in mine], [r.others for r in mine]), strict=True):
            means = [0.0, *(value.mean for value in values)]
            reaches = [0.0, *(value.mean - value.low for value in values)]
            axes.errorbar(
                places + beside, means, reaches, color=colour, lw=2, marker="o", ms=5, capsize=3, label=label
            )
    for axes, title in zip(panels, ("that person's other recordings", "other people's"), strict=True):
        axes.axhline(0.0, color="grey", linewidth=0.6)
        axes.set_xticks(places, [str(each) for each in (0, *KS)])
        axes.set(xlabel="recordings a gesture adapted to", title=title, xlim=(-0.2, len(KS) + 0.3))
    panels[0].set_ylabel("change after 2.67 s, points of macro accuracy")
    panels[1].legend(loc="upper left", title="mean over 7 people, 95 % interval")
    figure.savefig(path, dpi=110)
    plt.close(figure)
