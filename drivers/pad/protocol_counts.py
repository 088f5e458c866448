"""What every parser shares: the count of what it delivered and refused."""

from dataclasses import dataclass
from typing import Literal

# Signs of a restart with fewer frames between them are one: register dump, boot log, the clock's step back.
ONE_RESTART_FRAMES = 54

Damage = Literal["bad_framing", "bad_value", "bad_checksum", "bad_time"]


@dataclass
class ProtocolCounts:
    """What a parser delivered and refused since it was made.

    Damage between two intact frames is counted once or more, a lone damaged frame mostly once.
    frames: delivered. bad_framing: stretches of up to one frame's length in which no frame begins (a broken
    header, garbage, a malformed line). bad_checksum, bad_value (a float that is not a number), bad_time
    (disagrees with the sensor's clock): frames refused for that. duplicates: frames that repeat a clock
    already taken. clipped: frames delivered whose values above full scale were cut to it. bytes_dropped:
    bytes that belong to no well-formed frame. restarts: of the board; the last began at frame restarted_at.
    """

    frames: int = 0
    bad_framing: int = 0
    bad_checksum: int = 0
    bad_value: int = 0
    bad_time: int = 0
    duplicates: int = 0
    clipped: int = 0
    bytes_dropped: int = 0
    restarts: int = 0
    restarted_at: int = -ONE_RESTART_FRAMES

    @property
    def bad(self) -> int:
        """Frames refused as damaged, for whatever reason; a duplicate is not damage."""
        return self.bad_framing + self.bad_checksum + self.bad_value + self.bad_time

    def refuse(self, damage: Damage, dropped: int = 0) -> None:
        """Count a frame that is refused, and the bytes dropped with it."""
        setattr(self, damage, getattr(self, damage) + 1)
        self.bytes_dropped += dropped

    def restarted(self) -> None:
        """Count a restart of the board, of which a sign was seen now."""
        if self.frames - self.restarted_at >= ONE_RESTART_FRAMES:
            self.restarts += 1
            self.restarted_at = self.frames
