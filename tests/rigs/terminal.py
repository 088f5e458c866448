"""A program on a terminal, which a test reads and types at."""

import os
import pty
import re
import select
import subprocess
import sys
import time

SHOWS_WITHIN_S = 50.0
ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


class Terminal:
    """Runs `touchd` with these arguments on a pty of 80x24."""

    def __init__(self, *arguments: str) -> None:
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "touchd.daemon", *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"},
            start_new_session=True,
        )
        os.close(slave)
        self._unread = ""
        self.shown = ""

    def until(self, text: str) -> str:
        """Wait until a text is shown; return everything up to it, without escape sequences."""
        until_s = time.monotonic() + SHOWS_WITHIN_S
        while text not in self._unread:
            assert self._receive(until_s), f"{text!r} was not shown; this was: {self._unread}"
        before, _, self._unread = self._unread.partition(text)
        self.shown += before + text
        return before

    def until_one(self, *texts: str, within_s: float = SHOWS_WITHIN_S) -> str:
        """Wait until one of these texts is shown; return it."""
        pattern = "|".join(map(re.escape, texts))
        until_s = time.monotonic() + within_s
        while not (found := re.search(pattern, self._unread)):
            assert self._receive(until_s), f"none of {texts} was shown; this was: {self._unread}"
        self.until(found[0])
        return found[0]

    def answer(self, line: str, *then: str) -> None:
        """Type a line, and wait until each of these texts is shown."""
        os.write(self._master, f"{line}\n".encode())
        for text in then:
            self.until(text)

    def close(self) -> None:
        """Close the terminal while its program runs."""
        os.dup2(os.open(os.devnull, os.O_RDWR), self._master)

    def _receive(self, until_s: float) -> bool:
        """Take what is shown next; returns whether there was anything."""
        ready, _, _ = select.select([self._master], [], [], max(0.0, until_s - time.monotonic()))
        data = self._read() if ready else b""
        self._unread = ESCAPES.sub("", self._unread + data.decode(errors="replace"))
        return bool(data)

    def _read(self) -> bytes:
        try:
            return os.read(self._master, 65536)
        except OSError:
            # A terminal whose program has ended cannot be read.
            return b""

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self._master)
