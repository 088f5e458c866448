"""A pad that viewers of the page touch; nobody can touch the page of `run`."""

import itertools
import json
import math
import random
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.browser import show_in
from rigs.programs import TOUCHD, Program
from rigs.running_daemon import SERVED, Daemon
from rigs.sensor_rig import next_frames, sensing
from rigs.wait import SOON_S, WITHIN_S, wait_for
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.live.address import listen
from touchd.daemon.live.memory import Scene
from touchd.daemon.live.touch import LIFTED_AFTER_S, MESSAGES_PER_S, Touching
from touchd.daemon.playback.touched import TouchPage
from touchd.drivers.fakes import hand as fake_hand
from touchd.drivers.fakes.hand import PlayedHand, SimulatedPad
from touchd.drivers.fakes.pointers import MOST_PRESSES, Pointer, PressingHands
from touchd.drivers.pad.sensor import FrameQueue

TRIES = 5
# A mouse reports every few milliseconds; a browser passes this on once per repaint.
STEP_S = 0.015
TOUCH = '{"size":"hand","at":[[1,0.5,0.5,null]]}'

# Moves a pointer for two seconds on a 250 Hz screen; returns how many messages the page sent.
FAST_SCREEN = """
  const done = arguments[0];
  import('/touch.js').then(({ Touch }) => {
    const square = document.createElement('div');
    square.setPointerCapture = () => {};
    square.getBoundingClientRect = () => ({ left: 0, top: 0, width: 100, height: 100 });
    let [now, sent, due] = [1000, 0, []];
    const draw = window.requestAnimationFrame;
    performance.now = () => now;
    window.requestAnimationFrame = (what) => due.push(what);
    new Touch(square, document.createElement('p'), () => 'hand', () => sent++).use(true);
    const place = (step) => ({ pointerId: -7, button: 0, clientX: step % 100, clientY: 50 });
    square.dispatchEvent(new PointerEvent('pointerdown', place(0)));
    for (let step = 1; step <= 500; step++) {
      now += 4;
      square.dispatchEvent(new PointerEvent('pointermove', place(step)));
      const drawn = due;
      due = [];
      drawn.forEach((what) => what(now));
    }
    square.dispatchEvent(new PointerEvent('pointerup', place(0)));
    delete performance.now;
    window.requestAnimationFrame = draw;
    done(sent);
  });
"""

# Moves a mouse onto a pad without pressing it; returns what the page sent.
COME_NEAR = """
  const done = arguments[0];
  import('/touch.js').then(({ Touch }) => {
    const square = document.createElement('div');
    new Touch(square, document.createElement('p'), () => 'hand', done).use(true);
    square.dispatchEvent(new PointerEvent('pointerenter', { pointerId: 1, pointerType: 'mouse' }));
  });
"""

# Moves a pointer along places, staying stepMs at each; null lifts it.
FOLLOW_ROUTE = """
  const [places, stepMs, done] = arguments;
  const square = document.querySelector('.square');
  square.setPointerCapture = () => {};
  const box = square.getBoundingClientRect();
  const begun = performance.now();
  let down = null;
  const tell = (kind, [x, y]) => square.dispatchEvent(new PointerEvent(kind, {
    pointerId: 1, pointerType: 'mouse', bubbles: true, button: 0, buttons: 1, pressure: 0.5,
    clientX: box.left + x * box.width, clientY: box.top + y * box.height,
  }));
  const moving = setInterval(() => {
    const place = places[Math.floor((performance.now() - begun) / stepMs)] ?? null;
    if (place !== null) tell(down === null ? 'pointerdown' : 'pointermove', place);
    else if (down !== null) tell('pointerup', down);
    down = place;
    if (place !== null || performance.now() - begun < places.length * stepMs) return;
    clearInterval(moving);
    done();
  }, 5);
"""

