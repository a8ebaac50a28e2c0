"""What the page does: its configuration and event handlers."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import gradio as gr

from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, StereoMatcher
from mobilestereonet.web.answer import CLOUD, Geometry, answer
from mobilestereonet.web.sessions import Sessions
from mobilestereonet.web.uploads import UploadLimits, admit


@dataclass(frozen=True)
class PageConfig:
    """Models, engines, examples and limits of the page.

    Attributes:
        models: Quality levels and names of models; the first is the default.
        engines: Names of the engines; the first is the default.
        matcher: Makes a matcher of a model's and an engine's name.
        examples: Pairs with calibration.
        limits: Limits of uploads and visitors.
        rectifier: Has the geometry of pairs for which the visitor fills in none.
    """

    models: list[str]
    engines: list[str]
    matcher: Callable[[str, str], StereoMatcher]
    examples: list[StereoSample]
    limits: UploadLimits
    rectifier: Rectifier | None = None


@contextmanager
def clear_errors() -> Iterator[None]:
    """Context in which an `InputError` becomes one line on the page."""
    try:
        yield
    except InputError as error:
        # gradio takes the message for HTML.
        text = html.escape(str(error).replace("\n", " "))
        raise gr.Error(text, print_exception=False) from error


class Handlers:
    """Event handlers of the page; files belong to the visitor's session."""

    def __init__(self, config: PageConfig, uploads: Path) -> None:
        """Make the sessions' folder.

        Args:
            config: Models, engines, examples and limits.
            uploads: Folder into which gradio puts uploads; `Sessions` lie below.
        """
        self.config = config
        self.uploads = uploads
        self.sessions = Sessions(uploads / "sessions")
        self._matcher = lru_cache(maxsize=4)(config.matcher)

    def upload_handler(self, side: str) -> Callable[..., str]:
        """Handler that takes an upload into the session, and gives its new path."""

        def take(upload: dict[str, Any] | None, request: gr.Request) -> str:
            with clear_errors():
                path = Path((upload or {}).get("path") or "")
                session = self.sessions[request.session_hash]
                return str(admit(path, self.uploads, session, side, self.config.limits))

        return take

    def clear_handler(self, side: str) -> Callable[..., None]:
        """Handler that deletes a picture."""

        def drop(request: gr.Request) -> None:
            self.sessions[request.session_hash].drop(side)

        return drop

    def take_example(self, choice: gr.SelectData, request: gr.Request) -> list[Any]:
        """Copy an example into the session; gives its pictures' paths and its calibration."""
        sample = self.config.examples[choice.index]
        paths = []
        with clear_errors():
            session = self.sessions[request.session_hash]
            for side, view in (("left", sample.left), ("right", sample.right)):
                with session.replace(side) as folder:
                    write_png(folder / f"{side}.png", to_picture(view))
                paths.append(str(folder / f"{side}.png"))
        known = sample.calibration
        assert known is not None  # examples have one
        return [*paths, *(round(value, 4) for value in (known.focal, known.baseline, known.doffs))]

    def match(
        self,
        model: str,
        engine: str,
        focal: float | None,
        baseline: float | None,
        doffs: float | None,
        max_depth: float | None,
        min_confidence: float,
        request: gr.Request,
        progress: gr.Progress = gr.Progress(),  # noqa: B008 (gradio finds it by its default)
    ) -> list[Any]:
        """Match the session's pictures; gives the values of the result components."""
        with clear_errors():
            geometry = Geometry(focal, baseline, doffs, max_depth, min_confidence)
            progress(0.1, desc=f"Loading {model}")
            matcher = self._matcher(model, engine)
            progress(0.3, desc="Matching")
            session = self.sessions[request.session_hash]
            found = answer(session, matcher, geometry, self.config.rectifier)
        notes = "".join(f"\n- {html.escape(note)}" for note in found.notes)
        return [
            found.summary + ("\n\n**Mind:**\n" + notes if notes else ""),
            (str(found.left), str(found.disparity)),
            found.readings,
            found.confidence and str(found.confidence),
            None,
            gr.Tabs(selected="disparity"),
            gr.File([str(path) for path in found.files], visible=True),
        ]

    def cloud(self, request: gr.Request) -> str | None:
        """The points of the session's answer."""
        path = self.sessions[request.session_hash].file("answer", CLOUD)
        return str(path) if path else None

    def leave(self, request: gr.Request) -> None:
        """Close the session of a visitor who has left the page."""
        self.sessions.close(request.session_hash)
