"""A host is found by its name, however slowly that resolves, and reached at whichever address answers."""

import logging
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
from rigs.sockets import free_port
from rigs.wait import AT_ONCE_S, wait_for

from touchd.drivers import hosts

REAL = socket.getaddrinfo
# TEST-NET-1: nobody answers there.
NOWHERE = "192.0.2.1"


class Resolver:
    """Stands in for getaddrinfo: the names that it knows, and how long it takes. asked: what it was asked."""

    def __init__(self, known: dict[str, list[str]], takes_s: float = 0.0) -> None:
        self.known, self.takes_s, self.asked = known, takes_s, list[str]()

    def __call__(self, name: str | bytes, port: int | None, **options: Any) -> list[Any]:
        host = name.decode() if isinstance(name, bytes) else name
        self.asked.append(host)
        time.sleep(self.takes_s)
        if host not in self.known:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [answer for number in self.known[host] for answer in REAL(number, port, **options)]


@pytest.fixture
def resolve(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Resolver]:
    def install(known: dict[str, list[str]], takes_s: float = 0.0) -> Resolver:
        hosts._name.cache_clear()
        resolver = Resolver(known, takes_s)
        monkeypatch.setattr(socket, "getaddrinfo", resolver)
        return resolver

    return install


@pytest.fixture
def port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


def test_a_slow_lookup_runs_once_and_outside_the_limit(
    resolve: Callable[..., Resolver],
    port: int,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(hosts, "SLOW_S", 0.1)
    resolver = resolve({"slow.local": ["127.0.0.1"]}, takes_s=0.3)
    for _ in range(3):
        hosts.connect("slow.local", port, 0.2).close()
    assert resolver.asked == ["slow.local"]
    (line,) = caplog.messages
    assert re.match(r"slow\.local takes 0\.\d s to resolve: give its number instead, 127\.0\.0\.1, or ", line)


def test_a_failed_address_starts_a_lookup_beside_the_connection(
    resolve: Callable[..., Resolver], port: int
) -> None:
    resolver = resolve({"moves.lan": ["127.0.0.1"]})
    with pytest.raises(ConnectionRefusedError):
        hosts.connect("moves.lan", free_port(), 1.0)
    wait_for(lambda: len(resolver.asked) == 2)
    resolver.takes_s = 0.5
    started_s = time.monotonic()
    hosts.connect("moves.lan", port, 1.0).close()
    assert time.monotonic() - started_s < 0.4


def test_an_unknown_name_is_named_and_tried_again(resolve: Callable[..., Resolver], port: int) -> None:
    resolver = resolve({})
    with pytest.raises(socket.gaierror, match=r"late\.lan cannot be resolved: Name or service not known"):
        hosts.connect("late.lan", port, 1.0)
    resolver.known["late.lan"] = ["127.0.0.1"]
    hosts.connect("late.lan", port, 1.0).close()


@pytest.mark.parametrize("host", ["a" * 64, "a..b", "\udcff", "a\0b", "x" * 100_000])
def test_an_impossible_name_is_an_error_of_the_system(host: str, port: int) -> None:
    with pytest.raises(OSError, match="cannot be resolved"):
        hosts.connect(host, port, 1.0)


@pytest.mark.parametrize("numbers", [["::1", "127.0.0.1"], [NOWHERE, "127.0.0.1"], ["127.0.0.1", NOWHERE]])
def test_the_address_that_answers_is_used(
    resolve: Callable[..., Resolver], port: int, numbers: list[str]
) -> None:
    resolve({"both.lan": numbers})
    started_s = time.monotonic()
    with hosts.connect("both.lan", port, 30.0) as connection:
        assert connection.getpeername() == ("127.0.0.1", port)
    assert time.monotonic() - started_s < AT_ONCE_S


@pytest.fixture
def silent() -> Iterator[int]:
    """A port that answers nobody: the queue of its listener is full."""
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        with closing(socket.create_connection(full.getsockname())):
            yield full.getsockname()[1]


def test_a_silent_host_is_given_up_at_the_limit(silent: int) -> None:
    with pytest.raises(TimeoutError, match=r"no answer within 0\.3 s"):
        hosts.dial([(socket.AF_INET, ("127.0.0.1", silent))], 0.3, threading.Event())


@pytest.mark.parametrize("takes_s", [5.0, 0.0], ids=["while the name is looked up", "while it connects"])
def test_stopping_ends_the_wait(resolve: Callable[..., Resolver], silent: int, takes_s: float) -> None:
    resolve({"slow.lan": ["127.0.0.1"]}, takes_s)
    stopping = threading.Event()
    threading.Timer(0.2, stopping.set).start()
    started_s = time.monotonic()
    with pytest.raises(OSError, match=r"slow\.lan cannot be resolved|no answer within"):
        hosts.connect("slow.lan", silent, 30.0, stopping)
    assert time.monotonic() - started_s < 2.0


def test_an_endless_lookup_is_waited_for_with_a_limit(
    resolve: Callable[..., Resolver], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    monkeypatch.setattr(hosts, "LOOKUP_S", 0.2)
    resolver = resolve({"hangs.lan": [NOWHERE]}, takes_s=3.0)
    for _ in range(3):
        with pytest.raises(socket.gaierror, match="no address within"):
            hosts.connect("hangs.lan", 9, 1.0)
    assert resolver.asked == ["hangs.lan"]