# Counts, for five seconds, how often the browser repaints and how often it draws the pad.
COUNT_PICTURES = """
  window.pictures = { browser: 0, pad: 0, begun: performance.now() };
  const put = CanvasRenderingContext2D.prototype.putImageData;
  CanvasRenderingContext2D.prototype.putImageData = function (...all) {
    if (!pictures.seconds) pictures.pad++;
    put.apply(this, all);
  };
  const count = () => {
    pictures.browser++;
    if (!pictures.seconds) requestAnimationFrame(count);
  };
  requestAnimationFrame(count);
  setTimeout(() => { pictures.seconds = (performance.now() - pictures.begun) / 1000; }, 5000);
"""

# A place on the pad, across and down from 0 to 1, at a time in seconds; None while the pointer is up.
Route: TypeAlias = Callable[[float], tuple[float, float] | None]


def one_stroke(rng: random.Random) -> Route:
    """A stroke of half a second downwards, as most people stroked in the recordings."""
    across = rng.uniform(0.4, 0.6)
    return lambda time_s: (across, 0.15 + 1.4 * time_s)


def pats(rng: random.Random) -> Route:
    at = rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.6)
    return lambda time_s: at if time_s % 0.44 < 0.12 else None


def quick_rub(rng: random.Random) -> Route:
    """A rub up and down, as wide and as quick as most in the recordings."""
    pace_hz, reach = rng.uniform(1.3, 2.0), rng.uniform(0.12, 0.2)
    return lambda time_s: (0.5, 0.5 + reach * math.sin(2 * math.pi * pace_hz * time_s))


def still_hand(rng: random.Random) -> Route:
    at = rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.6)
    return lambda time_s: at


def place_of(chrome: Chrome, across: float, down: float) -> dict[str, float]:
    """Return a place on the pad in the window's pixels."""
    square = chrome.execute_script(
        "return document.querySelector('.square').getBoundingClientRect().toJSON()"
    )
    return {"x": square["x"] + square["width"] * across, "y": square["y"] + square["height"] * down}


def use_mouse(chrome: Chrome, kind: str, place: dict[str, float], **more: object) -> None:
    button = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": 1}
    chrome.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": kind, **button, **place, **more})


def perform(chrome: Chrome, route: Route, seconds: float) -> None:
    """Move a pointer over the pad at the pace of the route, on a busy machine in larger steps."""
    places = [route(step * STEP_S) for step in range(round(seconds / STEP_S))]
    chrome.execute_async_script(FOLLOW_ROUTE, places, 1000 * STEP_S)


@pytest.fixture(scope="module")
def page(chrome: Chrome) -> Iterator[Chrome]:
    """The demo's page after a first touch, which takes the simulated hand away."""
    with Program(*TOUCHD, "demo", "--live", "0") as demo:
        served = next(found for line in demo.stdout if (found := SERVED.search(line)))
        assert any(line.startswith("pad up") for line in demo.stdout)
        show_in(chrome, 800, 600)
        chrome.get(f"{served[1]}/")
        invitation = chrome.find_element(By.ID, "invitation")
        wait_for(lambda: invitation.text == "Touch here")
        perform(chrome, still_hand(random.Random(1)), 1.0)
        wait_for(lambda: not invitation.is_displayed())
        yield chrome
        demo.terminate()
        assert demo.wait(WITHIN_S) == 0


def test_visitors_on_a_phone_can_read_every_line(page: Chrome) -> None:
    shown = """
      const seen = [...document.querySelectorAll('.square, #tries, #legend')]
        .filter((one) => one.checkVisibility()).map((one) => one.getBoundingClientRect());
      return seen.map(({ top, bottom }) => [top, bottom]).sort((a, b) => a[0] - b[0]);
    """
    show_in(page, 390, 844)
    page.find_element(By.ID, "enter").click()
    try:
        wait_for(lambda: page.execute_script("return document.body.hasAttribute('data-visitors')"))
        places = page.execute_script(shown)
        assert all(above[1] <= below[0] for above, below in itertools.pairwise(places)), places
    finally:
        page.find_element(By.ID, "enter").click()
        show_in(page, 800, 600)


