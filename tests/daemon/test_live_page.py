"""The live page in a real browser, with a played recording and with faults."""

import itertools
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from rigs.browser import prefer, show_in
from rigs.live_rig import Served, serving
from rigs.made_events import PREDICTION, TIME
from rigs.patient_port import playing
from rigs.running_daemon import Daemon
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.by import By

from touchd.daemon.app.config import LiveSettings, PadSettings, Settings, Words
from touchd.daemon.live import server
from touchd.daemon.path.events import (
    Event,
    Label,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
)
from touchd.daemon.robot.words import name_of, words_of
from touchd.drivers.recording import Stream, ideal_clock_ms
from touchd.drivers.robot.session import RobotSettings
from touchd.model.studies.simulated import simulate

pytestmark = pytest.mark.timeout(300)
SPEED = 16.0
# Time limit for what the page draws at once.
SOON_S = 20.0
# Three touches: a pat, a stroke, and one that begins as scratching and goes on as rubbing.
SCRIPT = (
    *(("notouch", 3.0), ("pat", 3.0), ("notouch", 3.0), ("stroke", 3.0)),
    *(("notouch", 3.0), ("scratch", 1.15), ("rub", 2.45), ("notouch", 2.5)),
)
COUNTS = np.concatenate([part.counts for part in simulate(SCRIPT, seed=6)])
THREE_TOUCHES = Stream(COUNTS, ideal_clock_ms(len(COUNTS)), ())
# Length of the time line.
LINE_S = 4.0
CANVAS = "return document.getElementById('heat').toDataURL()"
# Records every announcement in the live region, which a screen reader speaks by itself.
LISTEN = """
  window.announced = [];
  const announcement = document.getElementById('announcement');
  new MutationObserver(() => announced.push([announcement.textContent, performance.now()]))
    .observe(announcement, { childList: true });
"""


@dataclass(frozen=True)
class WatchedPage:
    """A page on which three touches were shown and the pad then fell silent."""

    chrome: Chrome
    url: str
    answers: tuple[Prediction, ...]
    ended: tuple[TouchEnded, ...]
    console: tuple[str, ...]
    asked_for: frozenset[str]

    def run(self, script: str, *arguments: object) -> Any:
        return self.chrome.execute_script(script, *arguments)


def texts_of(chrome: Chrome, selector: str) -> list[str]:
    """Return the texts of elements as a person reads them."""
    texts = "return [...document.querySelectorAll(arguments[0])].map(one => one.innerText)"
    return [text.replace("\u00a0", " ") for text in chrome.execute_script(texts, selector)]


def text_of(chrome: Chrome, selector: str) -> str:
    return texts_of(chrome, selector)[0]


def sides(chrome: Chrome, selector: str) -> NDArray[np.float64]:
    """Return where N elements begin and end from left to right, (N, 2)."""
    script = """return [...document.querySelectorAll(arguments[0])]
                  .map(one => one.getBoundingClientRect()).map(box => [box.left, box.right])"""
    return np.array(chrome.execute_script(script, selector))


def listed(chrome: Chrome) -> list[str]:
    """Return the gestures of the last touches, latest first."""
    return texts_of(chrome, "#touches b")


def is_stale(chrome: Chrome) -> bool:
    """Whether the page marks its content as stale."""
    return bool(chrome.execute_script("return document.body.hasAttribute('data-stale')"))


@pytest.fixture(scope="module")
def played(chrome: Chrome, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WatchedPage]:
    """The page after the last of three touches, when the pad no longer sends."""
    show_in(chrome, 1280, 800)
    with (
        playing(THREE_TOUCHES, SPEED) as pad,
        Daemon(tmp_path_factory.mktemp("played"), pad, live=LiveSettings(port=0)) as daemon,
    ):
        # The browser's own new tab makes requests too.
        chrome.get("about:blank")
        chrome.get_log("performance")
        chrome.get(daemon.url)
        chrome.execute_script(LISTEN)
        assert pad.wait(WITHIN_S)
        wait_for(lambda: len(listed(chrome)) == 3)
        wait_for(lambda: is_stale(chrome))
        console = tuple(entry["message"] for entry in chrome.get_log("browser"))
        requests = [json.loads(entry["message"])["message"] for entry in chrome.get_log("performance")]
        asked_for = frozenset(
            request["params"].get("url") or request["params"]["request"]["url"]
            for request in requests
            if request["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated")
        )
        answers = tuple(event for event in daemon.events if isinstance(event, Prediction))
        ended = tuple(event for event in daemon.events if isinstance(event, TouchEnded))
        yield WatchedPage(chrome, daemon.url, answers, ended, console, asked_for)


