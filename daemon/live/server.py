"""Serves the live page from a thread with its own event loop.

It sends events unchanged, frames, state and status; all but the frames are JSON. A frame has 133 bytes,
little-endian: its sensor_ms (uint32), 64 counts (uint16), and the pad's place in the state's `pads` (uint8).
"""

import asyncio
import logging
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import TypeAlias

import msgspec
from websockets.asyncio.server import ServerConnection, broadcast, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.live.address import ip_of, listen, own_names, urls_of
from touchd.daemon.live.memory import Memory
from touchd.daemon.live.page import Page
from touchd.daemon.live.viewers import MOST_VIEWERS, Connection, Viewers, take_label
from touchd.daemon.path.events import Event, LivePrediction, RobotEvent
from touchd.daemon.sinks.labels import Labeller
from touchd.drivers.frame import DEFAULT_PAD, Frame
from touchd.drivers.queue import DroppingQueue
from touchd.model.classifier import Classifier

log = logging.getLogger(__name__)

# Ten seconds of frames; they wait only when the machine is overloaded.
CAPACITY = 540
STATUS_EVERY_S = 0.5
MOST_MESSAGE_BYTES = 512
HANDSHAKE_S = 5.0
PING_EVERY_S = 5.0
GOODBYE_S = 0.2

Item: TypeAlias = Event | LivePrediction | tuple[Frame, str]
# Takes a viewer's message; returns why it is refused, or "".
TakeMessage: TypeAlias = Callable[[ServerConnection, str | bytes], str]