class FakePad(NamedTuple):
    """A fake pad: its page in a browser, and the frames that come out of its serial port."""

    chrome: Chrome
    frames: FrameQueue

    def mouse(self, kind: str, across: float, down: float, **more: object) -> None:
        use_mouse(self.chrome, kind, place_of(self.chrome, across, down), **more)

    def fingers(self, kind: str, *places: tuple[float, float], **more: object) -> None:
        points = [
            {"id": number, **place_of(self.chrome, *place), **more} for number, place in enumerate(places)
        ]
        self.chrome.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def pressed(self) -> NDArray[np.float64]:
        """Return the mean of the next quarter of a second of frames, once a press has settled, (8, 8)."""
        next_frames(self.frames, 30)
        self.frames.take_all()
        return np.mean([frame.pressure for frame in next_frames(self.frames, 14)], axis=0)


@pytest.fixture(scope="module")
def fake_pad(chrome: Chrome) -> Iterator[FakePad]:
    """A fake pad after a first touch, which takes the simulated hand away."""
    with Program(*TOUCHD, "fake-pad", "--live", "0", "--gestures", "constant", "--every", "3") as program:
        url = next(found[1] for line in program.stdout if (found := SERVED.search(line)))
        path = next(line.split()[1] for line in program.stdout if line.startswith("pad: "))
        with sensing(path, silence_s=WITHIN_S) as frames:
            show_in(chrome, 1280, 800)
            chrome.get(f"{url}/")
            pad = FakePad(chrome, frames)
            # Nobody has touched it yet: the page invites a touch, and a simulated hand presses.
            wait_for(lambda: chrome.find_element(By.ID, "invitation").text == "Touch here")
            wait_for(lambda: next_frames(frames, 1)[0].pressure.max() > 50)
            pad.mouse("mousePressed", 0.5, 0.5)
            pad.mouse("mouseReleased", 0.5, 0.5)
            yield pad
        program.terminate()
        assert program.wait(WITHIN_S) == 0


def test_a_pointer_reaches_the_fake_pads_port(fake_pad: FakePad) -> None:
    assert not fake_pad.chrome.find_element(By.ID, "invitation").is_displayed()
    # The simulated hand stays away.
    wait_for(lambda: fake_pad.pressed().max() < 15)
    rest = fake_pad.pressed()
    fake_pad.chrome.find_element(By.CSS_SELECTOR, "#sizes label:last-child").click()
    fake_pad.mouse("mousePressed", 0.31, 0.81)

    def place() -> list[float]:
        rise = np.maximum(fake_pad.pressed() - rest - 3, 1e-9)
        return [float(np.average(np.arange(8), weights=rise.sum(axis=axis))) for axis in (1, 0)]

    # Row and column of four fingertips; one presses more than another.
    wait_for(lambda: np.abs(np.subtract(place(), (6.0, 2.0))).max() < 1.0)
    fake_pad.mouse("mouseReleased", 0.31, 0.81)
    wait_for(lambda: fake_pad.pressed().max() < 15)


def test_the_page_of_a_pad_alone_is_filled_with_it(fake_pad: FakePad) -> None:
    chrome = fake_pad.chrome
    wait_for(lambda: chrome.find_element(By.CSS_SELECTOR, "#vital-pad dd").text == "up")
    square = chrome.find_element(By.CSS_SELECTOR, ".square").rect
    assert square["height"] > 0.7 * 800
    assert abs(square["x"] + square["width"] / 2 - 640) < 10
    assert chrome.find_element(By.ID, "tries").is_displayed()
    for width, height in ((390, 844), (844, 390), (1280, 800)):
        show_in(chrome, width, height)
        wait_for(lambda width=width: chrome.execute_script("return innerWidth") == width)
        assert chrome.execute_script("return document.documentElement.scrollWidth") <= width


def test_fingers_press_where_each_touches(fake_pad: FakePad) -> None:
    fake_pad.fingers("touchStart", (0.19, 0.19), (0.81, 0.81))
    pressed = fake_pad.pressed()
    fake_pad.fingers("touchEnd")
    rise = pressed - fake_pad.pressed()
    assert min(rise[1, 1], rise[6, 6]) > 5 * max(rise[1, 6], rise[6, 1])
    assert fake_pad.pressed().max() < 15


