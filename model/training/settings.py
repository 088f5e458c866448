"""Settings of a training."""

from typing import Literal

import msgspec

from touchd.model.settings import AugmentationSettings, NetworkSettings

Study = Literal["haart", "second", "third"]


class Shares(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How often windows are cut from each study, relative to one another."""

    haart: float = 1.0
    second: float = 1.0
    third: float = 1.0


class TrainSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that determines a training's result, apart from data, code, and the networks beside it."""

    name: str = "touchd"
    seed: int = 0
    studies: tuple[Study, ...] = ("haart",)
    """Studies to learn from; of HAART, the training participants."""
    left_out: tuple[str, ...] = ()
    steps: int = 3000
    """Steps of the optimizer, each of which sees a batch of random windows."""
    batch: int = 32
    window: int = 144
    lengths: tuple[int, ...] = (18, 27, 54, 72, 81, 108, 144)
    learning_rate: float = 2e-3
    weight_decay: float = 0.05
    label_smoothing: float = 0.05
    average_decay: float = 0.995
    """Of the exponential moving average of the weights, which is the network that is kept."""
    shares: Shares | None = None
    """Of the studies; each person of a study is drawn equally often. None: each recording equally often."""
    passing: float = 0.0
    """Share of the windows of touches that show a touch in passing: the hand comes, and is gone again."""
    bfloat16: bool = False
    """Whether the layers compute in bfloat16 while training, where the device has instructions for it."""
    network: NetworkSettings = NetworkSettings()
    augmentation: AugmentationSettings = AugmentationSettings()
