"""The probabilities as bars."""

from collections.abc import Mapping, Sequence

from rich.segment import Segment

from touchd.daemon.view.pad_picture import DrawnLine
from touchd.daemon.view.palette import Palette

EIGHTHS = " ▏▎▍▌▋▊▉█"
PERCENT_WIDTH = 6


def bars(
    names: Mapping[str, str],
    shares: Mapping[str, float],
    stands: str,
    size: tuple[int, int],
    palette: Palette,
) -> list[DrawnLine]:
    """Return one bar for each gesture, only the likeliest where (width, height) has no room for all.

    names: display names, in order. shares: probabilities, empty for empty bars. stands: the answer now.
    """
    width, height = size
    likeliest = sorted(names, key=lambda gesture: -shares.get(gesture, 0.0))[:height]
    shown: Sequence[str] = [gesture for gesture in names if gesture in likeliest]
    name_width = min(max((len(name) for name in names.values()), default=0), width // 2)
    room = max(width - name_width - 1 - PERCENT_WIDTH, 1)
    lines = []
    for gesture in shown:
        share = shares.get(gesture)
        eighths = round((share or 0.0) * room * 8)
        bar = "█" * (eighths // 8) + EIGHTHS[eighths % 8].strip()
        is_answer = gesture == stands
        style = palette.ink if is_answer else palette.muted
        number = "-" if share is None else f"{share:.0%}"
        lines.append(
            [
                Segment(f"{names[gesture][:name_width]:<{name_width}} ", style),
                Segment(bar, palette.accent if is_answer else palette.muted),
                Segment("─" * (room - len(bar)), palette.rail),
                Segment(f"{number:>{PERCENT_WIDTH}}", style),
            ]
        )
    return lines