def test_the_pressure_of_pens_and_fingers_counts(fake_pad: FakePad) -> None:
    pen: list[float] = []
    finger: list[float] = []
    for force in (0.15, 0.9):
        fake_pad.mouse("mousePressed", 0.31, 0.31, pointerType="pen", force=force)
        pen.append(float(fake_pad.pressed().max()))
        fake_pad.mouse("mouseReleased", 0.31, 0.31, pointerType="pen", force=0)
        fake_pad.fingers("touchStart", (0.81, 0.31), force=force)
        finger.append(float(fake_pad.pressed().max()))
        fake_pad.fingers("touchEnd")
    assert pen[1] > 2 * pen[0]
    assert finger[1] > 2 * finger[0]


def test_a_fast_screen_sends_no_more_than_is_taken(fake_pad: FakePad) -> None:
    assert 100 < fake_pad.chrome.execute_async_script(FAST_SCREEN) < 2.0 * MESSAGES_PER_S


@pytest.mark.slow
def test_the_hand_goes_on_when_nobody_touches(fake_pad: FakePad) -> None:
    invitation = fake_pad.chrome.find_element(By.ID, "invitation")
    wait_for(lambda: next_frames(fake_pad.frames, 1)[0].pressure.max() > 50)
    wait_for(lambda: invitation.text == "Touch here", fake_hand.ALONE_S + SOON_S)


# A busy machine delays frames, and the quick suite keeps all cores busy.
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("gesture", "route", "seconds"),
    [
        ("still hand", still_hand, 3.0),
        ("stroke", one_stroke, 0.5),
        ("pat", pats, 1.3),
        ("rub", quick_rub, 3.0),
    ],
)
def test_gestures_of_a_mouse_are_recognised(
    page: Chrome, gesture: str, route: Callable[[random.Random], Route], seconds: float
) -> None:
    rng = random.Random(7)
    named: Counter[str] = Counter()
    for _ in range(TRIES):
        # The last touch has ended, and the pad was quiet.
        wait_for(lambda: page.find_element(By.ID, "which").text.startswith("Last touch"))
        before = page.find_element(By.ID, "which").text
        perform(page, route(rng), seconds)
        wait_for(
            lambda before=before: (
                page.find_element(By.ID, "which").text.startswith("Last touch")
                and page.find_element(By.ID, "which").text != before
            )
        )
        named[page.find_element(By.CSS_SELECTOR, "#touches b").text] += 1
    assert named[gesture] >= TRIES - 1, named


# As above: on busy cores the browser skips repaints.
@pytest.mark.slow
def test_a_touch_is_drawn_sixty_times_a_second(page: Chrome) -> None:
    page.execute_script(COUNT_PICTURES)
    perform(page, quick_rub(random.Random(3)), 5.5)
    browser, pad, seconds = page.execute_script("return [pictures.browser, pictures.pad, pictures.seconds]")
    assert browser / seconds > 57
    # The pad sends 54 frames a second.
    assert pad / seconds > 50


def refusal(url: str, messages: Sequence[str]) -> str:
    """Return the reason for which a page disconnects a viewer that sends these messages."""
    with connect(url) as viewer:
        try:
            for message in messages:
                viewer.send(message)
            while True:
                viewer.recv(timeout=WITHIN_S)
        except ConnectionClosed as closed:
            return str(closed)


def test_nobody_can_touch_the_page_of_the_daemon(tmp_path: Path) -> None:
    with Daemon(tmp_path, live=LiveSettings(port=0)) as daemon:
        url = f"{daemon.url.replace('http', 'ws')}/stream"
        assert "nothing is read here" in refusal(url, [TOUCH])
        with connect(url) as viewer:
            assert json.loads(viewer.recv(timeout=WITHIN_S))["touchable"] is False


