"""The server's side of QiMessaging, for a stand-in robot: plain Python objects as services, on 127.0.0.1."""

import inspect
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from touchd.drivers.robot import wire
from touchd.drivers.robot.values import read, write

DIRECTORY, FIRST_ACTION = 1, 100
SIGNATURES = {str: "s", int: "i", float: "f", bool: "b", None: "v"}
META_OBJECT = "({I(Issss[(ss)]s)}{I(Iss)}{I(Iss)}s)"
SERVICE_INFO = "(sIsI[s]ss)"
MACHINE = "touchd-fake-robot"
# qi's clients subscribe to services that come and go, which none does here.
SIGNALS = {106: (106, "serviceAdded", "(Is)"), 107: (107, "serviceRemoved", "(Is)")}


class Action(NamedTuple):
    """A method that can be called. takes, gives: signatures of its parameters and its answer."""

    name: str
    takes: str
    gives: str
    run: Callable[..., Any]


COMMON = {
    0: Action("registerEvent", "(IIL)", "L", lambda *_: 0),
    1: Action("unregisterEvent", "(IIL)", "v", lambda *_: None),
    wire.LIST_METHODS: Action("metaObject", "(I)", META_OBJECT, lambda _: None),
}


class QiServer:
    """Serves objects by name to any number of clients until it is closed.

    A service's public methods are its actions; their annotations give the signatures. port: 0 for any.
    Raises OSError.
    """

    def __init__(self, services: Mapping[str, object], port: int) -> None:
        self._listener = socket.create_server(("127.0.0.1", port))
        self.url = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._numbers = {name: number for number, name in enumerate(services, DIRECTORY + 1)}
        self._objects = {self._numbers[name]: _actions(service) for name, service in services.items()}
        self._objects[DIRECTORY] = self._directory()
        threading.Thread(target=self._let_in, name="touchd-qi-server", daemon=True).start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _let_in(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        """Answer one client's calls, one after the other, until it leaves or sends no valid message."""
        with client, suppress(OSError, struct.error):
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while header := client.recv(wire.HEADER.size, socket.MSG_WAITALL):
                magic, number, size, version, kind, _, *target = wire.HEADER.unpack(header)
                if magic != wire.MAGIC or size > wire.MOST_BYTES:
                    return
                payload = client.recv(size, socket.MSG_WAITALL) if size else b""
                if kind != wire.CALL:
                    continue
                try:
                    kind, answer = wire.REPLY, self._answer(target, payload)
                except (RuntimeError, LookupError, ValueError, struct.error) as error:
                    kind, answer = wire.ERROR, write("m", str(error))
                header = wire.HEADER.pack(wire.MAGIC, number, len(answer), version, kind, 0, *target)
                client.sendall(header + answer)

    def _answer(self, target: list[int], payload: bytes) -> bytes:
        """Return the payload of the answer to a call; raises what the robot answers with an error."""
        if tuple(target) == wire.AUTHENTICATE:
            return write("{sm}", {**wire.CAPABILITIES, wire.AUTH_STATE: wire.DONE})
        service, _, number = target
        actions = self._objects[service] | COMMON
        if number == wire.LIST_METHODS:
            signals = SIGNALS if service == DIRECTORY else {}
            methods = {n: (n, each.gives, each.name, each.takes, "", (), "") for n, each in actions.items()}
            return write(META_OBJECT, (methods, signals, {}, ""))
        action = actions[number]
        return write(action.gives, action.run(*read(action.takes, payload)))

    def _directory(self) -> dict[int, Action]:
        def service(name: str) -> object:
            if name not in self._numbers:
                raise RuntimeError(f"Cannot find service '{name}' in index")
            return (name, self._numbers[name], MACHINE, 1, [self.url], "", "")

        return {
            wire.FIND_SERVICE[2]: Action("service", "(s)", SERVICE_INFO, service),
            108: Action("machineId", "()", "s", lambda: MACHINE),
        }


def _actions(service: object) -> dict[int, Action]:
    """Return what a service's public methods become, by their numbers."""
    found: list[Action] = []
    for name, method in inspect.getmembers(service, inspect.ismethod):
        if not name.startswith("_"):
            hints = inspect.signature(method)
            takes = "".join(SIGNATURES.get(each.annotation, "m") for each in hints.parameters.values())
            found.append(Action(name, f"({takes})", SIGNATURES.get(hints.return_annotation, "m"), method))
    return dict(enumerate(found, FIRST_ACTION))
