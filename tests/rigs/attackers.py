"""Hostile peers on loopback: each sends without end what a library may buffer."""

import itertools
import random
import re
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

from websockets.utils import accept_key

CONNACK = b"\x20\x02\x00\x00"
WELCOME = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: %s\r\n\r\n"
)
# Python threads share one processor, so larger pieces attack faster.
CHUNK = 64 * 1024
# How many ports DDS gives each domain.
DDS_PORTS = 250
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
        door.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
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


def forward(
    client: socket.socket,
    port: int,
    goes_on: Callable[[], bool],
    first: bytes = b"",
    hold: Callable[[], bool] = bool,
) -> None:
    """Forward both ways between a client and a port of this computer. first: sent at once. hold: not now."""
    with socket.create_connection(("127.0.0.1", port)) as server:
        server.sendall(first)
        while goes_on():
            for source, other in ((client, server), (server, client)):
                if select.select([source], [], [], 0.01)[0] and not hold():
                    other.sendall(source.recv(CHUNK))


def welcome(client: socket.socket, more: bytes = b"") -> None:
    """Greet a client of MQTT or of a websocket. more: sent together with the greeting."""
    key = re.search(rb"Sec-WebSocket-Key: (.*)\r", client.recv(CHUNK))
    client.sendall((WELCOME % accept_key(key[1].decode()).encode() if key else CONNACK) + more)


# MQTT


def publish(payload: int, number: int) -> bytes:
    """Return a PUBLISH of QoS 2."""
    body = b"\x00\x01t" + struct.pack("!H", number) + bytes(payload)
    return b"\x34" + bytes([len(body) % 128 | 0x80, len(body) // 128]) + body


def unfinished_publishes(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    welcome(client)
    numbers = itertools.cycle(range(1, 65536))
    send_on(client, goes_on, (publish(10_000, number) for number in numbers))


def takes_nothing(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """A broker that reads nothing after the greeting, and keeps the connection alive."""
    welcome(client)
    while goes_on():
        client.sendall(b"\xd0\x00")
        time.sleep(1.0)


# rosbridge


def text(content: bytes) -> bytes:
    return b"\x81\x7e" + struct.pack("!H", len(content)) + content


def empty_fragments(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    welcome(client)
    client.sendall(b"\x01\x00")
    send_on(client, goes_on, (b"\x00\x00" * 10_000 for _ in itertools.count()))


def statuses(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send far more refusals than messages come in, each with different words."""
    welcome(client)
    words = (f'{{"op":"status","level":"error","msg":"no {number}"}}' for number in itertools.count())
    send_on(client, goes_on, (text(word.encode()) for word in words))


def zeros(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    send_on(client, goes_on, (bytes(CHUNK) for _ in itertools.count()))


# Robot


def never_answers(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Take what is sent, and answer nothing, not even the login."""
    while goes_on():
        with suppress(TimeoutError):
            if not client.recv(CHUNK):
                return


def claims_gigabytes(client: socket.socket, goes_on: Callable[[], bool]) -> None:
    """Send the header of a message of 4 GB, as libqi frames it, and what follows."""
    header = struct.pack("<IIIHBBIII", 0x42ADDE42, 1, 0xFFFFFF00, 0, 2, 0, 0, 0, 8)
    send_on(client, goes_on, itertools.chain([header], (bytes(CHUNK) for _ in itertools.count())))


# Attackers that connect to a daemon, or send it datagrams

Find = Callable[[], list[int]]
"""Returns the ports at which the daemon and the processes that it started listen."""


def one_connection(port: Find, goes_on: Callable[[], bool], pieces: Iterator[bytes]) -> None:
    """Send over one connection, and reconnect whenever it is closed."""
    while goes_on():
        with suppress(OSError, IndexError), socket.create_connection(("127.0.0.1", port()[0]), 1.0) as client:
            send_on(client, goes_on, pieces)
        time.sleep(0.01)


def endless_lsl_request(find: Find, goes_on: Callable[[], bool]) -> None:
    one_connection(find, goes_on, (b"x" * CHUNK for _ in itertools.count()))


def datagrams(find: Find, goes_on: Callable[[], bool]) -> None:
    """Send noise, empty datagrams, and noise that begins like DDS."""
    noise = random.Random(1)
    dds = b"RTPS\x02\x01\x01\x10"
    sent = [begin + noise.randbytes(size) for begin in (b"", dds) for size in (0, 20, 200, 1400)] * 10
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        while goes_on():
            for port, datagram in itertools.product(find(), sent):
                with suppress(OSError):
                    stranger.sendto(datagram, ("127.0.0.1", port))
            time.sleep(0.005)


def dds_participants(domain: int) -> Callable[[Find, Callable[[], bool]], None]:
    """Announce ever more participants, with copies of a real one's announcement."""

    def announce(find: Find, goes_on: Callable[[], bool]) -> None:
        first = _first_port(domain)
        original = _announcement(domain)
        prefix = original[8:20]
        numbers = itertools.count()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            while goes_on():
                # Looking up the ports takes as long as sending hundreds of datagrams.
                for port in [port for port in find() if 0 <= port - first < DDS_PORTS][:1]:
                    for number in itertools.islice(numbers, 500):
                        copy = original.replace(prefix, struct.pack("!IQ", 0x01100000, number))
                        with suppress(OSError):
                            stranger.sendto(copy, ("127.0.0.1", port))
                        if number % 20 == 0:
                            time.sleep(0.002)

    return announce


def _first_port(domain: int) -> int:
    return 7400 + DDS_PORTS * domain


def _announcement(domain: int) -> bytes:
    """Return the announcement that a real participant sends to find others in its domain."""
    participant = (
        f"from cyclonedds.domain import DomainParticipant as P; p = P({domain}); import time; time.sleep(20)"
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        # The port on which the domain's sixth participant on this computer would listen.
        listener.bind(("127.0.0.1", _first_port(domain) + 20))
        listener.settimeout(15.0)
        with subprocess.Popen([sys.executable, "-c", participant]) as process:
            try:
                return listener.recv(CHUNK)
            finally:
                process.kill()