@pytest.mark.parametrize(
    "message",
    [
        "x",
        "[]",
        '{"size":"fist","at":[]}',
        '{"size":"hand","at":[[1,0.5,1.5,null]]}',
        '{"size":"hand","at":[[1,0.5,-0.1,null]]}',
        '{"size":"hand","at":[[1,0.5,0.5,2]]}',
        '{"size":"hand","at":[[-1,0.5,0.5,null]]}',
        '{"size":"hand","at":[[1,0.5,1e999,null]]}',
        '{"size":"hand","at":[[1,NaN,0.5,null]]}',
        '{"size":"hand","at":[[1,null,0.5,null]]}',
        '{"size":"hand","at":[[1,0.5,0.5,-0.1]]}',
        '{"size":"hand","at":[[1e300,0.5,0.5,null]]}',
        '{"size":"hand","at":[],"speed":1}',
        500 * "[",
        b"\xff\xfe{}",
        json.dumps({"size": "hand", "at": [[n, 0.5, 0.5, None] for n in range(11)]}),
    ],
)
def test_a_message_that_is_not_a_touch_is_refused(message: str | bytes) -> None:
    touching = Touching()
    assert touching.take("viewer", message) == "not a touch"
    assert touching.pointers() == {}


def test_a_viewer_that_sends_too_much_is_disconnected() -> None:
    with listen(LiveSettings(port=0)) as listening:
        page = TouchPage(listening, LiveSettings(), Scene(Settings(), None))
        page.start()
        url = f"ws://127.0.0.1:{listening.getsockname()[1]}/stream"
        assert "1009" in refusal(url, [TOUCH + 1000 * " "])
        assert re.search("too many messages|no close frame", refusal(url, 1000 * [TOUCH]))
        page.stop()


def test_messages_are_limited_in_number() -> None:
    touching = Touching()
    answers = [touching.take("viewer", TOUCH) for _ in range(round(2 * MESSAGES_PER_S))]
    assert answers[0] == ""
    assert answers[-1] == "too many messages"
    assert touching.take("another viewer", TOUCH) == ""


def test_a_viewer_who_leaves_or_hangs_stops_pressing() -> None:
    touching = Touching()
    for viewer in ("leaves", "hangs"):
        assert touching.take(viewer, TOUCH) == ""
    touching.leave("leaves")
    assert [viewer for viewer, _ in touching.pointers()] == ["hangs"]
    time.sleep(LIFTED_AFTER_S + 0.1)
    assert touching.pointers() == {}


def test_the_simulated_hand_waits_while_somebody_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fake_hand, "ALONE_S", 0.3)
    rng = np.random.RandomState(1)
    begun: list[str] = []
    touching = Touching()
    pad = SimulatedPad(rng, PlayedHand(["rub"], 3.0, rng, begun.append), touching)
    loads = [int(pad.scan(0).sum()) for _ in range(150)]
    assert max(loads) > 3 * min(loads)
    assert begun == ["rub"]
    for scan in range(200):
        if scan % 5 == 0:
            touching.take("viewer", TOUCH)
        pad.scan(0)
    assert begun == ["rub"]
    touching.leave("viewer")
    time.sleep(0.4)
    for _ in range(150):
        pad.scan(0)
    assert begun == ["rub", "rub"]


def test_the_simulated_hand_leaves_as_a_mouse_comes_near(fake_pad: FakePad) -> None:
    rng, touching = np.random.RandomState(1), Touching()
    pad = SimulatedPad(rng, PlayedHand(["constant"], 3.0, rng), touching)
    pressed = [int(pad.scan(0).sum()) for _ in range(150)]
    assert touching.take("viewer", fake_pad.chrome.execute_async_script(COME_NEAR)) == ""
    left = [int(pad.scan(0).sum()) for _ in range(150)]
    assert max(pressed) > 3 * max(left[10:])


def test_many_viewers_pointers_make_no_frame_late() -> None:
    hands = PressingHands(np.random.RandomState(1))
    spots = (Pointer(row, column, "hand") for row in range(8) for column in range(8))
    for turn in range(30):
        hands.frame({(turn, number): spot for number, spot in enumerate(spots)})
    assert len(hands._down) + len(hands._lifting) <= MOST_PRESSES
