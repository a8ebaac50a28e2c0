"""What the page does: its configuration and event handlers."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import gradio as gr

from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, StereoMatcher
from mobilestereonet.web.answer import (
    CLOUD,
    MESH,
    answer,
    prepare,
    preview,
    rectifier_of,
    view,
)
from mobilestereonet.web.cameras import FILE, NUMBERS, UNKNOWN, Geometry
from mobilestereonet.web.sessions import Session, Sessions
from mobilestereonet.web.uploads import (
    SIDES,
    UploadLimits,
    admit_calibration,
    admit_pair,
    read_views,
)

Updates = dict[str, Any]
"""New values of the page's parts, by their names in `PARTS`."""

DOWNLOADS = ("picture", "depth", "blender", "everything")
ERRORS = ("pair_error", "cameras_error", "match_error")
NUMBERS_OF_CAMERAS = ("focal", "baseline", "doffs")
PARTS = (
    *("drop", "chosen", "left", "right", "view", "progress", "cancel", "facts", "tabs", "shape"),
    "distance",
    *("metres", "source", *NUMBERS_OF_CAMERAS),
    *DOWNLOADS,
    *ERRORS,
)
"""What handlers change; where an event has nothing for a part, that stays."""

SHAPES = {"Surface": MESH, "Points": CLOUD}
"""Ways to show an answer in 3D, and their files."""

MIN_CONFIDENCE = 0.5
"""Of points and surfaces, where the visitor asks for no other."""

_UNFORESEEN = (
    "the server could not do this, and its log says why: try smaller pictures, or another quality"
)
_POLL_SECONDS = 0.2


@dataclass(frozen=True)
class PageConfig:
    """Models, engines, examples and limits of the page.

    Attributes:
        models: Quality levels and names of models; the first is the default.
        engines: Names of the engines; the first is the default.
        matcher: Makes a matcher of a model's and an engine's name.
        examples: Pairs, with a calibration if it is known; the page opens with the result of the
            first.
        limits: Limits of uploads and visitors.
        rectifier: Has the geometry of pairs for which the visitor fills in none.
    """

    models: list[str]
    engines: list[str]
    matcher: Callable[[str, str], StereoMatcher]
    examples: list[StereoSample]
    limits: UploadLimits
    rectifier: Rectifier | None = None


class FieldError(InputError):
    """An `InputError` at a field of the page.

    Attributes:
        field: One of `ERRORS`.
    """

    def __init__(self, field: str, text: str) -> None:
        """Say what is wrong there."""
        super().__init__(text)
        self.field = field


