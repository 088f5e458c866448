"""What the configuration says of journal and robot, made into the things themselves."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from daemon.config import ConfigError, JournalSettings, RobotConfig, SceneSettings, Settings
from daemon.events import Event, RobotEvent, one_line, timestamp
from daemon.kept.journal import Journal
from daemon.kept.touch_store import TouchStore, folder_of
from daemon.wire import description_of
from drivers.recording import RecordingError
from drivers.robot.link import RobotLink, RobotSettings, State

BYTES_PER_MB = 1_000_000


def open_journal(settings: JournalSettings | None) -> Journal | None:
    """Return the configured journal, if any; raises JournalError."""
    if settings is None:
        return None
    path = Path(settings.path).expanduser()
    return Journal(path, max_bytes=round(settings.max_mb * BYTES_PER_MB), keep=settings.keep)


def open_touch_store(settings: Settings) -> TouchStore | None:
    """Return where the frames of touches are kept, if they are; raises ConfigError when they cannot be."""
    journal = settings.journal
    if journal is None or journal.keep_touches is None:
        return None
    folder = folder_of(Path(journal.path).expanduser())
    try:
        return TouchStore(folder, journal.keep_touches, description_of(settings.sensor))
    except RecordingError as error:
        raise ConfigError(f"journal.keep_touches: {error}") from error


def link_to_robot(
    robot: RobotConfig | None, scene: SceneSettings, emit: Callable[[Event], None]
) -> RobotLink | None:
    """Return a link, not yet started, to the configured robot, if any; raises RobotError.

    emit: gets an event when the robot comes or goes, from the link's thread.
    """

    def report(state: State, reason: str) -> None:
        emit(RobotEvent(state=state, time=timestamp(time.time()), reason=one_line(reason)))

    if robot is None:
        return None
    return RobotLink(
        RobotSettings(
            url=robot.url,
            prefix=robot.prefix,
            user=robot.user,
            token_file=robot.token_file,
            token_env=robot.token_env,
            actions=scene.actions,
        ),
        report,
    )
