"""`touchd classify`: the daemon's answers to recordings, without a port, as fast as possible."""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

from touchd.daemon.commands.settings import add_settings, load_model, settings_of
from touchd.daemon.path.events import Event, TouchBegan, TouchEnded, encode
from touchd.daemon.path.pipeline import Pipeline
from touchd.daemon.playback.stream import add_arguments, chosen_stream, play
from touchd.daemon.robot.words import Vocabulary, name_of, words_of
from touchd.daemon.view.describe import describe
from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.recording import Stream


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd classify",
        description="Sends recordings through the daemon's pipeline, with notouch before, between and after.",
    )
    add_arguments(parser)
    add_settings(parser, port=False)
    parser.add_argument("--json", action="store_true", help="events as JSON lines to a terminal too")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the events of the chosen recordings, in words to a terminal, else as JSON lines; returns 0."""
    options = parser().parse_args(arguments)
    settings = settings_of(options).settings
    in_words = sys.stdout.isatty() and not options.json
    stream = chosen_stream(options)
    words = words_of(settings)
    tally = Tally(stream)

    def emit(event: Event) -> None:
        tally.put(event)
        line = describe(event, words) if in_words else encode(event).decode()
        sys.stdout.write(f"{line}\n")

    model = load_model(settings)
    play(stream, lambda clock: Pipeline(settings.pipeline, model, emit, clock), tally.at)
    sys.stdout.flush()
    # JSON lines go to the pipe, the table to standard error, where people see it.
    (sys.stdout if in_words else sys.stderr).write(tally.summary(words))
    return 0


class Tally:
    """Counts touches by recorded and by settled gesture."""

    def __init__(self, stream: Stream) -> None:
        self._spans = stream.spans
        self._frame = self._place = 0
        self._detected: set[int] = set()
        self._touches: Counter[tuple[str, str]] = Counter()

    def at(self, frame: int) -> None:
        """Set the number of the next frame."""
        self._frame = frame

    def put(self, event: Event) -> None:
        """Count a touch."""
        if isinstance(event, TouchBegan):
            self._place = next(i for i, span in enumerate(self._spans) if self._frame < span.stop)
            self._detected.add(self._place)
        elif isinstance(event, TouchEnded):
            self._touches[self._spans[self._place].gesture, event.gesture] += 1

    def summary(self, words: Vocabulary) -> str:
        """Return a line for each recorded gesture, and how many touches were right."""
        rows = [("recorded", "answered")]
        for recorded in sorted({was for was, _ in self._touches}):
            answers = Counter({answer: n for (was, answer), n in self._touches.items() if was == recorded})
            told = ", ".join(f"{name_of(words, answer)} {n}" for answer, n in answers.most_common())
            rows.append((name_of(words, recorded), told))
        width = max(len(name) for name, _ in rows)
        lines = ["", *(f"{name:<{width}}  {told}" for name, told in rows)]
        right = sum(n for (recorded, answer), n in self._touches.items() if recorded == answer)
        touches = self._touches.total()
        lines.append(f"{right} of {touches} touches right{f' ({right / touches:.0%})' if touches else ''}")
        touched = {place for place, span in enumerate(self._spans) if span.gesture != NO_TOUCH}
        if missed := len(touched - self._detected):
            lines.append(f"no touch was detected in {missed} of {len(touched)} recordings of touches")
        return "\n".join([*lines, ""])
