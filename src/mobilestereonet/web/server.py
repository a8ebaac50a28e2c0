"""Server of the page: loopback, one folder deleted at the end, nothing from other servers."""

from __future__ import annotations

import os
import re
from collections.abc import Awaitable, Callable, Iterator
from contextlib import closing, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from secrets import token_bytes
from socket import gethostname
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

from gradio import route_utils
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.responses import PlainTextResponse

from mobilestereonet.web.handlers import Handlers, PageConfig
from mobilestereonet.web.page import build_page, page_style

# What the page needs of gradio's API, files by their path (on Windows, after a drive's letter).
# The rest fetches web addresses, edits videos, keeps states.
_USED = re.compile(
    r"/gradio_api/(file=(/|\w:)|(upload|upload_progress|info|startup-events|cancel|reset)/?$"
    r"|queue/|heartbeat/)"
)
# A browser that keeps to it asks this server only: gradio's libraries name others.
_POLICY = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "object-src 'none'; frame-ancestors 'none'; base-uri 'self'; form-action 'self'"
)


_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_FROM_PROXIES = (
    b"forwarded",
    b"x-forwarded-for",
    b"x-forwarded-host",
    b"x-forwarded-port",
    b"x-forwarded-prefix",
    b"x-forwarded-proto",
    b"x-gradio-server",
)
"""Headers that would let a visitor choose the addresses in gradio's answers."""


class Guard:
    """Middleware that blocks what the page does not need.

    Those are the other parts of gradio, names of this machine that `is_own_name` does not know,
    and requests of other sites' pages.
    """

    def __init__(self, app: Any, host: str = _LOOPBACK[0]) -> None:
        """Wrap an ASGI application.

        Args:
            app: The application.
            host: Address that the server listens at.
        """
        self._app = app
        self._host = host

    async def __call__(
        self, scope: Any, receive: Any, send: Callable[[Any], Awaitable[None]]
    ) -> None:
        """Answer a request, as ASGI has it."""

        async def send_with_policy(message: Any) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = _POLICY
                headers["Referrer-Policy"] = "no-referrer"
                headers["X-Content-Type-Options"] = "nosniff"
            await send(message)

        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # the page needs no web sockets
            await send({"type": "websocket.close"})
            return
        scope["headers"] = [pair for pair in scope["headers"] if pair[0] not in _FROM_PROXIES]
        refusal = self._refusal(scope["path"], Headers(scope=scope))
        await (refusal or self._app)(scope, receive, send_with_policy)

    def _refusal(self, path: str, headers: Headers) -> PlainTextResponse | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if not is_own_name(_without_port(host), self._host):
            return PlainTextResponse("this server has another name", status_code=421)
        if origin is not None and origin.partition("://")[2] != host:
            return PlainTextResponse("this is for the page itself", status_code=403)
        if path.startswith("/gradio_api") and not _USED.match(path):
            return PlainTextResponse("not here", status_code=404)
        return None


def _without_port(host: str) -> str:
    with suppress(ValueError):  # as "[" is no address
        return urlsplit(f"//{host}").hostname or ""
    return ""


def is_own_name(name: str, host: str) -> bool:
    """Whether a name in a request is one of the server's.

    A foreign site can let its own name point to this machine (DNS rebinding): a browser would then
    take its scripts for the page's.

    Args:
        name: Host that the request names, without the port.
        host: Address that the server listens at. For other ones than loopback, addresses in digits
            count as well, which no foreign name can be, and the machine's name.
    """
    if name in (*_LOOPBACK, host.lower()):
        return True
    if host in _LOOPBACK:
        return False
    with suppress(ValueError):
        ip_address(name)
        return True
    own = gethostname().lower()
    return name in (own, own.partition(".")[0], f"{own}.local")


class OwnUpload(route_utils.GradioUploadFile):  # type: ignore[misc]
    """Upload in a folder of its own: gradio's is one for all visitors who upload the same."""

    def __init__(self, file: Any, *, filename: str | None = None, **others: Any) -> None:
        """Begin an upload; a name that is none is replaced."""
        name = Path(filename or "").name
        super().__init__(file, filename=filename if name.strip(".") else "picture", **others)
        self.sha.update(token_bytes(32))


@contextmanager
def running(
    config: PageConfig, *, host: str = "127.0.0.1", port: int | None = None
) -> Iterator[str]:
    """Serve the page as long as the context lasts.

    Args:
        config: Models, engines, examples and limits of the page.
        host: Address to listen at.
        port: Port; by default the first free one from 7860 on.

    Yields:
        The page's address.

    Raises:
        OSError: If the port is not free.
    """
    with (
        TemporaryDirectory(prefix="msnet-web-") as folder,
        _uploads_in(folder),
        closing(Handlers(config, Path(folder))) as handlers,
    ):
        page = build_page(handlers)
        try:
            _, address, _ = page.launch(
                server_name=host,
                server_port=port,
                max_file_size=f"{config.limits.megabytes}mb",
                prevent_thread_lock=True,
                quiet=True,
                share=False,
                ssr_mode=False,
                run_history=False,
                enable_monitoring=False,
                footer_links=[],
                app_kwargs={"middleware": [Middleware(Guard, host=host)], "docs_url": None},
                **page_style(),
            )
            yield address
        finally:
            page.close(verbose=False)


@contextmanager
def _uploads_in(folder: str) -> Iterator[None]:
    """Context in which gradio puts uploads into a folder, each as an `OwnUpload`."""
    before, upload = os.environ.get("GRADIO_TEMP_DIR"), route_utils.GradioUploadFile
    os.environ["GRADIO_TEMP_DIR"], route_utils.GradioUploadFile = folder, OwnUpload
    try:
        yield
    finally:
        route_utils.GradioUploadFile = upload
        if before is None:
            del os.environ["GRADIO_TEMP_DIR"]
        else:
            os.environ["GRADIO_TEMP_DIR"] = before
