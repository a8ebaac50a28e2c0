"""A page for this machine's browser that shows pictures as they come (Motion JPEG)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread
from types import TracebackType

import cv2
import numpy as np

from mobilestereonet.data.images import Picture

LOOPBACK = "127.0.0.1"

_NAMES = (LOOPBACK, "localhost")
"""Names of this machine in requests. A foreign site's own name may lead here, too."""

_JPEG_QUALITY = 85

_PAGE = b"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>msnet live</title>
<link rel="icon" href="data:,">
<style>
  body { margin: 0; background: #222; }
  img { display: block; margin: auto; max-width: 100%; max-height: 100vh; }
</style>
<img src="pictures" alt="Left view and disparity, as they come">
</html>
"""

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self' data:; style-src 'unsafe-inline'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Pages of other sites show none of it."""


class BrowserPage:
    """A server of one page, on this machine alone; a context manager.

    Each visitor gets the newest picture as soon as the one before has arrived.

    Attributes:
        address: Address of the page.
    """

    def __init__(self) -> None:
        self._newest = _Newest()
        handler = type("Handler", (_Handler,), {"newest": self._newest})
        self._server = ThreadingHTTPServer((LOOPBACK, 0), handler)
        self._server.daemon_threads = True
        self.address = f"http://{LOOPBACK}:{self._server.server_port}/"

    def show(self, picture: Picture) -> None:
        """Show an RGB picture until the next one comes."""
        quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), quality)
        self._newest.put(jpeg.tobytes())

    def __enter__(self) -> BrowserPage:
        Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._newest.end()
        self._server.shutdown()
        self._server.server_close()


class _Newest:
    """The newest picture, for any number of threads that wait for it."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._content, self._number, self._ended = b"", 0, False

    def put(self, content: bytes) -> None:
        with self._changed:
            self._content, self._number = content, self._number + 1
            self._changed.notify_all()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[bytes]:
        """Each picture that is the newest one when it is asked for, until the end."""
        part = self._after(0)
        while part is not None:
            number, content = part
            yield content
            part = self._after(number)

    def _after(self, number: int) -> tuple[int, bytes] | None:
        """Wait for a newer picture than one; gives its number, too, or None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._number > number)
            return (self._number, self._content) if self._number > number else None


class _Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    newest: _Newest

    def do_GET(self) -> None:
        if self.headers.get("Host", "").partition(":")[0] not in _NAMES:
            self.send_error(421, "this server has another name")
        elif self.path == "/":
            self._begin("text/html")
            self.wfile.write(_PAGE)
        elif self.path == "/pictures":
            self._begin("multipart/x-mixed-replace; boundary=next")
            with suppress(OSError):  # the visitor has gone
                self._send_pictures()
        else:
            self.send_error(404)

    def _send_pictures(self) -> None:
        self.wfile.write(b"--next\r\n")
        for jpeg in self.newest:
            # A browser shows a part once the line after it has come.
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n--next\r\n")

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        for name, value in {"Content-Type": kind, **_HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        """Keep quiet."""
