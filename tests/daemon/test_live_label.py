"""The live page's buttons that say what a touch was: for viewers on this computer alone."""

import json
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from rigs.browser import show_in
from rigs.made_events import PREDICTION, TIME
from rigs.wait import WITHIN_S, wait_for
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.commands.settings import load_model
from touchd.daemon.live import server
from touchd.daemon.live.label import is_here
from touchd.daemon.live.server import LiveServer, open_live_page
from touchd.daemon.path.events import Event, Label, TouchBegan, TouchEnded
from touchd.daemon.sinks.labels import Labeller

SAID = '{"pad":"pad","touch":1,"gesture":"stroke"}'


def refusal(url: str, message: str, **options: Any) -> str:
    """Return why a viewer that sends this is disconnected."""
    with connect(url, **options) as viewer:
        viewer.send(message)
        try:
            while True:
                viewer.recv(timeout=WITHIN_S)
        except ConnectionClosed as closed:
            return str(closed)


class Labelled:
    """A page that takes labels, after one touch; events: those that the labels caused."""

    def __init__(self, page: LiveServer, events: list[Event]) -> None:
        self.page = page
        self.events = events
        self.port = page.listening.getsockname()[1]

    def touch(self, number: int) -> None:
        self.page.put(TouchBegan(touch=number, time=TIME, sensor_ms=0))
        self.page.put(msgspec.structs.replace(PREDICTION, touch=number, gesture="pat"))
        self.page.put(TouchEnded(touch=number, gesture="pat", frames=20, reason="released", time=TIME))

    @property
    def stream(self) -> str:
        return f"ws://127.0.0.1:{self.port}/stream"


@pytest.fixture
def labelled(monkeypatch: pytest.MonkeyPatch) -> Iterator[Labelled]:
    # Without frames, events are shown with the next status.
    monkeypatch.setattr(server, "STATUS_EVERY_S", 0.05)
    settings = Settings(live=LiveSettings(port=0, label=True))
    events: list[Event] = []

    def emit(event: Event) -> None:
        events.append(event)
        page.put(event)

    models = {"pad": load_model(settings)}
    labeller = Labeller(emit, {"pad": models["pad"].labels}, are_kept=True)
    page = open_live_page(settings, models, labeller)
    page.start()
    rig = Labelled(page, events)
    with connect(rig.stream) as viewer:
        # The page's state: from now on, events are shown here too.
        viewer.recv(timeout=WITHIN_S)
        rig.touch(1)
        wait_for(lambda: json.loads(viewer.recv(timeout=WITHIN_S)).get("type") == "touch_ended")
    yield rig
    page.stop(1.0)


def test_buttons_say_what_the_last_or_a_listed_touch_was(chrome: Chrome, labelled: Labelled) -> None:
    labelled.touch(2)
    show_in(chrome, 1280, 800)
    chrome.get(f"http://127.0.0.1:{labelled.port}/")
    rows = (
        "return [...document.querySelectorAll('#touches li')].map((row) => /= (.*)/.exec(row.innerText)?.[1])"
    )

    def press(gesture: str) -> None:
        buttons = chrome.find_elements(By.CSS_SELECTOR, "#labels button")
        next(button for button in buttons if button.text == gesture).click()

    wait_for(lambda: chrome.execute_script(rows) == [None, None])
    # Rows are made again whenever an event arrives.
    chrome.execute_script("document.querySelector('#touches li + li button').click()")
    wait_for(lambda: chrome.find_element(By.CSS_SELECTOR, "#labels legend").text == "Touch 1 was")
    press("rub")
    wait_for(lambda: chrome.execute_script(rows) == [None, "rub"])
    # The next label is the last touch's again.
    assert chrome.find_element(By.CSS_SELECTOR, "#labels legend").text == "That was"
    press("stroke")
    wait_for(lambda: chrome.execute_script(rows) == ["stroke", "rub"])
    labels = [event for event in labelled.events if isinstance(event, Label)]
    assert [(label.touch, label.gesture) for label in labels] == [(1, "rub"), (2, "stroke")]
    chrome.refresh()
    pressed = "#labels button[aria-pressed=true]"
    wait_for(lambda: [one.text for one in chrome.find_elements(By.CSS_SELECTOR, pressed)] == ["stroke"])


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ("x", "not a label"),
        ("[]", "not a label"),
        ('{"pad":"pad","touch":-1,"gesture":"pat"}', "not a label"),
        ('{"pad":"pad","touch":1,"gesture":"pat","more":1}', "not a label"),
        ('{"pad":"pad","touch":2,"gesture":"pat"}', "no such touch"),
        ('{"pad":"other","touch":1,"gesture":"pat"}', "no such touch"),
        ('{"pad":"pad","touch":1,"gesture":"purr"}', "no such gesture"),
        ('{"size":"hand","at":[]}', "not a label"),
    ],
)
def test_what_is_not_a_label_is_refused(labelled: Labelled, message: str, why: str) -> None:
    assert why in refusal(labelled.stream, message)
    assert labelled.events == []


@pytest.mark.parametrize("header", ["Forwarded", "X-Forwarded-For", "Via"])
def test_a_viewer_behind_a_web_server_may_not_label(labelled: Labelled, header: str) -> None:
    assert "only this computer" in refusal(labelled.stream, SAID, additional_headers={header: "203.0.113.5"})
    assert labelled.events == []


class Viewer:
    """A viewer's connection, as far as the page looks at it."""

    def __init__(self, address: str, host: str) -> None:
        self.remote_address = (address, 40000)
        self.request = Request("/stream", Headers({"Host": host}))


@pytest.mark.parametrize(
    ("address", "host", "is_ours"),
    [
        ("127.0.0.1", "127.0.0.1:8054", True),
        ("127.0.0.1", "localhost:8054", True),
        ("::1", "[::1]:8054", True),
        ("::ffff:127.0.0.1", "localhost", True),
        ("192.168.1.7", "192.168.1.2:8054", False),
        ("192.168.1.7", "localhost:8054", False),
        ("::ffff:192.168.1.7", "localhost:8054", False),
        ("fe80::1", "[::1]:8054", False),
        ("127.0.0.1", "robot.local:8054", False),
        ("127.0.0.1", "192.168.1.2:8054", False),
        ("127.0.0.1", "localhost.example.com:8054", False),
    ],
)
def test_nobody_but_this_computer_may_label(address: str, host: str, is_ours: bool) -> None:
    viewer: Any = Viewer(address, host)
    assert is_here(viewer) == is_ours
