"""Sequential forward floating search: features one by one, and back again where fewer do better.

Pudil, Novovicova, Kittler 1994, "Floating search methods in feature selection", Pattern Recognition Letters
15, section 3.
"""

from __future__ import annotations

from collections.abc import Callable

Criterion = Callable[[tuple[int, ...]], float]


def floating_search(candidates: int, most: int, criterion: Criterion) -> tuple[tuple[int, ...], float]:
    """Return the best set of at most `most` of the features 0 to candidates - 1, and its criterion.

    criterion: how good a set of features is, greater the better; asked once a set. Of equals the smaller set
    wins. A set shrinks only where it beats the best of its size so far, so that the search ends.
    """
    asked: dict[tuple[int, ...], float] = {}

    def worth(chosen: tuple[int, ...]) -> float:
        key = tuple(sorted(chosen))
        if key not in asked:
            asked[key] = criterion(key)
        return asked[key]

    best: dict[int, tuple[int, ...]] = {}
    chosen: tuple[int, ...] = ()
    while len(chosen) < min(most, candidates):
        grown = [(*chosen, new) for new in range(candidates) if new not in chosen]
        chosen = _keep(best, max(grown, key=worth), worth)
        while len(chosen) > 2:
            shrunk = max((tuple(one for one in chosen if one != left) for left in chosen), key=worth)
            if worth(shrunk) <= worth(best[len(shrunk)]):
                break
            chosen = _keep(best, shrunk, worth)
    winner = max(best.values(), key=lambda features: (worth(features), -len(features)))
    return tuple(sorted(winner)), worth(winner)


def _keep(best: dict[int, tuple[int, ...]], chosen: tuple[int, ...], worth: Criterion) -> tuple[int, ...]:
    known = best.get(len(chosen))
    if known is None or worth(chosen) > worth(known):
        best[len(chosen)] = chosen
    return chosen
