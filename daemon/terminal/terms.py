"""The words of the terminal around the gestures, in the languages that ship with touchd."""

import typing
from collections.abc import Mapping

from touchd.daemon.setup.words import Language

LANGUAGES: tuple[Language, ...] = typing.get_args(Language)

# One text for each of LANGUAGES. Logs, errors and help stay in English.
TERMS: Mapping[str, tuple[str, ...]] = {
    "after": ("after", "nach"),
    "answer times": (
        "{count} answers, half of them within {ms} ms of a frame.",
        "{count} Antworten, die Hälfte binnen {ms} ms nach einem Frame.",
    ),
    "answered": ("answered", "beantwortet"),
    "awaited": ("awaited", "erwartet"),
    "at work": ("the daemon at work", "der Daemon bei der Arbeit"),
    "before": ("{names} before", "vorher {names}"),
    "begins": ("touch {number} begins", "Berührung {number} beginnt"),
    "degraded": ("degraded", "gestört"),
    "did": ("The simulated hand did:  {names}", "Die simulierte Hand:       {names}"),
    "disturbed": ("disturbed", "verrauscht"),
    "does": ("robot does {what} ({action})", "Roboter macht {what} ({action})"),
    "down": ("down", "weg"),
    "early": ("early", "früh"),
    "ends": ("touch {number} ends: {name}, {length} s", "Berührung {number} endet: {name}, {length} s"),
    "final": ("final", "endgültig"),
    "firm": ("firm", "fest"),
    "gap": (", too many frames were lost", ", zu viele Frames gingen verloren"),
    "hand": ("the simulated hand: {name}", "die simulierte Hand: {name}"),
    "hears": ("robot hears {event}: {value}", "Roboter hört {event}: {value}"),
    "last": ("Last touch: {number} · {length} s", "Letzte Berührung: {number} · {length} s"),
    "last touches": ("Last touches", "Letzte Berührungen"),
    "light": ("light", "leicht"),
    "likelier": ("{name} is likelier now", "{name} ist jetzt wahrscheinlicher"),
    "live page": ("live page: {urls}   Ctrl-C ends", "Live-Seite: {urls}   Strg-C beendet"),
    "longest": (", longer than a touch may last", ", länger als eine Berührung dauern darf"),
    "missed": (
        "no touch was felt in {missed} of {all} recordings of touches",
        "in {missed} von {all} Aufnahmen von Berührungen wurde keine gefühlt",
    ),
    "no pad": ("no pad", "kein Kissen"),
    "no touch": ("No touch yet", "Noch keine Berührung"),
    "ongoing": ("ongoing", "dauert an"),
    "pad": ("pad", "Kissen"),
    "probabilities": ("Probabilities", "Wahrscheinlichkeiten"),
    "quote": ("“{what}”", "„{what}“"),
    "recorded": ("recorded", "aufgenommen"),
    "refuses": ("robot refuses {what}: {why}", "Roboter verweigert {what}: {why}"),
    "released": ("released", "losgelassen"),
    "revised": ("revised", "geändert"),
    "right": ("{right} of {all} touches right", "{right} von {all} Berührungen richtig"),
    "robot": ("robot", "Roboter"),
    "says": ("robot says {what}", "Roboter sagt {what}"),
    "sensor": (", the pad went away", ", das Kissen verschwand"),
    "settled": (", taken for the pad's new rest", ", für die neue Ruhelage gehalten"),
    "stopped": (", the stream ended", ", der Strom endete"),
    "sure": (" sure, after {at} s", " sicher, nach {at} s"),
    "told": ("told", "gesagt"),
    "told after": ("told after {at} s", "gesagt nach {at} s"),
    "told in all": ("The robot was told:      {names}", "Dem Roboter wurde gesagt:  {names}"),
    "touch": ("Touch {number} · {length} s", "Berührung {number} · {length} s"),
    "touch me": ("touch me", "berühre mich"),
    "uncertain": ("uncertain", "unsicher"),
    "unsure": ("not sure enough to tell", "nicht sicher genug"),
    "up": ("up", "da"),
    "was": ("was {name}", "vorher {name}"),
}


def term(language: Language, key: str, **values: object) -> str:
    """Return a text in a language, what it has in braces replaced by the values."""
    return TERMS[key][LANGUAGES.index(language)].format(**values)
