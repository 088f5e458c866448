"""Words in large letters, to be read from afar."""

ROWS = 5
# Five rows a letter, from top to bottom; a dot is empty.
LETTERS = {
    "A": ".#. #.# ### #.# #.#",
    "B": "##. #.# ##. #.# ##.",
    "C": ".## #.. #.. #.. .##",
    "D": "##. #.# #.# #.# ##.",
    "E": "### #.. ##. #.. ###",
    "F": "### #.. ##. #.. #..",
    "G": ".## #.. #.# #.# .##",
    "H": "#.# #.# ### #.# #.#",
    "I": "# # # # #",
    "J": "..# ..# ..# #.# .#.",
    "K": "#..# #.#. ##.. #.#. #..#",
    "L": "#.. #.. #.. #.. ###",
    "M": "#...# ##.## #.#.# #...# #...#",
    "N": "#..# ##.# #.## #..# #..#",
    "O": ".#. #.# #.# #.# .#.",
    "P": "##. #.# ##. #.. #..",
    "Q": ".##. #..# #..# #.#. .#.#",
    "R": "##. #.# ##. #.# #.#",
    "S": ".## #.. .#. ..# ##.",
    "T": "### .#. .#. .#. .#.",
    "U": "#.# #.# #.# #.# ###",
    "V": "#.# #.# #.# #.# .#.",
    "W": "#...# #...# #.#.# ##.## #...#",
    "X": "#.# #.# .#. #.# #.#",
    "Y": "#.# #.# .#. .#. .#.",
    "Z": "### ..# .#. #.. ###",
    "Ä": "#.# .#. #.# ### #.#",
    "Ö": "#.# .#. #.# #.# .#.",
    "Ü": "#.# ... #.# #.# ###",
    "-": "... ... ### ... ...",
    " ": ".. .. .. .. ..",
}
# Block characters for a pixel above and one below.
BLOCKS = {"..": " ", "#.": "▀", ".#": "▄", "##": "█"}


def big(word: str, width: int, is_tall: bool) -> list[str]:
    """Return a word in three lines, twice as wide where there is room, and twice as tall if `is_tall`.

    If the word does not fit or has other letters, return it plain.
    """
    letters = [LETTERS.get(letter) for letter in word.upper()]
    if None in letters:
        return [word]
    rows = [".".join((letter or "").split()[row] for letter in letters) for row in range(ROWS)]
    if 2 * len(rows[0]) <= width:
        rows = ["".join(2 * pixel for pixel in row) for row in rows]
        if is_tall:
            rows = [row for row in rows for _ in range(2)]
    if len(rows[0]) > width:
        return [word]
    if len(rows) % 2:
        rows.append("." * len(rows[0]))
    return [
        "".join(BLOCKS[upper + lower] for upper, lower in zip(*pair, strict=True))
        for pair in zip(rows[::2], rows[1::2], strict=True)
    ]
