"""Settings of a network: its shape, and the augmentation of its training. Does not import torch."""

import msgspec

LENGTHS = (54, 81, 144)
"""The window lengths, in frames, at which touches are answered: 1, 1.5 and 2.67 s."""


class NetworkSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The network's shape. Widths are channels; `dilations` has one gated convolution an entry."""

    stem_width: int = 16
    width: int = 96
    dilations: tuple[int, ...] = (1, 2, 4, 8)
    blocks: int = 1
    heads: int = 4
    feed_forward: int = 192
    dense: int = 96
    dropout: float = 0.2
    smooth_frames: int = 0
    """The stem also sees each taxel's mean over this many frames, and its change since the mean before.

    Light touches on a noisy pad hardly show in a single frame. 0: the stem sees single frames only.
    """
    knee_counts: float = 4.0
    """Counts below are scaled about linearly, above logarithmically. Pads differ most below."""


class AugmentationSettings(msgspec.Struct, frozen=True):
    """How far each property of a touch is varied. Values are probabilities per window unless stated."""

    published_framing: float = 0.25
    onset: float = 0.6
    """The touch begins from rest, as a live one: the recordings are cut from the middle of a gesture."""
    onset_frames: float = 16.0
    """The longest rise from rest to full contact."""
    onset_wait_frames: float = 6.0
    """The longest rest before it, as the tracker's first frame is not exact."""
    change_pace: float = 0.6
    pace: float = 0.25
    """Time runs up to this share faster or slower."""
    gain: float = 0.6
    """Standard deviation of the log of a factor on all counts."""
    gamma: float = 0.15
    """Standard deviation of the log of an exponent on counts / 1023."""
    taxel_gain: float = 0.1
    """Standard deviation of the log of a factor on each taxel."""
    turn: float = 0.5
    """Turned and mirrored by one of the grid's eight symmetries."""
    shift: float = 0.4
    offset: float = 0.4
    offset_counts: float = 12.0
    noise_counts: float = 1.5
    line_noise: float = 0.0
    """All taxels of a column, or all of a row, share a noise, as a multiplexer's do."""
    line_noise_counts: float = 1.5
    dead_row: float = 0.1
    gain_field: float = 0.0
    """Standard deviation of the log of a factor that varies smoothly over the pad, as where it is worn."""
    warp: float = 0.0
    """Standard deviation, in taxels, of a smooth displacement, as of a pad that is bent around a body."""
    rest: float = 0.0
    """Another rest: a smooth field and single taxels, up to `rest_counts` up or down."""
    rest_counts: float = 8.0
    sway: float = 0.0
    """The body below breathes or leans: a smooth field that comes and goes at 0.2 to 1 Hz, and drifts."""
    sway_counts: float = 4.0
    hum: float = 0.0
    """A motor or the mains: all taxels together, at 4 to 27 Hz as sampled."""
    hum_counts: float = 2.0
