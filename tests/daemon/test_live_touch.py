"""A pad that viewers of the page touch; nobody can touch the page of `run`."""

import itertools
import json
import signal
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.browser import show_in
from rigs.programs import TOUCHD, Program
from rigs.running_daemon import SERVED
from rigs.sensor_rig import next_frames, sensing
from rigs.wait import AT_ONCE_S, SOON_S, WITHIN_S, wait_for
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.live import touch
from touchd.daemon.live.page import FOLDER
from touchd.daemon.live.touch import Touching, TouchPage
from touchd.drivers.fakes import hand as fake_hand
from touchd.drivers.fakes.hand import SimulatedPad
from touchd.drivers.fakes.pointers import MOST_PRESSES, Pointer, PressingHands
from touchd.drivers.pad.sensor import FrameQueue

TOUCH = '{"size":"hand","at":[[1,0.5,0.5,null]]}'


def place_of(chrome: Chrome, across: float, down: float) -> dict[str, float]:
    """Return a place on the pad in the window's pixels."""
    box = "return document.querySelector('.square').getBoundingClientRect().toJSON()"
    square = chrome.execute_script(box)
    return {"x": square["x"] + square["width"] * across, "y": square["y"] + square["height"] * down}


def use_mouse(chrome: Chrome, kind: str, place: dict[str, float], **more: object) -> None:
    button = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": 1}
    chrome.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": kind, **button, **place, **more})


@pytest.fixture(scope="module")
def page(chrome: Chrome) -> Iterator[Chrome]:
    """The demo's page."""
    with Program(*TOUCHD, "demo", "--live", "0") as demo:
        served = next(found for line in demo.stdout if (found := SERVED.search(line)))
        assert any(line.startswith("pad up") for line in demo.stdout)
        show_in(chrome, 800, 600)
        chrome.get(f"{served[1]}/")
        invitation = chrome.find_element(By.ID, "invitation")
        wait_for(lambda: invitation.text == "Touch here")
        yield chrome
        demo.send_signal(signal.SIGINT)
        assert demo.wait(WITHIN_S) == 0


def test_a_hand_on_the_demos_page_is_recognised(page: Chrome) -> None:
    invitation = page.find_element(By.ID, "invitation")
    use_mouse(page, "mouseMoved", place_of(page, 0.5, 0.5))
    # The simulated hand leaves, and its touch ends.
    wait_for(lambda: page.find_element(By.ID, "which").text.startswith(("Last touch", "No touch")))
    use_mouse(page, "mousePressed", place_of(page, 0.5, 0.5))
    assert not invitation.is_displayed()
    wait_for(lambda: page.find_element(By.ID, "which").text.startswith("Touch "))
    wait_for(lambda: page.find_element(By.ID, "gesture").text == "still hand")
    use_mouse(page, "mouseReleased", place_of(page, 0.5, 0.5))
    wait_for(lambda: page.find_element(By.ID, "which").text.startswith("Last touch"))
    assert page.find_element(By.CSS_SELECTOR, "#touches b").text == "still hand"


def test_visitors_on_a_phone_read_every_line_and_find_out(page: Chrome) -> None:
    shown = """return [...document.querySelectorAll('.square, #tries, #legend')]
      .filter((one) => one.checkVisibility()).map((one) => one.getBoundingClientRect())
      .map(({ top, bottom }) => [top, bottom]).sort((a, b) => a[0] - b[0])"""
    show_in(page, 390, 844)
    button = page.find_element(By.ID, "enter")
    button.click()
    wait_for(lambda: page.execute_script("return document.body.hasAttribute('data-visitors')"))
    places = page.execute_script(shown)
    assert all(above[1] <= below[0] for above, below in itertools.pairwise(places)), places
    assert button.rect["width"] >= 40
    assert button.rect["height"] >= 30
    button.click()
    wait_for(lambda: page.find_element(By.ID, "vitals").is_displayed())


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

    def pressed(self, after: int = 25) -> NDArray[np.float64]:
        """Return the mean of some frames, (8, 8), after those in which a press settles."""
        self.frames.take_all()
        return np.mean([frame.pressure for frame in next_frames(self.frames, after + 10)[after:]], axis=0)


@pytest.fixture(scope="module")
def fake_pad(chrome: Chrome) -> Iterator[FakePad]:
    """A fake pad after a first touch, which takes the simulated hand away."""
    with Program(*TOUCHD, "fake-pad", "--live", "0") as program:
        url = next(found[1] for line in program.stdout if (found := SERVED.search(line)))
        path = next(line.split()[1] for line in program.stdout if line.startswith("pad: "))
        with sensing(path, silence_s=WITHIN_S) as frames:
            show_in(chrome, 1280, 800)
            chrome.get(f"{url}/")
            pad = FakePad(chrome, frames)
            # Nobody has touched it yet: the page invites a touch, and a simulated hand presses.
            wait_for(lambda: chrome.find_element(By.ID, "invitation").text == "Touch here")
            wait_for(lambda: any(frame.pressure.max() > 15 for frame in next_frames(frames, 10)))
            pad.mouse("mousePressed", 0.5, 0.5)
            pad.mouse("mouseReleased", 0.5, 0.5)
            yield pad
        program.terminate()
        assert program.wait(WITHIN_S) == 0