def test_the_page_loads_without_errors_or_foreign_requests(played: WatchedPage) -> None:
    assert played.console == ()
    own = played.url.removeprefix("http://")
    assert f"ws://{own}/stream" in played.asked_for
    assert {re.sub(r"^\w+://([^/]*)/.*", r"\1", url) for url in played.asked_for} == {own}


def test_every_touch_is_listed_with_its_answers(played: WatchedPage) -> None:
    assert listed(played.chrome) == [event.gesture for event in reversed(played.ended)]
    paths = texts_of(played.chrome, "#touches .path")
    for path, event in zip(reversed(paths), played.ended, strict=True):
        gestures = [one.gesture for one in played.answers if one.touch == event.touch]
        assert re.findall(r"[a-z]{3,}", path) == [name for name, _ in itertools.groupby(gestures)]


def test_answers_stand_at_their_time_and_show_changes(played: WatchedPage) -> None:
    last = played.ended[-1].touch
    answers = [answer for answer in played.answers if answer.touch == last][:3]
    flags = played.run(
        """return [...document.querySelectorAll('#flags li')].slice(0, 3).map(flag =>
             [flag.dataset.gesture, +flag.dataset.frames, flag.classList.contains('changed')])"""
    )
    assert [answer.gesture for answer in answers] == ["scratch", "scratch", "rub"]
    assert flags == [
        [answer.gesture, answer.frames, is_changed]
        for answer, is_changed in zip(answers, (False, False, True), strict=True)
    ]
    for text, answer in zip(texts_of(played.chrome, "#flags li"), answers, strict=False):
        assert text.startswith(f"{answer.gesture}\n{100 * answer.confidence:.0f} %")
    assert texts_of(played.chrome, "#marks li") == ["1 s", "1.5 s", "2.67 s"]
    said_s = [answer.elapsed_s + answer.age_ms / 1000 for answer in answers]
    places = """return [...document.querySelectorAll('#flags li')]
      .map((flag) => +flag.style.getPropertyValue('--at'))"""
    assert played.run(places)[:3] == pytest.approx([min(at_s / LINE_S, 1.0) for at_s in said_s], abs=0.001)
    assert "↻ before: scratch" in text_of(played.chrome, "#remark")


def test_answer_confidence_and_probabilities_are_the_last_ones(played: WatchedPage) -> None:
    answer = played.answers[-1]
    assert text_of(played.chrome, "#gesture") == answer.gesture
    assert text_of(played.chrome, "#certainty").startswith(f"{100 * answer.confidence:.0f} % sure")
    rows = [row.split("\n") for row in texts_of(played.chrome, "#bars li")]
    words = words_of(Settings())
    shares = {name_of(words, label): f"{100 * share:.0f} %" for label, share in answer.probabilities.items()}
    assert {row[0]: row[-1] for row in rows} == shares


def test_stale_data_is_not_shown_as_live(played: WatchedPage) -> None:
    assert is_stale(played.chrome)
    assert re.fullmatch(r"\d+ s old|over a minute old", text_of(played.chrome, "#age"))
    assert played.run("return getComputedStyle(document.getElementById('heat')).opacity") == "0.35"
    wait_for(lambda: text_of(played.chrome, "#banner").startswith("The pad is down"))
    assert text_of(played.chrome, "#vital-pad dd") == "down"
    assert "frames/s" not in text_of(played.chrome, "#vital-rate dd")


