"""The shipped words for gestures, and those of a deployment."""

from touchd.daemon.app.config import Settings, Words
from touchd.daemon.robot.words import SHIPPED, name_of, words_of


def test_every_language_names_the_same_gestures() -> None:
    assert len({frozenset(words) for words in SHIPPED.values()}) == 1


def test_a_deployments_words_replace_the_shipped_ones() -> None:
    words = words_of(Settings(language="de", words={"stroke": Words(name="caresse", phrase="une caresse")}))
    assert [name_of(words, gesture) for gesture in ("stroke", "pat", "hug")] == [
        "caresse",
        "Tätscheln",
        "hug",
    ]