def test_a_pointer_reaches_the_fake_pads_port(fake_pad: FakePad) -> None:
    assert not fake_pad.chrome.find_element(By.ID, "invitation").is_displayed()
    # The simulated hand stays away.
    wait_for(lambda: fake_pad.pressed(0).max() < 15)
    rest = fake_pad.pressed(0)
    fake_pad.chrome.find_element(By.CSS_SELECTOR, "#sizes label:last-child").click()
    fake_pad.mouse("mousePressed", 0.31, 0.81)

    def place() -> list[float]:
        rise = np.maximum(fake_pad.pressed() - rest - 3, 1e-9)
        return [float(np.average(np.arange(8), weights=rise.sum(axis=axis))) for axis in (1, 0)]

    # Row and column of four fingertips, abreast; an outer one may press most.
    wait_for(lambda: (np.abs(np.subtract(place(), (6.0, 2.0))) < (1.0, 1.8)).all())
    fake_pad.mouse("mouseReleased", 0.31, 0.81)
    wait_for(lambda: fake_pad.pressed(0).max() < 15)


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


def test_the_chosen_size_is_marked_in_its_column(fake_pad: FakePad) -> None:
    chrome = fake_pad.chrome
    # Browsers before the end of 2023 do not know it.
    assert ":has(" not in (FOLDER / "page.css").read_text()
    chrome.find_element(By.CSS_SELECTOR, "#sizes label").click()
    weights = "[...document.querySelectorAll('#sizes span')].map(one => getComputedStyle(one).fontWeight)"
    assert chrome.execute_script(f"return {weights}") == ["600", "400"]
    outside = """const pad = document.getElementById('pad').getBoundingClientRect();
      return [...document.querySelectorAll('#sizes label')].map(one => one.getBoundingClientRect())
        .filter(box => box.left < pad.left - 1 || box.right > pad.right + 1).length"""
    # With answers beside the pad, as in the demo; without a model the pad has the page to itself.
    chrome.execute_script("document.body.removeAttribute('data-pad-only')")
    for width, height in ((844, 390), (667, 375), (1024, 430), (1280, 800)):
        show_in(chrome, width, height)
        assert chrome.execute_script(outside) == 0
    chrome.execute_script("document.body.setAttribute('data-pad-only', '')")


def test_each_finger_presses_where_it_touches(fake_pad: FakePad) -> None:
    fake_pad.fingers("touchStart", (0.19, 0.19), (0.81, 0.81))
    pressed = fake_pad.pressed()
    fake_pad.fingers("touchEnd")
    left = fake_pad.pressed(12)
    rise = pressed - left
    assert min(rise[1, 1], rise[6, 6]) > 5 * max(rise[1, 6], rise[6, 1])
    assert left.max() < 15


def test_the_pressure_of_pens_and_fingers_counts(fake_pad: FakePad) -> None:
    pressed = []
    for force in (0.15, 0.9):
        fake_pad.mouse("mousePressed", 0.19, 0.31, pointerType="pen", force=force)
        fake_pad.fingers("touchStart", (0.81, 0.31), force=force)
        pressed.append(fake_pad.pressed())
        fake_pad.fingers("touchEnd")
        fake_pad.mouse("mouseReleased", 0.19, 0.31, pointerType="pen", force=0)
    light, firm = pressed
    for half in (np.s_[:, :4], np.s_[:, 4:]):
        assert firm[half].max() > 2 * light[half].max()


@pytest.mark.slow
def test_the_simulated_hand_resumes_when_nobody_touches(fake_pad: FakePad) -> None:
    invitation = fake_pad.chrome.find_element(By.ID, "invitation")
    wait_for(lambda: any(frame.pressure.max() > 15 for frame in next_frames(fake_pad.frames, 54)))
    wait_for(lambda: invitation.text == "Touch here", fake_hand.ALONE_S + SOON_S)


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
        '{"size":"hand","at":[[1,NaN,0.5,null]]}',
        '{"size":"hand","at":[[1,null,0.5,null]]}',
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


@pytest.mark.parametrize(("message", "why"), [(TOUCH + 1000 * " ", "1009"), ("x", "not a touch")])
def test_a_viewer_that_sends_something_else_is_disconnected(message: str, why: str) -> None:
    page = TouchPage(Settings(live=LiveSettings(port=0)), None)
    page.start()
    with connect(f"ws://127.0.0.1:{page.listening.getsockname()[1]}/stream") as viewer:
        viewer.recv(timeout=WITHIN_S)
        viewer.send(message)
        with pytest.raises(ConnectionClosed, match=why):
            viewer.recv(timeout=WITHIN_S)
    page.stop(AT_ONCE_S)


def test_a_viewer_who_leaves_or_hangs_stops_pressing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(touch, "LIFTED_AFTER_S", 0.5)
    touching = Touching()
    assert touching.take("viewer", TOUCH) == ""
    assert [viewer for viewer, _ in touching.pointers()] == ["viewer"]
    wait_for(lambda: touching.pointers() == {})


def test_the_simulated_hand_waits_while_somebody_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fake_hand, "ALONE_S", 0.6)
    rng = np.random.RandomState(1)
    begun: list[str] = []
    touching = Touching()
    pad = SimulatedPad(rng, ["rub"], 3.0, touching, begun.append)
    loads = [int(pad.scan(0).sum()) for _ in range(150)]
    assert max(loads) > 3 * min(loads)
    assert begun == ["rub"]
    for scan in range(200):
        if scan % 5 == 0:
            touching.take("viewer", TOUCH)
        pad.scan(0)
    assert begun == ["rub"]
    wait_for(lambda: any(begun == ["rub", "rub"] for _ in range(54) if pad.scan(0) is not None))


def test_many_viewers_pointers_make_no_frame_late() -> None:
    hands = PressingHands(np.random.RandomState(1))
    spots = (Pointer(row, column, "hand") for row in range(8) for column in range(8))
    for turn in range(30):
        hands.frame({(turn, number): spot for number, spot in enumerate(spots)})
    assert len(hands._down) + len(hands._lifting) <= MOST_PRESSES
