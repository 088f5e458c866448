"""Prints a file's mutants, a line of JSON each. Runs with the Python that has cosmic-ray; see `mutants`."""

import argparse
import json
import random
import re
import sys
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

# Left out: mutants of annotations, of bits, and of identity, which for short strings and whole numbers is
# equality.
EXCLUDED = re.compile(
    "core/(ReplaceBinaryOperator_BitOr_.*"
    "|ReplaceBinaryOperator_.*_(Pow|Mod|FloorDiv|LShift|RShift|BitOr|BitAnd|BitXor)"
    "|ReplaceComparisonOperator_(Eq|NotEq|Lt|LtE|Gt|GtE)_(Is|IsNot)"
    "|RemoveDecorator)"
)
# How a class is made, and checks of a programmer's mistakes: no user sees them.
UNSEEN = re.compile(r"\b(frozen|slots|kw_only|eq|strict)=$")
# A number is changed by one. Of numbers from this on that is less than a hundredth, which no test should pin.
LARGE, NUMBER = 100, re.compile(r"[\d_]+(\.\d+)?")
SEED = 54


def is_seen(name: str, line: str, column: int) -> bool:
    """Whether a user could see what an operator changes at a place."""
    if name == "core/NumberReplacer" and (number := NUMBER.match(line, column)) is not None:
        return float(number[0]) < LARGE
    # The star before parameters that are given by name is not an operator.
    return not line.startswith("*,", column) and not UNSEEN.search(line[:column])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=0, help="how many, drawn at random; 0: all")
    parser.add_argument("file", type=Path)
    given = parser.parse_args()
    source = given.file.read_text()
    tree, lines = get_ast(source), source.splitlines()
    places = []
    for name in operator_names():
        operator = get_operator(name)
        if operator.arguments() or EXCLUDED.fullmatch(name):
            continue
        positions = (start for node in ast_nodes(tree) for start, _ in operator().mutation_positions(node))
        places += [
            (line, name, number)
            for number, (line, column) in enumerate(positions)
            if is_seen(name, lines[line - 1], column)
        ]
    if 0 < given.sample < len(places):
        places = random.Random(SEED).sample(places, given.sample)
    for line, name, number in sorted(places):
        try:
            code = mutate_code(source, get_operator(name)(), number)
        except AttributeError:
            # cosmic-ray cannot replace an exception that is named with its module.
            continue
        if code not in (None, source):
            sys.stdout.write(json.dumps({"line": line, "change": name, "code": code}) + "\n")


if __name__ == "__main__":
    main()
