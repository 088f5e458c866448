"""The two studies that a network can learn from, and where their recordings lie."""

from dataclasses import dataclass
from pathlib import Path

from touchd.drivers.recording import Recording
from touchd.model.training import haart, second_study
from touchd.model.training.settings import Study


@dataclass(frozen=True)
class Folders:
    """Where the recordings lie."""

    haart: Path
    second_study: Path = Path("second-study")

    def to_train_on(self, studies: tuple[Study, ...]) -> list[Recording]:
        """Return all whole-scan recordings to train on; raises RecordingError when a study is missing."""
        recordings: list[Recording] = []
        if "haart" in studies:
            recordings += haart.realigned(haart.read_training(self.haart))
        if "second" in studies:
            recordings += second_study.takes(second_study.read(self.second_study))
        return recordings

    def to_score_on(self, studies: tuple[Study, ...]) -> dict[Study, list[Recording]]:
        """Return each study's recordings of its training people as they are scored."""
        scored: dict[Study, list[Recording]] = {}
        if "haart" in studies:
            scored["haart"] = self.to_train_on(("haart",))
        if "second" in studies:
            scored["second"] = second_study.scored(second_study.read(self.second_study))
        return scored
