"""Names and phrases for gestures: English and German are shipped, a deployment may add its own."""

from collections.abc import Mapping
from typing import TypeAlias

from touchd.daemon.app.config import Language, Settings, Words
from touchd.daemon.path.events import UNCERTAIN
from touchd.drivers.frame import NO_TOUCH, OTHER

Vocabulary: TypeAlias = Mapping[str, Words]

# Name, and phrase as after "that feels like" ("das fühlt sich an wie").
SHIPPED: Mapping[Language, Mapping[str, tuple[str, str]]] = {
    "en": {
        "constant": ("still hand", "a still hand"),
        "pat": ("pat", "a pat"),
        "rub": ("rub", "a rub"),
        "scratch": ("scratch", "scratching"),
        "stroke": ("stroke", "a stroke"),
        "tickle": ("tickle", "tickling"),
        NO_TOUCH: ("no touch", "nothing"),
        OTHER: ("something else", "something else"),
        UNCERTAIN: ("not sure", "something I am not sure of"),
    },
    "de": {
        "constant": ("ruhende Hand", "eine ruhende Hand"),
        "pat": ("Tätscheln", "Tätscheln"),
        "rub": ("Reiben", "Reiben"),
        "scratch": ("Kratzen", "Kratzen"),
        "stroke": ("Streicheln", "Streicheln"),
        "tickle": ("Kitzeln", "Kitzeln"),
        NO_TOUCH: ("keine Berührung", "nichts"),
        OTHER: ("etwas anderes", "etwas anderes"),
        UNCERTAIN: ("unklar", "etwas Unklares"),
    },
}


def words_of(settings: Settings) -> Vocabulary:
    """Return the words of the configured language; a deployment's own replace the shipped ones."""
    shipped = SHIPPED[settings.language].items()
    return {gesture: Words(name=name, phrase=phrase) for gesture, (name, phrase) in shipped} | settings.words


def name_of(words: Vocabulary, gesture: str) -> str:
    """Return a gesture's name; without one, its label."""
    return words[gesture].name if gesture in words else gesture