class LiveServer:
    """A sink that serves the page; taking events and frames never blocks. Raises LiveError.

    models: of each pad, None if nothing is recognised. touching: takes viewers' presses on a simulated pad.
    labeller: takes the labels of viewers on this computer. Without either, viewers can send nothing.
    """

    def __init__(
        self,
        settings: Settings,
        models: Mapping[str, Classifier | None],
        touching: TakeMessage | None = None,
        labeller: Labeller | None = None,
    ) -> None:
        live = self._live = settings.live or LiveSettings()
        self.listening = listen(live)
        self.urls = urls_of(live, self.listening.getsockname()[1])
        self._pads = {name: Memory(pad, models[name]) for name, pad in settings.pads.items()}
        self._is_touchable = touching is not None
        self._take_message = partial(take_label, labeller, self._pads) if labeller else touching
        self._page = Page(own_names(live))
        self._viewers = Viewers()
        self._items: DroppingQueue[Item] = DroppingQueue(CAPACITY, _may_drop)
        self._is_woken = False
        self._is_stopping = False
        self._frames_dropped = 0
        self._loop = asyncio.new_event_loop()
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="touchd-live", daemon=True)

    def start(self) -> None:
        log.info("live page: %s", " ".join(self.urls))
        host = self._live.host
        if self.listening.getsockname()[0] == "0.0.0.0" and ip_of(host) is None:
            log.warning("live page: %s is no name of this computer; serving at all of its addresses", host)
        self._thread.start()

    def put(self, item: Event | LivePrediction) -> None:
        """Queue an event or a live prediction, to be shown with the next frame or status.

        Waking the page's thread here would make it compete with the sinks that handle the same answer.
        """
        self._items.put(item)

    @property
    def is_watched(self) -> bool:
        return bool(self._viewers)

    def put_frame(self, frame: Frame, dropped: int = 0, pad: str = DEFAULT_PAD) -> None:
        """Queue a frame and show everything queued. dropped: frames dropped so far."""
        self._pads[pad].put_frame(frame)
        self._frames_dropped = dropped
        if not self._viewers:
            return
        self._items.put((frame, pad))
        was_woken, self._is_woken = self._is_woken, True
        if not was_woken:
            # Raised when the loop has ended.
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._take)

    def stop(self, timeout_s: float) -> None:
        """Close all connections and stop listening; what is queued is not shown. May be repeated."""
        self._is_stopping = True
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stopping.set)
        if self._thread.ident is None:
            self.listening.close()
        else:
            self._thread.join(timeout_s)

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        except Exception:
            log.exception("the live page has failed; the daemon goes on without it")
        finally:
            self.listening.close()
            self._loop.close()

    async def _serve(self) -> None:
        # Keep clients' connects and errors out of the daemon's log.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        logging.getLogger("asyncio").setLevel(logging.ERROR)
        connections: dict[Connection, None] = {}
        server = await serve(
            self._watch,
            sock=self.listening,
            process_request=lambda _, request: self._page.respond(request),
            # It is called, but declared as a type.
            create_connection=partial(Connection, connections),  # type: ignore[arg-type]
            compression=None,
            server_header=None,
            open_timeout=HANDSHAKE_S,
            ping_interval=PING_EVERY_S,
            ping_timeout=PING_EVERY_S,
            close_timeout=GOODBYE_S,
            max_size=MOST_MESSAGE_BYTES,
            max_queue=1,
        )
        status = asyncio.create_task(self._send_status())
        await self._stopping.wait()
        status.cancel()
        server.close()
        for connection in list(connections):
            connection.transport.abort()
        left = asyncio.all_tasks() - {asyncio.current_task()}
        await asyncio.wait(left, timeout=GOODBYE_S)
        # asyncio would report tasks that are left when the loop closes as a fault.
        for task in left:
            task.cancel()
        await asyncio.wait(left, timeout=GOODBYE_S)

    async def _watch(self, connection: ServerConnection) -> None:
        """Serve a viewer until it leaves; close its connection if it sends something unexpected."""
        if len(self._viewers) >= MOST_VIEWERS:
            await connection.close(CloseCode.TRY_AGAIN_LATER, "too many are looking already")
            return
        self._viewers.add(connection)
        for state in self._state():
            broadcast([connection], state)
        refused = ""
        try:
            with suppress(ConnectionClosed):
                while not refused:
                    message = await connection.recv()
                    take = self._take_message
                    refused = take(connection, message) if take else "nothing is read here"
                await connection.close(CloseCode.POLICY_VIOLATION, refused)
        finally:
            self._viewers.discard(connection)

    async def _send_status(self) -> None:
        while True:
            await asyncio.sleep(STATUS_EVERY_S)
            self._take()
            for name, pad in self._pads.items():
                status = {"rate_hz": pad.rate_hz, "dropped": self._frames_dropped, "pad": name}
                self._viewers.show(encode_message({"type": "status", **status}))

    def _take(self) -> None:
        """Show everything queued."""
        self._is_woken = False
        items = self._items.take_all()
        for item in items:
            # A thread that still runs when Python exits would crash the process.
            if self._is_stopping:
                return
            try:
                self._show(item)
            except Exception:
                log.exception("live: something could not be shown")

    def _show(self, item: Item) -> None:
        match item:
            case (frame, pad):
                self._viewers.show(encode_frame(frame, list(self._pads).index(pad)))
            case LivePrediction():
                self._viewers.show(encode_message(item))
            case _:
                for pad in [item.pad] if not isinstance(item, RobotEvent) else self._pads:
                    self._pads[pad].put(item)
                self._viewers.send(encode_message(item))

    def _state(self) -> list[str]:
        """Return the state of each pad."""
        common: dict[str, object] = {
            "type": "state",
            # A page with another stamp of its files reloads.
            "page": self._page.stamp,
            "pads": list(self._pads),
            "touchable": self._is_touchable,
        }
        return [encode_message(common | {"pad": name} | pad.state()) for name, pad in self._pads.items()]


def _may_drop(item: Item) -> bool:
    """Whether the item may be dropped: a later viewer does not need it."""
    return isinstance(item, tuple | LivePrediction)


def encode_frame(frame: Frame, pad: int = 0) -> bytes:
    """Return a frame in the page's format. pad: the index of its pad."""
    return frame.sensor_ms.to_bytes(4, "little") + frame.pressure.astype("<u2").tobytes() + bytes([pad])


def encode_message(message: msgspec.Struct | dict[str, object]) -> str:
    return msgspec.json.encode(message).decode()
