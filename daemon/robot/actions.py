"""The rules for the robot's reactions, as in touchd.example.yaml; `reactions.py` applies them."""

import re
from typing import Annotated, TypeAlias, get_args

import msgspec

from touchd.daemon.path.events import UNCERTAIN, ActionKind, Stage
from touchd.daemon.path.feel import Feel

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
# The measures that every touch has, unlike a direction or a length in mm.
MEASURES = tuple(field.name for field in msgspec.structs.fields(Feel) if field.required)
# Excludes NaN, with which every comparison is false.
Finite: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]

# As ALLeds takes them.
COLORS = {
    "white": 0xFFFFFF,
    "red": 0xFF0000,
    "green": 0x00FF00,
    "blue": 0x0000FF,
    "yellow": 0xFFFF00,
    "magenta": 0xFF00FF,
    "cyan": 0x00FFFF,
    "off": 0x000000,
}
RGB = re.compile(r"#[0-9a-fA-F]{6}")
KINDS: tuple[ActionKind, ...] = get_args(ActionKind)
PLACEHOLDER = re.compile(r"\{\{|\}\}|\{(gesture|name|phrase|confidence)\}")

Speech = Annotated[str, msgspec.Meta(min_length=1, max_length=500)]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=3600)]


class Action(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """One thing the robot does: exactly one of these is set.

    say and animated_say may hold {gesture} (the model's label), {name} and {phrase} (see `config.Words`), and
    {confidence} (whole percent). leds: a name of COLORS, or "#rrggbb".
    """

    say: Speech | None = None
    animated_say: Speech | None = None
    behavior: Name | None = None
    leds: str | None = None

    @property
    def given(self) -> dict[ActionKind, str]:
        """What is set, by its kind."""
        return {kind: what for kind in KINDS if (what := getattr(self, kind)) is not None}

    def __post_init__(self) -> None:
        if len(self.given) != 1:
            raise ValueError(
                f"an action is exactly one of {', '.join(KINDS)}; here: {', '.join(self.given) or 'none'}"
            )
        if self.leds is not None and not (self.leds in COLORS or RGB.fullmatch(self.leds)):
            raise ValueError(f"leds {self.leds!r} is neither #rrggbb nor one of {', '.join(COLORS)}")
        for template in filter(None, (self.say, self.animated_say)):
            if re.search("[{}]", PLACEHOLDER.sub("", template)):
                raise ValueError(
                    f"{template!r} may hold {{gesture}}, {{name}}, {{phrase}} and {{confidence}}, nothing "
                    "else in braces; write {{ for a brace"
                )


class ActionRule(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When the robot carries out which actions, in order; a rule fires once per answer and touch.

    gestures: empty means any, but "other" and "uncertain" must be named. stages: of an answer that is told,
    or was told before; empty means any at which the answer is new: the first of its touch, or another than
    the last. changed: only for an answer that replaces another one of the same touch; if such a rule fits,
    those without changed do not apply. above, below: the touch's measures are at least, or less than, these.
    """

    do: Annotated[tuple[Action, ...], msgspec.Meta(min_length=1, max_length=16)]
    gestures: tuple[Name, ...] = ()
    stages: tuple[Stage, ...] = ()
    changed: bool = False
    above: dict[str, Finite] = {}
    below: dict[str, Finite] = {}
    refractory_s: Seconds = 0.0

    def __post_init__(self) -> None:
        if unknown := [measure for measure in (*self.above, *self.below) if measure not in MEASURES]:
            raise ValueError(f"{unknown[0]!r} is not one of {', '.join(MEASURES)}")
        only_stage = set(self.stages) == {UNCERTAIN} and UNCERTAIN not in self.gestures
        only_gesture = set(self.gestures) == {UNCERTAIN} and self.stages and UNCERTAIN not in self.stages
        if only_stage or only_gesture:
            raise ValueError(
                f"such a rule never acts: {UNCERTAIN} is told at stage {UNCERTAIN}; name it in both"
            )
