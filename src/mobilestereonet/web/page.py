"""The page: its layout and event handlers."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import gradio as gr

from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.web.answer import CLOUD, MAX_DEPTH_RATIO, Geometry, answer
from mobilestereonet.web.sessions import MAX_IDLE_SECONDS, Sessions
from mobilestereonet.web.uploads import UploadLimits, admit

_ABOUT = """# Depth from two pictures
Two pictures of one scene, taken side by side (a **rectified stereo pair**), become a disparity
map, a depth in metres for every pixel, and a 3D point cloud. Take an example, or your own pair.
"""


@dataclass(frozen=True)
class PageConfig:
    """Models, engines, examples and limits of the page.

    Attributes:
        models: Names of the models; the first is the default.
        engines: Names of the engines; the first is the default.
        matcher: Makes a matcher of a model's and an engine's name.
        examples: Pairs with calibration.
        limits: Limits of uploads and visitors.
    """

    models: list[str]
    engines: list[str]
    matcher: Callable[[str, str], StereoMatcher]
    examples: list[StereoSample]
    limits: UploadLimits


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
            found = answer(self.sessions[request.session_hash], matcher, geometry)
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


def build_page(handlers: Handlers) -> gr.Blocks:
    """Lay out the page.

    Args:
        handlers: Event handlers, which hold the configuration.

    Returns:
        The page, to be launched with `page_style`.
    """
    config = handlers.config
    with gr.Blocks(
        title="Depth from two pictures",
        analytics_enabled=False,
        delete_cache=(60, MAX_IDLE_SECONDS),
    ) as page:
        gr.Markdown(_ABOUT, elem_id="about")
        with gr.Row():
            with gr.Column(scale=2, min_width=320):
                left, right, gallery = _pair_inputs(config)
                geometry, engine = _settings(config)
                button = gr.Button("Match", variant="primary", elem_id="match")
            with gr.Column(scale=3, min_width=320):
                results, points = _results()
        for side, image in (("left", left), ("right", right)):
            _refuse_addresses(image)
            event = image.upload(
                handlers.upload_handler(side), image, image, preprocess=False, **_QUIET
            )
            event.failure(lambda: None, None, image, **_QUIET)
            image.clear(handlers.clear_handler(side), **_QUIET)
        inputs = [*engine, *geometry]
        matching: dict[str, Any] = {
            "api_visibility": "private",
            "show_progress_on": results[0],
            "js": _SHOW_RESULTS,
            # One after the other, whichever way a match is asked for.
            "concurrency_id": "match",
            "concurrency_limit": 1,
        }
        button.click(handlers.match, inputs, results, **matching)
        example = gallery.select(
            handlers.take_example, None, [left, right, *geometry[:3]], **_QUIET
        )
        example.success(handlers.match, inputs, results, **matching)
        # Not before its tab is open: a viewer that has a model when it is mounted stays empty (seen
        # in gradio 6.31). Nobody who does not look at the points waits for them, either.
        points.select(handlers.cloud, None, results[4], api_visibility="private")
        page.unload(handlers.leave)
    page.queue(max_size=config.limits.waiting, default_concurrency_limit=1, api_open=False)
    return page


# On a phone the results lie below what was tapped.
_SHOW_RESULTS = """(...inputs) => {
  const facts = document.querySelector("#facts");
  const { top, bottom } = facts.getBoundingClientRect();
  if (top < 0 || bottom > innerHeight) facts.scrollIntoView();
  return inputs;
}"""
_QUIET: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}


def _refuse_addresses(image: Any) -> None:
    """Keep gradio from fetching a web address that is sent in place of an upload's path."""
    move = image.async_move_resource_to_block_cache

    async def move_local(path: Any) -> Any:
        if "://" in str(path):
            raise gr.Error("upload the picture itself", print_exception=False)
        return await move(path)

    image.async_move_resource_to_block_cache = move_local


