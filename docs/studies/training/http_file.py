"""Downloads one file over HTTP, resumably: an incomplete one is called .part, and the next call goes on."""

import errno
import ssl
from collections.abc import Callable
from http import HTTPStatus
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from drivers.errors import TouchdError

CHUNK_BYTES = 1 << 16
TIMEOUT_S = 30.0
Advance = Callable[[int, int | None], None]
"""Told how many bytes are there, and how many there will be (None when the server does not say)."""


class DownloadError(TouchdError):
    """A file could not be had; the message says which, why and what to do, in one line."""


def fetch(url: str, path: Path, max_bytes: int, advance: Advance, *, timeout_s: float = TIMEOUT_S) -> None:
    """Download `url` to `path`, going on where an earlier call stopped.

    timeout_s: how long the server may stay silent.
    Raises DownloadError; what has arrived by then is kept.
    """
    part = path.with_name(f"{path.name}.part")
    if not url.startswith(("http://", "https://")):
        raise DownloadError(f"{url}: not an http or https address")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        response, have = _open(url, part.stat().st_size if part.exists() else 0, timeout_s)
        with response:
            _append(response, url, part, have, max_bytes, advance)
        part.replace(path)
    except HTTPError as error:
        raise DownloadError(
            f"{url}: the server answers {error.code} {error.reason}; check the address"
        ) from error
    except (URLError, HTTPException, TimeoutError, ConnectionError, ssl.SSLError) as error:
        reason = error.reason if isinstance(error, URLError) else error
        raise DownloadError(
            f"{url}: the connection failed ({reason}); check the network and run this again to go on"
        ) from error
    except OSError as error:
        advice = "make room, then run this again" if error.errno == errno.ENOSPC else "choose another folder"
        raise DownloadError(f"{part}: cannot be written ({error.strerror}); {advice}") from error


def _open(url: str, have: int, timeout_s: float) -> tuple[HTTPResponse, int]:
    """Ask for what follows the first `have` bytes; return the answer and the byte at which it begins."""
    headers = {"Accept-Encoding": "identity", "User-Agent": "touchd"}
    if have:
        headers["Range"] = f"bytes={have}-"
    try:
        response: HTTPResponse = urlopen(Request(url, headers=headers), timeout=timeout_s)
    except HTTPError as error:
        # Nothing follows: the file there is whole, or it is not the beginning of this one.
        if not have or error.code != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            raise
        return _open(url, 0, timeout_s)
    if response.status != HTTPStatus.PARTIAL_CONTENT:
        return response, 0
    if not response.headers.get("Content-Range", "").startswith(f"bytes {have}-"):
        response.close()
        raise DownloadError(f"{url}: the server sends another part than was asked for; try another address")
    return response, have


def _append(
    response: HTTPResponse, url: str, part: Path, have: int, max_bytes: int, advance: Advance
) -> None:
    total = None if response.length is None else have + response.length
    too_large = DownloadError(f"{url}: larger than {max_bytes:,} bytes; that is not the expected file")
    if total is not None and total > max_bytes:
        raise too_large
    advance(have, total)
    with part.open("ab" if have else "wb") as file:
        while chunk := response.read1(CHUNK_BYTES):
            have += len(chunk)
            if have > max_bytes:
                raise too_large
            file.write(chunk)
            advance(have, total)
    if total is not None and have < total:
        raise DownloadError(
            f"{url}: the connection ended after {have:,} of {total:,} bytes; run this again to go on"
        )
