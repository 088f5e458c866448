"""Settings of a training."""

from typing import Literal

import msgspec

from touchd.model.settings import AugmentationSettings, NetworkSettings

Study = Literal["haart", "second", "third"]


class TrainSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that determines a training's result, apart from data and code."""

    name: str = "touchd"
    seed: int = 0
    studies: tuple[Study, ...] = ("haart",)
    """Studies to learn from; of HAART, the training participants."""
    left_out: tuple[str, ...] = ()
    begins_from: str = ""
    """Name of a finished training in the same folder of runs, whose weights this one begins with."""
    epochs: int = 60
    rate_epochs: int = 0
    """Epochs over which the learning rate falls to zero, if more than are trained; 0: `epochs`."""
    crops_per_recording: int = 3
    batch: int = 32
    window: int = 144
    lengths: tuple[int, ...] = (18, 27, 54, 72, 81, 108, 144)
    learning_rate: float = 2e-3
    weight_decay: float = 0.05
    label_smoothing: float = 0.05
    average_decay: float = 0.995
    """Of the exponential moving average of the weights, which is the network that is kept."""
    averaged_epochs: tuple[int, ...] = ()
    """Epochs after which the average is saved; the network is the mean of these (Izmailov et al. 2018)."""
    begins_share: float = 0.0
    """Share of the weights that it begins with in the network that is kept (Wortsman et al. 2022)."""
    balance_people: bool = False
    """Whether every study, and each of its people, is drawn equally often."""
    bfloat16: bool = False
    """Whether the layers compute in bfloat16 while training, where the device has instructions for it."""
    compiled: bool = False
    """Whether the step is compiled: 1.6 times as fast on a CPU, but takes a C++ compiler and a minute."""
    network: NetworkSettings = NetworkSettings()
    augmentation: AugmentationSettings = AugmentationSettings()
