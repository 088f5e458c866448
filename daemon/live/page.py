"""The page's files and the answers to HTTP requests."""

import hashlib
from http import HTTPStatus
from pathlib import Path

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from touchd.daemon.live.address import is_own_host

FOLDER = Path(__file__).parent / "static"
STREAM = "/stream"
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
# Same origin only, nothing inline, no framing.
POLICY = (
    # Safari before 15.4 does not count the page's own websocket as 'self'.
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self' ws: wss:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
OTHER_NAME = (
    "touchd does not serve its page by this name. Use the computer's address instead, or write the name\n"
    "into touchd's configuration and start touchd again:\n\n  live:\n    host: NAME\n"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}


class Page:
    """Serves the page's files, read once. names: accepted host names.

    stamp: changes with the files, so that an open page notices that it is outdated.
    """

    def __init__(self, names: frozenset[str]) -> None:
        self._names = names
        self._files = {f"/{path.name}": path.read_bytes() for path in sorted(FOLDER.iterdir())}
        self._files["/"] = self._files["/page.html"]
        self.stamp = hashlib.sha256(b"".join(self._files.values())).hexdigest()[:12]

    def respond(self, request: Request) -> Response | None:
        """Return the answer to a request, None for a valid request for the stream."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or not is_own_host(hosts[0], self._names):
            return _answer(HTTPStatus.FORBIDDEN, OTHER_NAME)
        path = request.path.partition("?")[0]
        if path == STREAM:
            # Browsers always send the origin of the asking page; other clients send none.
            origins = {origin.partition("://")[2] for origin in request.headers.get_all("Origin")}
            if origins - {hosts[0]}:
                return _answer(HTTPStatus.FORBIDDEN, "Only the page itself gets the stream.\n")
            return None
        content = self._files.get(path)
        if content is None:
            return _answer(HTTPStatus.NOT_FOUND, "There is nothing here; the page is at /.\n")
        return _answer(HTTPStatus.OK, content, TYPES[Path(path).suffix or ".html"])


def _answer(status: HTTPStatus, body: str | bytes, kind: str = "text/plain; charset=utf-8") -> Response:
    content = body.encode() if isinstance(body, str) else body
    headers = {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}
    return Response(status.value, status.phrase, Headers(headers), content)
