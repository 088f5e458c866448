"""A real headless browser, for the live page's tests."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service

# Debian's packages chromium and chromium-driver.
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
# As in Chrome 88, Firefox 90 and Safari 15, the oldest browsers that the page supports.
OLDER = """
  for (const name of ['at', 'findLast', 'findLastIndex', 'toSorted']) delete Array.prototype[name];
  for (const name of ['ariaPressed', 'ariaLabel', 'ariaLive']) delete Element.prototype[name];
"""
# Not a requirement: the time that a very busy machine may need.
LOADS_WITHIN_S = 60


@contextmanager
def browser() -> Iterator[Chrome]:
    """A fresh browser that leaves nothing behind, without what the oldest supported browsers lack."""
    options = ChromeOptions()
    options.binary_location = CHROMIUM or ""
    with tempfile.TemporaryDirectory(prefix="touchd-browser-") as folder:
        for flag in (*FLAGS, f"--user-data-dir={folder}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        chrome = Chrome(options=options, service=Service(DRIVER))
        try:
            chrome.set_page_load_timeout(LOADS_WITHIN_S)
            chrome.set_script_timeout(LOADS_WITHIN_S)
            chrome.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": OLDER})
            yield chrome
        finally:
            chrome.quit()


def show_in(chrome: Chrome, width: int, height: int) -> None:
    """Set the window's size in CSS pixels; a narrow one is a phone."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def prefer(chrome: Chrome, **features: str) -> None:
    """Set a media preference; prefer(chrome, color_scheme="dark")."""
    wanted = [
        {"name": f"prefers-{name.replace('_', '-')}", "value": value} for name, value in features.items()
    ]
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": wanted})