def _pair_inputs(config: PageConfig) -> tuple[Any, Any, Any]:
    size = f"PNG, JPEG, WebP or BMP; up to {config.limits.pixels / 1e6:.1f} megapixels"
    gr.Markdown(f"### 1. The pair\n{size}, both of one size.")
    with gr.Row():
        left, right = (
            gr.Image(
                label=f"{side.capitalize()} picture",
                type="filepath",
                image_mode=None,
                sources=["upload", "clipboard"],
                height=180,
                min_width=140,
                buttons=[],
                elem_id=side,
            )
            for side in ("left", "right")
        )
    gr.Markdown("Or click an example (a photograph, then rendered scenes):")
    gallery = gr.Gallery(
        [(to_picture(sample.left), sample.name) for sample in config.examples],
        show_label=False,
        columns=len(config.examples),
        height=120,
        allow_preview=False,
        object_fit="cover",
        buttons=[],
        format="png",
        elem_id="examples",
    )
    return left, right, gallery


def _settings(config: PageConfig) -> tuple[list[Any], list[Any]]:
    gr.Markdown(
        "### 2. The cameras\nFrom your calibration, for pictures of this size; doffs is the "
        "principal points' difference, mostly 0. Without focal length and baseline there is a "
        "disparity, but no depth in metres and no 3D."
    )
    with gr.Row():
        focal = gr.Number(0, label="Focal, px", min_width=90, elem_id="focal")
        baseline = gr.Number(0, label="Baseline, m", min_width=90, elem_id="baseline")
        doffs = gr.Number(0, label="doffs, px", min_width=90, elem_id="doffs")
    with gr.Accordion("More settings", open=False):
        with gr.Row():
            model = gr.Dropdown(
                config.models, label="Network", info="sgbm: not a network", min_width=140
            )
            engine = gr.Dropdown(
                config.engines, label="Engine", info="msnet bench times them", min_width=140
            )
        with gr.Row():
            max_depth = gr.Number(
                0,
                label="Farthest point, m",
                info=f"0: {MAX_DEPTH_RATIO:.0f} times the median depth",
                min_width=140,
            )
            confidence = gr.Slider(0, 1, 0.5, step=0.05, label="Min. confidence", min_width=140)
    return [focal, baseline, doffs, max_depth, confidence], [model, engine]


def _results() -> tuple[list[Any], Any]:
    gr.Markdown("### 3. The result")
    facts = gr.Markdown(
        "Click an example, or choose two pictures and press Match: what comes out appears here.",
        elem_id="facts",
    )
    plain: dict[str, Any] = {"show_label": False, "interactive": False}
    with gr.Tabs() as tabs:
        with gr.Tab("Depth", id="disparity"):
            gr.Markdown("The left picture, and its disparity: red is near, blue is far.")
            slider = gr.ImageSlider(
                max_height=520, buttons=["fullscreen"], elem_id="disparity", **plain
            )
            readout = gr.HTML(
                html_template="<output></output>",
                js_on_load=files(__package__).joinpath("readout.js").read_text("utf-8"),
                elem_id="readout",
            )
        with gr.Tab("Confidence"):
            gr.Markdown("White: sure to be within 2 px. Black: a guess. (sgbm tells none.)")
            confidence = gr.Image(buttons=["fullscreen"], elem_id="confidence", **plain)
        with gr.Tab("3D") as points:
            gr.Markdown("Drag to turn, scroll or pinch to come closer. Needs the cameras' numbers.")
            cloud = gr.Model3D(camera_position=(90, 90, None), height=480, elem_id="cloud", **plain)
    downloads = gr.File(
        label="Downloads",
        file_count="multiple",
        interactive=False,
        visible=False,
        elem_id="downloads",
    )
    return [facts, slider, readout, confidence, cloud, tabs, downloads], points


def page_style() -> dict[str, Any]:
    """Arguments of ``launch`` that style the page, with the system's own fonts."""
    fonts = ["system-ui", "sans-serif"], ["ui-monospace", "monospace"]
    return {
        "theme": gr.themes.Default(font=fonts[0], font_mono=fonts[1]),
        "css": files(__package__).joinpath("page.css").read_text("utf-8"),
    }
