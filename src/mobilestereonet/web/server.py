"""Server of the page: loopback, one folder deleted at the end, nothing from other servers."""

from __future__ import annotations

import os
import re
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from starlette.datastructures import MutableHeaders
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


class Guard:
    """Middleware that blocks the parts of gradio that the page does not use."""

    def __init__(self, app: Any) -> None:
        """Wrap an ASGI application."""
        self._app = app

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

        path = scope.get("path", "")
        refused = path.startswith("/gradio_api") and not _USED.match(path)
        app = PlainTextResponse("not here", status_code=404) if refused else self._app
        await app(scope, receive, send_with_policy)


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
    before = os.environ.get("GRADIO_TEMP_DIR")
    with TemporaryDirectory(prefix="msnet-web-") as folder:
        os.environ["GRADIO_TEMP_DIR"] = folder
        handlers = Handlers(config, Path(folder))
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
                app_kwargs={"middleware": [Middleware(Guard)], "docs_url": None},
                **page_style(),
            )
            yield address
        finally:
            handlers.sessions.close_all()
            page.close(verbose=False)
            if before is None:
                del os.environ["GRADIO_TEMP_DIR"]
            else:
                os.environ["GRADIO_TEMP_DIR"] = before
