"""Numbers on a command line; anything else, and a number out of range, is refused with an explanation."""

import argparse
from collections.abc import Callable
from typing import TypeVar

Number = TypeVar("Number", int, float)


def within(kind: type[Number], low: Number, high: Number) -> Callable[[str], Number]:
    """Return an argparse type: a number from `low` to `high`."""

    def number(text: str) -> Number:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number from {low:g} to {high:g}")
        return value

    return number
