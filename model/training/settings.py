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


class Refinement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A training of the upper layers only, on windows that are drawn once. It adds the label `other`.

    `unknown`, `slow`, `changed` and `both` are shares of all windows; the rest are plain touches. `unknown`
    is the same on every pad, so that the pad does not predict the answer.
    """

    runs: int = 2
    """Number of trainings; their weights are averaged."""
    windows: int = 3072
    """Windows drawn for each training."""
    unknown: float = 0.28
    """Touches that are none of the gestures."""
    real: float = 0.65
    """Share of these on the third study's pad that were recorded; the others are simulated."""
    shuffled: float = 0.12
    """Share of the simulated ones that are recordings with shuffled blocks."""
    slow: float = 0.08
    """Strokes at a quarter of their speed or more."""
    changed: float = 0.06
    """The hand changes its gesture; from then on the new one is the label."""
    both: float = 0.03
    """Two hands at once; each of the two gestures is half of the label."""
    sharpened: float = 0.4
    """Share of the third study's windows that are changed to what a fabric pad would have read."""
    taught: float = 0.5
    """Share of the first network's answers in the targets of known gestures (distillation)."""
    steady: float = 2.0
    """Weight of the divergence from the first network's answers about mixed windows."""


class TrainAugmentation(AugmentationSettings, frozen=True, forbid_unknown_fields=True):
    """Augmentation that only training uses: when adapting, a lab's own recordings show its pad."""

    another_pad: float = 0.0
    """Share of a fabric pad's windows that are changed to what another kind of pad would have read."""
    rise_s: float = 0.25
    """The longest time constant with which a soft pad follows rising pressure."""
    fall_s: float = 1.5
    """The same for falling pressure: silicone creeps back."""
    coarse: float = 0.5
    """Share of those windows whose pad also has fewer taxels, 4 to 7 a side, interpolated to 8."""
    quiet: float = 0.0
    """Share of a fabric pad's windows that are changed to what a pad without noise would have read."""
    quiet_counts: float = 8.0
    """The most counts that are subtracted from them, as noise."""
    quiet_frames: int = 8
    """The most frames over which they are averaged."""
    mix: float = 0.0
    """Share of windows into which up to half of another one and its label is mixed (mixup, Zhang 2018)."""


class TrainSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that determines a training's result except data, code and the networks trained with it."""

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
    """Decay of the exponential moving average of the weights, which is the resulting network."""
    shares: Shares | None = None
    """Of the studies; each person of a study is drawn equally often. None: each recording equally often."""
    passing: float = 0.0
    """Share of the windows of touches that show a touch in passing."""
    bfloat16: bool = False
    """Whether the layers compute in bfloat16 while training, where the device has instructions for it."""
    refined: Refinement | None = None
    """Train the encoder and the dense layers alone, on drawn windows. None: all layers."""
    network: NetworkSettings = NetworkSettings()
    augmentation: TrainAugmentation = TrainAugmentation()
