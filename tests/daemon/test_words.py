"""Every text of terminal, page and robot exists in every shipped language."""

import json
import re
import string
import typing
from collections.abc import Sequence

import pytest

from touchd.daemon.commands.demo import NEXT, SAYINGS
from touchd.daemon.events import EndReason, PadState, Stage
from touchd.daemon.live.page import FOLDER
from touchd.daemon.setup.words import SHIPPED
from touchd.daemon.terminal.terms import LANGUAGES, TERMS

SCRIPTS = "".join(path.read_text() for path in sorted(FOLDER.glob("*.js")))
PAGE = (FOLDER / "page.html").read_text()
ENTRY = re.compile(r'^  (\w+): (\[\s*(?:"[^"\n]*",?\s*)+\]),$', re.MULTILINE)


def page_words() -> dict[str, list[str]]:
    body = (FOLDER / "words.js").read_text().partition("const WORDS = {\n")[2].partition("\n};")[0]
    words = {key: json.loads(re.sub(r",\s*\]", "]", texts)) for key, texts in ENTRY.findall(body)}
    assert len(words) == len(re.findall(r"^  \w+: ", body, re.MULTILINE)) > 50
    return words


def blanks(text: str) -> set[str | None]:
    return {name for _, name, _, _ in string.Formatter().parse(text)} - {None}


@pytest.mark.parametrize("texts", [TERMS, page_words()], ids=["terminal", "page"])
def test_every_text_is_translated_into_every_language(texts: dict[str, Sequence[str]]) -> None:
    for key, translations in texts.items():
        assert len(translations) == len(LANGUAGES), key
        assert all(text.strip() for text in translations), key
        assert len({frozenset(blanks(text)) for text in translations}) == 1, key


def test_the_page_uses_only_defined_words() -> None:
    asked = set(re.findall(r'word\(\s*"(\w+)"', SCRIPTS)) | set(
        re.findall(r'data-(?:word|label)="(\w+)"', PAGE)
    )
    assert asked | set(typing.get_args(EndReason)) - {"released"} <= page_words().keys()


def test_every_stage_state_and_ending_has_a_term() -> None:
    said = {*typing.get_args(Stage), *typing.get_args(PadState), *typing.get_args(EndReason)}
    assert said <= TERMS.keys()


def test_every_language_names_the_same_gestures() -> None:
    assert SHIPPED.keys() == SAYINGS.keys() == NEXT.keys() == set(LANGUAGES)
    assert len({frozenset(words) for words in SHIPPED.values()}) == 1