@contextmanager
def at(field: str) -> Iterator[None]:
    """Context in which an `InputError` becomes a `FieldError` at one of `ERRORS`."""
    try:
        yield
    except InputError as error:
        raise FieldError(field, str(error).replace("\n", " ")) from error


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
        self.opening = Session(self.sessions.root)
        self._matcher = lru_cache(maxsize=4)(config.matcher)
        # One after the other, however a match is asked for, and whether its visitor still waits.
        self._worker = ThreadPoolExecutor(max_workers=1)
        self._seconds_per_pixel: dict[tuple[str, str], float] = {}

    def open(self) -> Updates:
        """Match the first example; gives what the page shows before anybody did anything."""
        updates = self._put_example(self.opening, 0)
        source = updates["source"] if updates["metres"] else None
        focal, baseline, doffs = (updates[name] for name in NUMBERS_OF_CAMERAS)
        geometry = Geometry(source, None, focal, baseline, doffs, None, MIN_CONFIDENCE)
        model, engine = self.config.models[0], self.config.engines[0]
        for step in self._match(self.opening, model, engine, geometry):
            updates |= step
        return updates

    def _session(self, request: gr.Request, chosen: bool) -> Session:
        """A visitor's session; who has chosen no pair yet has the one that the page opens with."""
        session = self.sessions[request.session_hash]
        if not chosen and not session.holds("left"):
            self._put_example(session, 0)
        return session

    def take_pair(
        self,
        request: gr.Request,
        files: list[dict[str, Any]] | None,
        source: str,
        *numbers: float | None,
    ) -> Iterator[Updates]:
        """Take dropped pictures into the session; gives the left view if the pair is whole.

        What the visitor said about the cameras stays; an example's numbers go with the example.
        """
        session = self.sessions[request.session_hash]
        paths = [Path(str((file or {}).get("path") or "")) for file in files or []]
        with at("pair_error"):
            admit_pair(paths, self.uploads, session, self.config.limits)
            session.drop("example")
            updates = {**self._changed(session), "drop": None}
            said = {"source": source, **dict(zip(NUMBERS_OF_CAMERAS, numbers, strict=True))}
            known = [_cameras(example.calibration) for example in self.config.examples]
            if {"metres": True, **said} in known:
                updates |= _cameras(None)
            yield updates
            yield self._preview(session)

    def take_calibration(
        self, request: gr.Request, file: dict[str, Any] | None
    ) -> Iterator[Updates]:
        """Take a calibration file into the session."""
        session = self.sessions[request.session_hash]
        with at("cameras_error"):
            admit_calibration(Path(str((file or {}).get("path") or "")), self.uploads, session)
            Geometry(FILE, session.file("calibration")).rig((1, 1))
        yield {"cameras_error": ""}

    def swap(self, request: gr.Request, chosen: bool) -> Iterator[Updates]:
        """Exchange the left and the right view."""
        session = self._session(request, chosen)
        session.swap("left", "right")
        with at("pair_error"):
            yield self._changed(session)
            yield self._preview(session)

    def take_example(self, choice: gr.SelectData, request: gr.Request) -> Iterator[Updates]:
        """Copy an example into the session, with its calibration."""
        session = self.sessions[request.session_hash]
        with at("pair_error"):
            yield self._put_example(session, choice.index) | self._preview(session)

    def _put_example(self, session: Session, index: int) -> Updates:
        sample = self.config.examples[index]
        for side, picture in zip(SIDES, (sample.left, sample.right), strict=True):
            with session.replace(side) as folder:
                write_png(folder / f"{side}.png", to_picture(picture))
        with session.replace("example"):  # which the page's own cameras have not taken
            pass
        return self._changed(session) | _cameras(sample.calibration)

    def _changed(self, session: Session) -> Updates:
        """Show the session's new pair, and nothing of the former one's answer."""
        session.drop("answer")
        paths = {side: session.file(side) for side in SIDES}
        thumbnails = {side: str(path) if path else None for side, path in paths.items()}
        return {"chosen": True, **thumbnails, **_no_answer()}

    def _preview(self, session: Session) -> Updates:
        pair, _ = read_views(session, self.config.limits.pixels)
        return {"pair_error": "", "view": preview(pair)}

    def match(
        self,
        request: gr.Request,
        chosen: bool,
        model: str,
        engine: str,
        metres: bool,
        source: str,
        *numbers: float | None,
    ) -> Iterator[Updates]:
        """Match the session's pair; ``numbers`` are those of `Geometry`, in their order."""
        session = self._session(request, chosen)
        asked = source if metres else None
        focal, baseline, doffs, max_depth, min_confidence = numbers
        geometry = Geometry(
            asked,
            session.file("calibration"),
            focal,
            baseline,
            doffs,
            max_depth,
            min_confidence or 0.0,
        )
        yield from self._match(session, model, engine, geometry)

    def _match(
        self, session: Session, model: str, engine: str, geometry: Geometry
    ) -> Iterator[Updates]:
        session.drop("answer")
        yield {
            **dict.fromkeys(ERRORS, ""),
            **_no_answer(),
            "progress": {"label": f"Loading {model}", "expected": None},
            "cancel": gr.update(visible=True),
            "tabs": gr.update(selected="depth"),
        }
        with at("pair_error"):
            pair, size = read_views(session, self.config.limits.pixels)
        with at("cameras_error"):
            rectifier = rectifier_of(geometry, size, pair)
            if not session.holds("example"):
                rectifier = rectifier or self.config.rectifier
        with at("match_error"):
            matcher = self._matcher(model, engine)
        with at("pair_error"):
            pair = prepare(pair, size, rectifier, matcher)
        key, pixels = (model, engine), pair.width * pair.height
        seconds = self._seconds_per_pixel.get(key)
        yield {"progress": {"label": "Matching", "expected": seconds and seconds * pixels}}
        future = self._worker.submit(matcher.match, pair)
        try:
            while not wait([future], _POLL_SECONDS).done:
                yield {}
        finally:
            future.cancel()  # if its visitor has cancelled it
        with at("match_error"):
            result = future.result()
        yield {
            "view": view(pair, result, geometry.guessed),
            "progress": {"label": "Writing the files", "expected": None},
        }
        with at("match_error"):
            found = answer(session, pair, result, geometry)
        assert result.info is not None  # the matcher's results have one
        self._seconds_per_pixel[key] = result.info.seconds / pixels
        notes = "".join(f"\n- {html.escape(note)}" for note in found.notes)
        yield {
            **_at_rest(),
            "distance": found.distance,
            "facts": found.summary + ("\n\n**Mind:**\n" + notes if notes else ""),
            **{name: _download(found.downloads.get(name)) for name in DOWNLOADS},
        }

    def cancel(self, request: gr.Request) -> Iterator[Updates]:
        """Tell that the match was cancelled; what is being computed ends by itself, unseen."""
        yield {**_at_rest(), "facts": "Cancelled."}

    def shape(self, request: gr.Request, chosen: bool, kind: str, distance: float | None) -> Any:
        """Show the points or the surface of the session's answer, from a distance in metres."""
        session = self.sessions[request.session_hash]
        if not chosen and not any(session.holds(side) for side in SIDES):
            session = self.opening
        path = session.file("answer", SHAPES.get(kind, CLOUD))
        return gr.update(
            value=str(path) if path else None, camera_position=(90, 90, distance or None)
        )

    def leave(self, request: gr.Request) -> None:
        """Close the session of a visitor who has left the page."""
        self.sessions.close(request.session_hash)

    def close(self) -> None:
        """Close all sessions, after what they are writing."""
        self.sessions.close_all()
        self.opening.close()
        self._worker.shutdown(cancel_futures=True)


def failed(error: Exception) -> Updates:
    """What the page shows of an error: one line, at its field if it has one."""
    field = error.field if isinstance(error, FieldError) else "match_error"
    text = str(error) if isinstance(error, InputError) else _UNFORESEEN
    return {**_at_rest(), "drop": None, field: f"<p role='alert'>{html.escape(text)}</p>"}


def _cameras(known: Calibration | None) -> Updates:
    """The fields of the cameras for a calibration, or for a pair of which nothing is known yet."""
    if known is None:
        return {"metres": False, "source": UNKNOWN, **dict.fromkeys(NUMBERS_OF_CAMERAS)}
    numbers = {name: round(getattr(known, name), 4) for name in NUMBERS_OF_CAMERAS}
    return {"metres": True, "source": NUMBERS, **numbers}


def _no_answer() -> Updates:
    return {"facts": "", "shape": None, **{name: _download(None) for name in DOWNLOADS}}


def _at_rest() -> Updates:
    return {"progress": None, "cancel": gr.update(visible=False)}


def _download(path: Path | None) -> Any:
    return gr.update(value=str(path) if path else None, interactive=path is not None)