def test_a_screen_reader_gets_each_answer_without_a_flood(played: WatchedPage) -> None:
    def announced() -> list[str]:
        return [text.replace("\u00a0", " ") for text, _ in played.run("return announced")]

    wait_for(lambda: any(re.fullmatch(r"3: rub \d+ %", text) for text in announced()))
    wait_for(lambda: any(text.startswith("The pad is down") for text in announced()))
    times_ms = [at_ms for _, at_ms in played.run("return announced")]
    assert np.diff(times_ms).min() > 1900
    assert played.run("return document.getElementById('announcement').getAttribute('aria-live')") == "polite"


def test_the_keyboard_reaches_every_control(played: WatchedPage) -> None:
    def press(key: str) -> str:
        ActionChains(played.chrome).send_keys(key).perform()
        return str(played.run("return document.activeElement.id || document.activeElement.className"))

    played.run("document.activeElement.blur()")
    assert press(Keys.TAB) == "skip"
    assert played.run("return document.querySelector('.skip').getBoundingClientRect().top") >= 0
    assert press(Keys.ENTER) == "answer"
    assert press(Keys.TAB) == "touches"
    assert played.run("return getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_the_page_follows_the_browsers_settings(played: WatchedPage) -> None:
    def brightness() -> float:
        paper = played.run("return getComputedStyle(document.body).backgroundColor")
        return float(np.mean([int(value) for value in re.findall(r"\d+", paper)]))

    # The page loads again when the colours change.
    bar = "const bar = document.querySelector('#bars i'); "
    moving = bar + "return bar && getComputedStyle(bar).transitionProperty"
    prefer(played.chrome, color_scheme="dark", reduced_motion="reduce")
    wait_for(lambda: brightness() < 50 and played.run(moving) == "none")
    prefer(played.chrome, color_scheme="light")
    wait_for(lambda: brightness() > 200 and played.run(moving) not in (None, "none"))
    prefer(played.chrome)
    wait_for(lambda: len(listed(played.chrome)) == 3)


def test_text_at_double_size_stays_visible(played: WatchedPage) -> None:
    played.chrome.execute_cdp_cmd("Page.setFontSizes", {"fontSizes": {"standard": 32}})
    try:
        wait_for(lambda: played.run("return parseFloat(getComputedStyle(document.body).fontSize)") >= 32)
        shown = "#gesture, #bars li *, #flags li, #vitals div"
        wait_for(lambda: ((sides(played.chrome, shown) >= 0) & (sides(played.chrome, shown) <= 1280)).all())
    finally:
        played.chrome.execute_cdp_cmd("Page.setFontSizes", {"fontSizes": {"standard": 16}})


def test_the_visitors_view_hides_the_vitals(played: WatchedPage) -> None:
    def seen(selector: str) -> bool:
        return bool(played.run("return document.querySelector(arguments[0]).checkVisibility()", selector))

    ActionChains(played.chrome).send_keys("v").perform()
    try:
        wait_for(lambda: played.run("return document.body.hasAttribute('data-visitors')"))
        assert all(seen(name) for name in ("#heat", "#gesture", "#certainty", "#flags", "#legend"))
        assert not any(seen(name) for name in ("#vitals", "#bars", "#touches", "h1"))
        assert text_of(played.chrome, "#legend").startswith("The stronger the colour, the firmer the touch.")
        assert played.run("return document.documentElement.scrollHeight <= innerHeight")
    finally:
        ActionChains(played.chrome).send_keys("v").perform()
    wait_for(lambda: not played.run("return document.body.hasAttribute('data-visitors')"))
    assert seen("#vitals")


BEGAN = TouchBegan(touch=1, time=TIME, sensor_ms=0)
ENDED = TouchEnded(touch=1, gesture="uncertain", frames=150, reason="released", time=TIME)
ROBOT: dict[str, Any] = {"robot": RobotSettings(url="tcp://127.0.0.1:1")}
ANSWER = replace(PREDICTION, touch=1)
CLOSE = {"pat": 0.45, "rub": 0.5, "stroke": 0.05}
STANDS = replace(ANSWER, stage="final", gesture="pat", confidence=0.45, probabilities=CLOSE)
SAYS = RobotAction(touch=1, action="say", what="Das war <b>Tätscheln</b>.", time=TIME)
LIGHTS = RobotAction(touch=1, action="leds", what="green", time=TIME)
LATE = replace(ANSWER, stage="released", gesture="stroke", frames=32, elapsed_s=0.6, age_ms=900.0)
GUESS = replace(ANSWER, stage="uncertain", gesture="uncertain", perhaps="pat")
UNSURE = replace(ANSWER, gesture="uncertain")
# The answer, in the list of touches, and on the time line.
NAMED = ("#gesture", "#touches b", "#flags .name")


@contextmanager
def showing(chrome: Chrome, *events: Event, **settings: Any) -> Iterator[Served]:
    """Yield a page in the browser, to which these events came after it was loaded."""
    with serving(**settings) as served:
        chrome.get(f"http://127.0.0.1:{served.port}/")
        wait_for(lambda: text_of(chrome, "#gesture") == "Touch the pad")
        for event in events:
            served.sink.put(event)
        served.put_frame()
        yield served


@pytest.mark.parametrize(
    ("settings", "events", "texts"),
    [
        ({}, [SensorEvent(state="down", time=TIME)], {"#gesture": "The pad is down"}),
        ({"language": "de"}, [BEGAN, STANDS], {"#gesture": "Tätscheln", "#bars .best": "Tätscheln"}),
        (
            {},
            [BEGAN, STANDS],
            {"#chances-when": "the answer stands: the likeliest leads by 5 points, 10 are needed"},
        ),
        ({}, [BEGAN, STANDS, SAYS, LIGHTS], {"#says": "“Das war <b>Tätscheln</b>.”"}),
        (
            ROBOT,
            [RobotEvent(state="up", time=TIME), BEGAN, LATE],
            {"#flags small": "saw 0.6 s, told at 1.5 s ✓", "#remark": "told the robot at 1.5 s"},
        ),
        ({}, [BEGAN, ANSWER, GUESS], {"#remark": "↻ before: stroke", "#flags .changed": "A pat, perhaps?"}),
        # An answer that was not told was not there before.
        ({}, [BEGAN, replace(ANSWER, told=False), GUESS], {"#flags li + li": "A pat", "#flags .changed": ""}),
        ({}, [BEGAN, GUESS, ENDED], dict.fromkeys(NAMED, "A pat, perhaps?")),
        ({"language": "de"}, [BEGAN, GUESS, ENDED], dict.fromkeys(NAMED, "Tätscheln?")),
        # Its confidence is another gesture's.
        ({}, [BEGAN, UNSURE, ENDED], dict.fromkeys(NAMED, "not sure")),
    ],
)
def test_the_page_says_what_happened(
    chrome: Chrome, settings: dict[str, Any], events: list[Event], texts: dict[str, str]
) -> None:
    def is_shown(selector: str, text: str) -> bool:
        found = " ".join(texts_of(chrome, selector))
        return text in found if text else not found

    show_in(chrome, 1280, 800)
    with showing(chrome, *events, **settings):
        wait_for(lambda: all(itertools.starmap(is_shown, texts.items())))
        if "not sure" in text_of(chrome, "#gesture"):
            assert "%" not in " ".join(texts_of(chrome, "#answer, #flags, #touches"))


# The longest words that a lab may have chosen.
LONG_WORDS = {
    "constant": "ruhige, aufgelegte Handfläche",
    "notouch": "überhaupt keine Berührung",
    "pat": "freundliches Schulterklopfen",
    "rub": "kräftiges Hin- und Herreiben",
    "scratch": "Kratzen mit den Fingerspitzen",
    "stroke": "langsames zärtliches Streicheln",
    "tickle": "Durchkitzeln mit allen Fingern",
    "uncertain": "weiß ich leider wirklich nicht",
}
# Finds elements beyond the window or their box, that cover others, or that mix a configured word, in
# brackets, with other letters. fits: whether everything has to be visible at once.
PROBLEMS = """
  const [fits] = arguments;
  const box = (name) => document.querySelector(name).getBoundingClientRect();
  const shown = [...document.querySelectorAll('body *')]
    .filter((one) => one.checkVisibility() && !one.closest('.unseen, .skip'));
  const isOut = (inner, outer) => inner.width > 1 &&
    (inner.left < outer.left - 1 || inner.right > outer.right + 1);
  const isBeyond = (one) => isOut(one.getBoundingClientRect(),
    one.closest('#flags') ? box('#course') : { left: 0, right: innerWidth });
  const answer = document.createRange();
  answer.selectNodeContents(document.getElementById('gesture'));
  const covers = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const pairs = [['#pad', '#line'], ['#answer', '#line']];
  for (const one of ['#pad', '#line', '#answer']) pairs.push(['#legend', one], ['#enter', one]);
  const isMixed = (text) => text.includes('⟨') &&
    /[a-z]{2}/i.test(text.replaceAll(/⟨.*?⟩/g, '').replace('before:', ''));
  const { scrollWidth, scrollHeight } = document.documentElement;
  return [
    ...shown.filter(isBeyond).map((one) => `beyond: ${one.tagName} ${one.id} ${one.className}`),
    ...pairs.filter(([a, b]) => covers(box(a), box(b))).map((pair) => `covers: ${pair}`),
    ...[...document.querySelectorAll('body :not(#says)')].filter((one) => one.children.length === 0)
      .map((one) => one.textContent).filter(isMixed),
    ...(answer.getBoundingClientRect().right > box('#gesture').right ? ['beyond: the answer'] : []),
    ...(scrollWidth > innerWidth || (fits && scrollHeight > innerHeight) ? ['scrolls'] : []),
    ...(box('#pad').width < 140 ? ['small pad'] : []),
  ];
"""


@pytest.fixture
def worded(chrome: Chrome, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    """A page with a robot and the longest words, after the first 2.67 s of a touch that goes on."""
    # Without a viewer, events are shown with the next status.
    monkeypatch.setattr(server, "STATUS_EVERY_S", 0.05)
    words = {gesture: Words(name=f"⟨{word}⟩", phrase=word) for gesture, word in LONG_WORDS.items()}
    hand = np.zeros((8, 8), np.uint16)
    hand[2:5, 3:6] = 80
    with serving(words=words, **ROBOT) as served:
        for _ in range(60):
            first = served.put_frame(np.zeros((8, 8), np.uint16))
        events: list[Event] = [SensorEvent(state="up", time=TIME), RobotEvent(state="up", time=TIME)]
        events.append(replace(BEGAN, sensor_ms=int.from_bytes(first[:4], "little")))
        for column in np.linspace(-2, 2, 144).round().astype(int):
            served.put_frame(np.roll(hand, column, axis=1))
        for frames, gesture in ((54, "stroke"), (81, "rub"), (144, "tickle")):
            events.append(replace(ANSWER, frames=frames, elapsed_s=frames / 54, gesture=gesture))
        said = f"Oh, das ist doch {LONG_WORDS['tickle']}! Das kenne ich gut."
        for event in (*events, replace(SAYS, what=said)):
            served.sink.put(event)
        served.put_frame(hand)
        yield served
        show_in(chrome, 1280, 800)
        prefer(chrome)


def look_at(chrome: Chrome, served: Served, anchor: str = "") -> None:
    """Load the page, until it shows the touch's last answer."""
    chrome.get("about:blank")
    chrome.get(f"http://127.0.0.1:{served.port}/{anchor}")
    wait_for(lambda: len(texts_of(chrome, "#flags li")) == 3)


SIZES = ((1280, 800), (1920, 1080), (800, 600), (390, 844), (390, 664), (360, 640), (667, 375), (844, 390))


@pytest.mark.parametrize("anchor", ["", "#visitors"])
def test_nothing_overflows_with_the_longest_words(chrome: Chrome, worded: Served, anchor: str) -> None:
    prefer(chrome, reduced_motion="reduce")
    look_at(chrome, worded, anchor)
    for width, height in SIZES:
        show_in(chrome, width, height)
        fits = bool(anchor) or min(width, height) >= 600
        with suppress(AssertionError):
            wait_for(lambda fits=fits: chrome.execute_script(PROBLEMS, fits) == [], SOON_S)
        assert chrome.execute_script(PROBLEMS, fits) == [], (width, height)


def test_a_guess_stands_at_its_moment(chrome: Chrome) -> None:
    with showing(chrome) as served:
        for number, said_s in enumerate((0.7, 2.19, 3.6), 1):
            served.sink.put(replace(BEGAN, touch=number))
            guess = {"touch": number, "perhaps": "scratch", "elapsed_s": said_s - 0.56, "age_ms": 560.0}
            served.sink.put(replace(GUESS, **guess))
            served.put_frame()
            for size in ((1600, 900), (390, 844)):
                show_in(chrome, *size)
                wait_for(lambda number=number: text_of(chrome, "#which") == f"Touch {number}")
                ((left, right),) = wait_for(lambda: sides(chrome, "#flags li").tolist())
                ((first, last),) = sides(chrome, "#flags")
                at = first + said_s / LINE_S * (last - first)
                assert at == pytest.approx(left, abs=1) or at == pytest.approx(right, abs=1)
                assert first <= left + 1
                assert right - 1 <= last
    show_in(chrome, 1280, 800)


def test_told_answers_stay_told_when_the_robot_leaves(chrome: Chrome, worded: Served) -> None:
    look_at(chrome, worded)
    told = "told the robot at 2.67 s"
    wait_for(lambda: told in text_of(chrome, "#remark"))
    worded.sink.put(RobotEvent(state="down", time=TIME, reason="unplugged"))
    worded.put_frame()
    wait_for(lambda: text_of(chrome, "#vital-robot dd") == "down")
    assert told in text_of(chrome, "#remark")
    look_at(chrome, worded)
    assert told in text_of(chrome, "#remark")


def test_a_trail_shows_where_the_hand_was(chrome: Chrome, worded: Served) -> None:
    look_at(chrome, worded)
    drawn = """const canvas = document.getElementById('trail');
      const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
      return pixels.filter((alpha, i) => i % 4 === 3 && alpha > 0).length"""
    hand = np.zeros((8, 8), np.uint16)
    hand[3:6, 0:3] = 80
    for column in range(6):
        worded.put_frame(np.roll(hand, column, axis=1))
    wait_for(lambda: chrome.execute_script(drawn) > 500)
    for _ in range(60):
        worded.put_frame(np.zeros((8, 8), np.uint16))
    wait_for(lambda: chrome.execute_script(drawn) == 0)
    assert texts_of(chrome, "#counts li") == ["0 counts", "20", "250"]


def test_another_pad_can_be_selected(chrome: Chrome) -> None:
    pads = {"head": PadSettings(port="a"), "arm": PadSettings(port="b")}
    prediction = replace(PREDICTION, touch=1)

    def choices() -> list[tuple[str, str]]:
        found = chrome.find_elements(By.CSS_SELECTOR, "#pads button")
        return [(button.text, str(button.get_attribute("aria-pressed"))) for button in found]

    with serving(sensors=pads) as served:
        chrome.get(f"http://127.0.0.1:{served.port}/")
        wait_for(lambda: choices() == [("head", "true"), ("arm", "false")])
        assert chrome.execute_script("return document.documentElement.scrollHeight <= innerHeight")
        rest, pressed = np.zeros((8, 8), np.uint16), np.full((8, 8), 500, np.uint16)
        for pad, gesture in (("head", "pat"), ("arm", "stroke")):
            served.sink.put(SensorEvent(state="up", time=TIME, pad=pad))
            for _ in range(60):
                served.put_frame(rest, pad)
            served.sink.put(TouchBegan(touch=1, time=TIME, sensor_ms=18 * 60, pad=pad))
            served.sink.put(replace(prediction, gesture=gesture, pad=pad))
        served.put_frame(pressed, "arm")
        wait_for(lambda: choices() == [("head: pat", "true"), ("arm: stroke", "false")])
        assert text_of(chrome, "#gesture") == "pat"
        untouched = chrome.execute_script(CANVAS)
        chrome.find_elements(By.CSS_SELECTOR, "#pads button")[1].click()
        wait_for(lambda: text_of(chrome, "#gesture") == "stroke")
        assert text_of(chrome, "#flags").startswith("stroke")
        assert choices() == [("head: pat", "false"), ("arm: stroke", "true")]
        wait_for(lambda: chrome.execute_script(CANVAS) != untouched)
        # Events of a pad in the list do not change the selected one.
        served.sink.put(replace(prediction, gesture="rub", pad="head"))
        served.put_frame(rest, "head")
        wait_for(lambda: choices()[0] == ("head: rub", "false"))
        assert text_of(chrome, "#gesture") == "stroke"
        assert chrome.execute_script("return document.documentElement.scrollWidth <= innerWidth")


def test_buttons_say_what_the_last_or_a_listed_touch_was(
    chrome: Chrome, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without frames, events are shown with the next status.
    monkeypatch.setattr(server, "STATUS_EVERY_S", 0.05)
    rows = (
        "return [...document.querySelectorAll('#touches li')].map((row) => /= (.*)/.exec(row.innerText)?.[1])"
    )

    def press(gesture: str) -> None:
        buttons = chrome.find_elements(By.CSS_SELECTOR, "#labels button")
        next(button for button in buttons if button.text == gesture).click()

    touches = [replace(event, touch=number) for number in (1, 2) for event in (BEGAN, ANSWER, ENDED)]
    with showing(chrome, *touches, label=True) as served:
        wait_for(lambda: chrome.execute_script(rows) == [None, None])
        # Rows are made again whenever an event arrives.
        chrome.execute_script("document.querySelector('#touches li + li button').click()")
        wait_for(lambda: text_of(chrome, "#labels legend") == "Touch 1 was")
        press("rub")
        wait_for(lambda: chrome.execute_script(rows) == [None, "rub"])
        # The next label is the last touch's again.
        assert text_of(chrome, "#labels legend") == "That was"
        press("stroke")
        wait_for(lambda: chrome.execute_script(rows) == ["stroke", "rub"])
        labels = [event for event in served.labels if isinstance(event, Label)]
        assert [(label.touch, label.gesture) for label in labels] == [(1, "rub"), (2, "stroke")]
        chrome.refresh()
        wait_for(lambda: texts_of(chrome, "#labels button[aria-pressed=true]") == ["stroke"])


@pytest.mark.slow
def test_it_reconnects_when_the_daemon_returns(played: WatchedPage, tmp_path: Path) -> None:
    chrome, port = played.chrome, free_port()
    live = LiveSettings(port=port)
    with playing(THREE_TOUCHES, 1.0, loop=True) as pad, Daemon(tmp_path, pad, live=live) as daemon:
        chrome.get(daemon.url)
        wait_for(lambda: text_of(chrome, "#vital-rate dd").startswith("5"))
        assert not is_stale(chrome)
        daemon.process.kill()
        wait_for(lambda: text_of(chrome, "#banner").startswith("No connection to touchd"))
        assert text_of(chrome, "#vital-link dd") == "reconnecting"
        assert is_stale(chrome)
    with playing(THREE_TOUCHES, SPEED, loop=True) as pad, Daemon(tmp_path, pad, live=live):
        wait_for(lambda: text_of(chrome, "#vital-link dd") == "live")
        wait_for(lambda: "pat" in listed(chrome))
        wait_for(lambda: text_of(chrome, "#banner") == "")
        wait_for(lambda: not is_stale(chrome))


def test_a_browser_that_cannot_run_the_page_shows_why(chrome: Chrome) -> None:
    height = "return document.getElementById('unable')?.getBoundingClientRect().height ?? -1"
    with serving() as served:
        page = f"http://127.0.0.1:{served.port}/"
        chrome.execute_cdp_cmd("Network.enable", {})
        chrome.execute_cdp_cmd("Animation.enable", {})
        chrome.execute_cdp_cmd("Animation.setPlaybackRate", {"playbackRate": 10})
        try:
            # As where a module has syntax that the browser does not know.
            chrome.execute_cdp_cmd("Network.setBlockedURLs", {"urls": ["*/link.js"]})
            chrome.get(page)
            assert chrome.execute_script(height) == 0
            wait_for(lambda: chrome.execute_script(height) > 20)
            assert text_of(chrome, "#unable").endswith("it is too old, or JavaScript is off.")
        finally:
            chrome.execute_cdp_cmd("Network.setBlockedURLs", {"urls": []})
            chrome.execute_cdp_cmd("Animation.setPlaybackRate", {"playbackRate": 1})
        chrome.get(page)
        wait_for(lambda: chrome.execute_script(height) == -1)
