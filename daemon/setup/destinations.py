"""Makes pad, journal, robot link and live page from the configuration."""

from __future__ import annotations

import time
import typing
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial

from touchd.daemon.config import ConfigError, JournalSettings, SensorSettings, Settings
from touchd.daemon.events import MAX_REASON_BYTES, Event, RobotAction, RobotEvent, timestamp
from touchd.daemon.kept.journal import Journal
from touchd.daemon.kept.touch_store import TouchStore, folder_of
from touchd.daemon.live.address import listen, require_library
from touchd.drivers.errors import one_line
from touchd.drivers.frame import Counts
from touchd.drivers.pad.format import encode_frame
from touchd.drivers.pad.port import at_baud
from touchd.drivers.recording import RecordingError
from touchd.drivers.robot.link import LinkState, RobotLink
from touchd.drivers.robot.reactions import Kind, RobotMessage
from touchd.model.classifier import Classifier

if typing.TYPE_CHECKING:
    from touchd.daemon.live.server import LiveServer

BYTES_PER_MB = 1_000_000


def open_journal(settings: JournalSettings | None) -> Journal | None:
    """Return the configured journal, if any; raises JournalError."""
    if settings is None:
        return None
    _make_state_folder(settings)
    max_bytes = round(settings.max_mb * BYTES_PER_MB)
    return Journal(settings.file, max_bytes=max_bytes, keep=settings.keep)


def _make_state_folder(settings: JournalSettings) -> None:
    """Make the default state folder when it is missing, but not the folder of a configured path."""
    if settings.path is None:
        with suppress(OSError):
            settings.file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)


def open_touch_stores(settings: Settings) -> dict[str, TouchStore]:
    """Return the touch store of each pad that has one; raises ConfigError."""
    journal = settings.journal
    if journal is None or journal.keep_touches is None:
        return {}
    _make_state_folder(journal)
    try:
        return {
            name: TouchStore(folder_of(journal.file, name), journal.keep_touches, description_of(pad.sensor))
            for name, pad in settings.pads.items()
        }
    except RecordingError as error:
        raise ConfigError(f"journal.keep_touches: {error}") from error


def link_to_robot(settings: Settings, emit: Callable[[Event], None]) -> RobotLink | None:
    """Return a link, not yet started, to the configured robot, if any; raises RobotError.

    emit: gets an event when the robot comes, goes or does something, from the link's threads.
    """

    def report(state: LinkState, reason: str) -> None:
        why = one_line(reason, MAX_REASON_BYTES)
        emit(RobotEvent(state=state, time=timestamp(time.time()), reason=why))

    def act(message: RobotMessage, kind: Kind, what: str) -> None:
        now = timestamp(time.time())
        shown = one_line(what, MAX_REASON_BYTES)
        emit(RobotAction(touch=message.touch, action=kind, what=shown, time=now, pad=message.pad))

    if settings.robot is None:
        return None
    actions = {name: pad.scene.actions for name, pad in settings.pads.items()}
    link = RobotLink(settings.robot, report, on_act=act, actions=actions, words=settings.vocabulary)
    for name in settings.pads:
        # Until frames come: a program that waits for "up" must not find a pad that is not there.
        link.set_status("down", name)
    return link


def open_live_page(settings: Settings, models: Mapping[str, Classifier]) -> LiveServer | None:
    """Return the server of the live page, not yet started, if one is configured; raises LiveError."""
    if settings.live is None:
        return None
    require_library()
    from touchd.daemon.live.memory import Scene
    from touchd.daemon.live.server import LiveServer

    scenes = {name: Scene(pad, models[name]) for name, pad in settings.pads.items()}
    return LiveServer(listen(settings.live), settings.live, scenes)


def description_of(sensor: SensorSettings) -> str:
    """Return a line that says which pad it is and how it is read, for recordings."""
    pad = sensor.described
    return f"{pad}, crop {pad.crop}, invert {pad.invert},{at_baud(sensor.port, sensor.baud)} on {sensor.port}"


def encoder_for(sensor: SensorSettings) -> Callable[[Counts, int], bytes]:
    """Return an encoder from counts (8, 8) and the sensor's clock in ms to the pad's bytes."""
    return partial(encode_frame, sensor.described)
