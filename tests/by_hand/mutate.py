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
SEED = 54


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
        for number, (line, column) in enumerate(positions):
            # The star before parameters that are given by name is not an operator.
            is_star = lines[line - 1][column : column + 2] == "*,"
            if not is_star and not UNSEEN.search(lines[line - 1][:column]):
                places.append((line, name, number))
    if 0 < given.sample < len(places):
        places = random.Random(SEED).sample(places, given.sample)
    for line, name, number in sorted(places):
        code = mutate_code(source, get_operator(name)(), number)
        if code not in (None, source):
            sys.stdout.write(json.dumps({"line": line, "change": name, "code": code}) + "\n")


if __name__ == "__main__":
    main()
