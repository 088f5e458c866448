"""Hostile peers on loopback: each sends without end what a library may buffer."""

import itertools
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

from websockets.utils import accept_key

CONNACK = b"\x20\x02\x00\x00"
PUBACK = b"\x40\x02"
CHUNK = 64 * 1024
# Python threads share one processor: larger pieces attack faster.
Attack = Callable[[socket.socket, Callable[[], bool]], None]


@contextmanager
def server(port: int, attack: Attack) -> Iterator[list[int]]:
    """Let every client in and attack it until it leaves; yields the number of connections, in a list."""
    counts = [0]
    ended = threading.Event()
    threads: list[threading.Thread] = []

    def treat(client: socket.socket) -> None:
        with client, suppress(OSError):
            client.settimeout(1.0)
            attack(client, lambda: not ended.is_set())

    def let_in() -> None:
        while not ended.is_set():
            with suppress(OSError):
                client = door.accept()[0]
                counts[0] += 1
                threads.append(threading.Thread(target=treat, args=(client,)))
                threads[-1].start()

    with closing(socket.create_server(("127.0.0.1", port))) as door:
        door.settimeout(0.1)
        threads.append(threading.Thread(target=let_in))
        threads[0].start()
        try:
            yield counts
        finally:
            ended.set()
            for thread in threads:
                thread.join()


def send_on(client: socket.socket, goes_on: Callable[[], bool], pieces: Iterator[bytes]) -> None:
    """Send pieces for as long as the client takes them, and throw away what it sends."""

    def drain() -> None:
        with suppress(OSError):
            while goes_on() and client.recv(CHUNK):
                pass

    draining = threading.Thread(target=drain)
    draining.start()
    try:
        for piece in pieces:
            if not goes_on():
                break
            client.sendall(piece)
    finally:
        with suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)
        draining.join()


# MQTT


def publish(payload: int, number: int | None = None, claimed: int | None = None) -> bytes:
    """Return a PUBLISH, of QoS 2 with a number, of QoS 0 without. claimed: its length, if another."""
    body = b"\x00\x01t" + (struct.pack("!H", number) if number is not None else b"") + bytes(payload)
    length, sizes = len(body) if claimed is None else claimed, b""
    while True:
        length, low = divmod(length, 128)
        sizes += bytes([low | (0x80 if length else 0)])
        if not length:
            return (b"\x34" if number is not None else b"\x30") + sizes + body


def unfinished_publishes(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    client.recv(CHUNK)
    client.sendall(CONNACK)
    numbers = itertools.cycle(range(1, 65536))
    send_on(client, goes_on, (publish(10_000, number) for number in numbers))


def huge_publish(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    client.recv(CHUNK)
    client.sendall(CONNACK + publish(0, claimed=2**28 - 1))
    send_on(client, goes_on, (bytes(CHUNK) for _ in itertools.count()))


def takes_nothing(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """A broker that reads nothing after the greeting, and keeps the connection alive."""
    client.recv(CHUNK)
    client.sendall(CONNACK)
    while goes_on():
        client.sendall(b"\xd0\x00")
        time.sleep(1.0)


# rosbridge


def welcome(client: socket.socket) -> None:
    key = re.search(rb"Sec-WebSocket-Key: (.*)\r", client.recv(CHUNK))
    assert key is not None
    client.sendall(
        b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Accept: %s\r\n\r\n" % accept_key(key[1].decode()).encode()
    )


def text(content: bytes) -> bytes:
    return b"\x81\x7e" + struct.pack("!H", len(content)) + content


def empty_fragments(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    welcome(client)
    client.sendall(b"\x01\x00")
    send_on(client, goes_on, (b"\x00\x00" * 10_000 for _ in itertools.count()))


def pings(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    welcome(client)
    send_on(client, goes_on, ((b"\x89\x7d" + bytes(125)) * 100 for _ in itertools.count()))


def statuses(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Refuse everything, far more often than anything comes, each time with other words."""
    welcome(client)
    words = (f'{{"op":"status","level":"error","msg":"no {number}"}}' for number in itertools.count())
    send_on(client, goes_on, (text(word.encode()) for word in words))


def endless_answer(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    client.recv(CHUNK)
    send_on(
        client,
        goes_on,
        itertools.chain([b"HTTP/1.1 200 OK\r\n\r\n"], (bytes(CHUNK) for _ in itertools.count())),
    )


def endless_header(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    client.recv(CHUNK)
    send_on(
        client, goes_on, itertools.chain([b"HTTP/1.1 101 X\r\nA:"], (b"x" * CHUNK for _ in itertools.count()))
    )


def zeros(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    send_on(client, goes_on, (bytes(CHUNK) for _ in itertools.count()))
