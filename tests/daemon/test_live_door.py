"""Access to the live page: limits, origins, hosts, and no input from viewers."""

import http.client
import socket
import time
from contextlib import ExitStack, suppress

import pytest
from rigs.live_rig import Served, frames_among
from rigs.wait import WITHIN_S
from websockets.exceptions import ConnectionClosed, InvalidStatus

from touchd.daemon.app import cli
from touchd.daemon.app.cli import complain
from touchd.daemon.app.config import ConfigError, LiveSettings
from touchd.daemon.live.address import LiveError, is_own_host, listen, own_names, parse_address
from touchd.daemon.live.page import FOLDER
from touchd.daemon.live.server import HANDSHAKE_S, MOST_CONNECTIONS
from touchd.daemon.live.viewers import MOST_VIEWERS


def test_a_viewer_over_the_limit_is_refused(served: Served) -> None:
    with ExitStack() as closing:
        viewers = [closing.enter_context(served.look()) for _ in range(MOST_VIEWERS)]
        for viewer in viewers:
            viewer.recv(timeout=WITHIN_S)
        one_more = closing.enter_context(served.look())
        with pytest.raises(ConnectionClosed, match="too many are looking already"):
            one_more.recv(timeout=WITHIN_S)
        viewers[0].close()
        wanted = served.put_frame()
        for viewer in viewers[1:]:
            frames_among(viewer, wanted)


@pytest.mark.parametrize(("said", "why"), [("x", "nothing is read here"), ("x" * 1000, "1009")])
def test_a_viewer_that_sends_data_is_disconnected(served: Served, said: str, why: str) -> None:
    with served.look() as viewer:
        viewer.recv(timeout=WITHIN_S)
        viewer.send(said)
        with pytest.raises(ConnectionClosed, match=why):
            viewer.recv(timeout=WITHIN_S)


def test_half_open_connections_lock_nobody_out(served: Served) -> None:
    with served.look() as viewer, ExitStack() as closing:
        viewer.recv(timeout=WITHIN_S)
        idle = [
            closing.enter_context(socket.create_connection(("127.0.0.1", served.port), timeout=WITHIN_S))
            for _ in range(3 * MOST_CONNECTIONS)
        ]
        began_s = time.monotonic()
        # The first is closed before it times out.
        with suppress(ConnectionResetError):
            assert idle[0].recv(1) == b""
        for _ in range(5):
            assert served.ask("/").status == 200
            with served.look() as another:
                another.recv(timeout=WITHIN_S)
        frames_among(viewer, served.put_frame())
        assert time.monotonic() - began_s < HANDSHAKE_S


@pytest.mark.parametrize("path", ["/", *sorted(f"/{path.name}" for path in FOLDER.iterdir())])
def test_the_page_loads_nothing_from_elsewhere(served: Served, path: str) -> None:
    answer = served.ask(path)
    assert answer.status == 200
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    text = answer.read().decode()
    assert text == (FOLDER / (path[1:] or "page.html")).read_text()
    assert "://" not in text.replace("http://www.w3.org/2000/svg", "").replace("${scheme}//", "")


@pytest.mark.parametrize("path", ["/server.py", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/x"])
def test_other_paths_are_not_found(served: Served, path: str) -> None:
    assert served.ask(path).status == 404


def test_only_get_requests_are_accepted(served: Served) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=WITHIN_S)
    with suppress(http.client.RemoteDisconnected):
        connection.request("POST", "/", body=b"x")
        assert connection.getresponse().status >= 400
    assert served.ask("/").status == 200


@pytest.mark.parametrize("path", ["/", "/stream"])
def test_a_foreign_host_name_is_refused(served: Served, path: str) -> None:
    answer = served.ask(path, Host=f"evil.example:{served.port}")
    assert answer.status == 403
    assert "live:\n    host: NAME" in answer.read().decode()


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_foreign_origin_gets_no_stream(served: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), served.look(origin=origin):
        pass
    with served.look(origin=f"http://127.0.0.1:{served.port}") as viewer:
        viewer.recv(timeout=WITHIN_S)


@pytest.mark.parametrize(
    ("host", "is_own"),
    [
        ("localhost", True),
        ("LOCALHOST:9000", True),
        ("127.0.0.1:8054", True),
        ("192.168.1.7:8054", True),
        ("[::1]:8054", True),
        ("robot.lab:8054", True),
        ("evil.example", False),
        ("localhost.evil.example:8054", False),
        ("127.0.0.1.evil.example", False),
        ("localhost:8054:8054", False),
        ("", False),
    ],
)
def test_own_host_names_and_addresses_are_recognised(host: str, is_own: bool) -> None:
    assert is_own_host(host, frozenset({"localhost", "robot.lab"})) is is_own


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "10.0.0.1", 99),
        ("8080", "10.0.0.1", 8080),
        (":8080", "10.0.0.1", 8080),
        ("0.0.0.0:8080", "0.0.0.0", 8080),
        ("[::1]:8080", "::1", 8080),
    ],
)
def test_missing_parts_of_an_address_come_from_the_configuration(text: str, host: str, port: int) -> None:
    assert parse_address(text, LiveSettings(host="10.0.0.1", port=99)) == LiveSettings(host=host, port=port)


def test_by_default_only_this_computer_sees_the_page() -> None:
    assert parse_address("", None) == LiveSettings(host="127.0.0.1", port=8054)


@pytest.mark.parametrize(
    "text", ["x", "localhost", "localhost:", "1:65536", "1:-1", "1:²", "::1", "fe80::1:8080"]
)
def test_an_invalid_address_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"not \[HOST:\]PORT"):
        parse_address(text, None)


@pytest.mark.parametrize("command", ["run", "demo"])
def test_a_port_in_use_is_reported_in_one_line(command: str, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main([command, "--live", str(port)]) == 2
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1
    assert f"cannot listen on 127.0.0.1 port {port}: another program does" in said[0]
    assert "--live 8061" in said[0]


def test_a_name_with_an_ipv6_address_alone_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    six = (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 0, 0, 0))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [six])
    with listen(LiveSettings(host="localhost", port=0)) as listening:
        assert listening.getsockname()[0] == "::1"


def test_a_name_with_both_addresses_is_served_at_ipv4() -> None:
    with listen(LiveSettings(host="localhost", port=0)) as listening:
        assert listening.getsockname()[0] == "127.0.0.1"


@pytest.mark.parametrize("found", [("192.0.2.1", 0), None], ids=["elsewhere", "nowhere"])
def test_a_name_of_another_computer_is_served_and_answered_to(
    found: tuple[str, int] | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    look_up = socket.getaddrinfo

    def getaddrinfo(host: str, *arguments: object, **options: object) -> object:
        if host != "labserver":
            return look_up(host, *arguments, **options)  # type: ignore[arg-type]
        if found is None:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", found)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    settings = LiveSettings(host="labserver", port=0)
    with listen(settings) as listening:
        assert listening.getsockname()[0] == "0.0.0.0"
    assert "labserver is no name of this computer; serving at all of its addresses" in caplog.text
    assert is_own_host("labserver:8054", own_names(settings))


def test_an_address_of_another_computer_is_refused_and_tried_again_by_systemd() -> None:
    with pytest.raises(LiveError, match="this computer has no such address") as raised:
        listen(LiveSettings(host="192.0.2.1", port=0))
    # At boot the address may come late; systemd does not start the service again after 2.
    assert complain(raised.value) == 1
