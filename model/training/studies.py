"""The studies that a network can learn from, and the folders of their recordings."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from touchd.drivers.recording import Recording
from touchd.model.training import haart, second_study, third_study
from touchd.model.training.settings import Study

MISSING: Mapping[Study, tuple[str, ...]] = MappingProxyType({"third": ("tickle",)})
"""Gestures that a study does not contain; they are not among the answers when it is scored."""


def study_of(participant: str) -> Study:
    """Return a participant's study: HAART for P and T, second for R and L, third for S."""
    return "haart" if participant[0] in "PT" else "third" if participant[0] == "S" else "second"


@dataclass(frozen=True)
class Folders:
    """Where the recordings lie."""

    haart: Path
    second_study: Path = Path("second-study")
    third_study: Path = Path("third-study")

    def to_train_on(self, studies: tuple[Study, ...]) -> list[Recording]:
        """Return all whole-scan recordings to train on; raises RecordingError when a study is missing."""
        recordings: list[Recording] = []
        if "haart" in studies:
            recordings += haart.realigned(haart.read_training(self.haart))
        if "second" in studies:
            recordings += second_study.takes(second_study.read(self.second_study))
        if "third" in studies:
            recordings += third_study.read(self.third_study)
        return recordings

    def others(self, studies: tuple[Study, ...]) -> list[Recording]:
        """Return the third study's recordings of gestures that are none of touchd's, by the study's names."""
        if "third" not in studies:
            return []
        read = third_study.read(self.third_study, third_study.OTHERS)
        return [recording for recording in read if recording.gesture in third_study.OTHERS]

    def to_score_on(self, studies: tuple[Study, ...]) -> dict[Study, list[Recording]]:
        """Return each study's recordings of its training people as they are scored."""
        scored: dict[Study, list[Recording]] = {}
        if "haart" in studies:
            scored["haart"] = self.to_train_on(("haart",))
        if "second" in studies:
            scored["second"] = second_study.scored(second_study.read(self.second_study))
        if "third" in studies:
            scored["third"] = third_study.read(self.third_study)
        return scored
