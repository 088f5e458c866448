"""Names and phrases for gestures: those that ship, and a deployment's own in any language."""

from collections.abc import Mapping
from typing import TypeAlias

from touchd.daemon.app.config import Settings, Words
from touchd.daemon.path.events import UNCERTAIN
from touchd.drivers.frame import NO_TOUCH, OTHER

Vocabulary: TypeAlias = Mapping[str, Words]

# The phrase is as after "that feels like".
SHIPPED: Vocabulary = {
    "constant": Words(name="still hand", phrase="a still hand"),
    "pat": Words(name="pat", phrase="a pat"),
    "rub": Words(name="rub", phrase="a rub"),
    "scratch": Words(name="scratch", phrase="scratching"),
    "stroke": Words(name="stroke", phrase="a stroke"),
    "tickle": Words(name="tickle", phrase="tickling"),
    NO_TOUCH: Words(name="no touch", phrase="nothing"),
    OTHER: Words(name="something else", phrase="something else"),
    UNCERTAIN: Words(name="not sure", phrase="something I am not sure of"),
}


def words_of(settings: Settings) -> Vocabulary:
    """Return the shipped words; a deployment's own replace them."""
    return {**SHIPPED, **settings.words}


def name_of(words: Vocabulary, gesture: str) -> str:
    """Return a gesture's name; without one, its label."""
    return words[gesture].name if gesture in words else gesture
