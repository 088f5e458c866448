"""Runs all checks one after another, each limited in time; skips those that are not possible."""

from collections.abc import Callable, Iterator

import numpy as np
from rich.console import Console

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor import values
from touchd.daemon.doctor.check import Check, Sample, listen
from touchd.daemon.doctor.hand import find_with_a_hand, find_without_asking
from touchd.daemon.doctor.line import check_damage, check_opening, check_protocol, check_rate
from touchd.daemon.doctor.machine import check_model, check_robot
from touchd.daemon.doctor.port import advice_for
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Port, SensorError
from touchd.drivers.search.search import Finding, Grid

PRESS_S = 15.0
# Fewer frames are too few to measure a rate.
LEAST_FRAMES = 10

Say = Callable[[str], None]


def examine(
    settings: Settings, seconds: float, say: Say, talk: Console | None = None, grid: Grid | None = None
) -> Iterator[Check]:
    """Yield each check as soon as it is made.

    seconds: how long to listen to the pad. say: shows a line to the user. talk: the terminal of a user who
    can press the pad, if there is one. grid: the pad's rows and columns, if known.
    """
    check, opened = check_opening(settings.sensor)
    yield check
    if opened is None:
        yield Check("pad", "not checked", "there is no port to read it from")
    else:
        with opened:
            try:
                yield from _examine_pad(settings, opened, seconds, say, talk, grid)
            except SensorError as error:
                yield Check("pad", "to do", str(error), advice_for(settings.sensor.port, error))
    say("Loading the model ...")
    yield check_model(settings)
    if settings.robot is not None:
        say(f"Asking the robot at {settings.robot.url} ...")
    yield check_robot(settings)


def _examine_pad(
    settings: Settings, opened: Port, seconds: float, say: Say, talk: Console | None, grid: Grid | None
) -> Iterator[Check]:
    sensor = settings.sensor
    say(f"Leave the pad alone for {seconds:g} s ...")
    sample = listen(opened, FrameParser(sensor.described), seconds)

    def find() -> Finding:
        if talk:
            return find_with_a_hand(talk, opened, grid)[0]
        configured = (sensor.described.rows, sensor.described.columns)
        return find_without_asking(say, opened, (grid,) if grid else (configured, None))

    yield check_protocol(sample, sensor, opened, find)
    if len(sample.frames) < LEAST_FRAMES:
        yield Check("pad", "not checked", "no frames arrive")
        return
    yield from _check_untouched(sample, settings)
    if talk is None:
        yield Check("orientation", "not checked", "asked for in a terminal only")
        return
    rest = np.median(sample.counts(), axis=0)
    say(f"Press the pad's top left corner with a finger, within {PRESS_S:g} s ...")
    parser = FrameParser(sensor.described)
    pressed = listen(opened, parser, PRESS_S, enough=lambda frame: values.is_pressed(frame, rest))
    yield values.check_orientation(pressed, rest, settings)
    if pressed.frames:
        yield from values.check_values(pressed, sensor.described.full_scale)


def _check_untouched(sample: Sample, settings: Settings) -> Iterator[Check]:
    """Yield the checks of a pad that was left alone."""
    yield check_damage(sample)
    yield check_rate(sample)
    quiet = values.check_quiet(sample, settings)
    yield quiet
    if quiet.verdict == "ok":
        yield values.check_rest(sample, settings)
        yield values.check_noise(sample)
    else:
        yield Check("rest", "not checked", "measured only while nothing touches the pad")
    yield from values.check_taxels(sample)
    yield from values.check_values(sample, settings.sensor.described.full_scale)
