"""What the page looks like: its layout, and which handler each event has."""

from __future__ import annotations

import html
import json
import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata
from importlib.resources import files
from typing import Any

import gradio as gr
import numpy as np

import mobilestereonet
from mobilestereonet.data.images import to_picture
from mobilestereonet.errors import InputError
from mobilestereonet.plots import colour_disparity
from mobilestereonet.web.answer import MAX_DEPTH_RATIO
from mobilestereonet.web.cameras import CAMERAS, FILE, NUMBERS, UNKNOWN
from mobilestereonet.web.handlers import (
    MIN_CONFIDENCE,
    NUMBERS_OF_CAMERAS,
    PARTS,
    SHAPES,
    Handlers,
    PageConfig,
    Updates,
    failed,
)
from mobilestereonet.web.sessions import MAX_IDLE_SECONDS
from mobilestereonet.web.uploads import CALIBRATIONS

_log = logging.getLogger(__name__)

_ABOUT = """# Depth from two pictures
Two pictures of one scene, taken side by side (a **rectified stereo pair**), become depth for every
pixel and a scene to turn in 3D. This is an example: drop your own pictures, or click another one.
"""
_DOWNLOADS = {
    "picture": "Picture",
    "depth": "Depth in metres",
    "blender": "3D for Blender",
    "everything": "Everything (zip)",
}
_QUIET: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}
# On a phone the results lie below what was tapped.
_SHOW_RESULTS = """(...inputs) => {
  const results = document.querySelector("#results"), { top } = results.getBoundingClientRect();
  if (top < 0 || top > innerHeight / 2) results.scrollIntoView();
  return inputs;
}"""


def build_page(handlers: Handlers) -> gr.Blocks:
    """Lay out the page, which opens with the first example's result.

    Args:
        handlers: Event handlers, which hold the configuration.

    Returns:
        The page, to be launched with `page_style`.
    """
    config, opening = handlers.config, handlers.open()
    parts: dict[str, Any] = {}
    with gr.Blocks(
        title="Depth from two pictures",
        analytics_enabled=False,
        delete_cache=(60, MAX_IDLE_SECONDS),
    ) as page:
        gr.Markdown(_ABOUT, elem_id="about")
        with gr.Row():
            with gr.Column(scale=2, min_width=320):
                swap, gallery = _pair_inputs(parts, opening, config)
                file = _cameras(parts, opening, config)
                engine, limits = _settings(config)
                button = gr.Button("Match", variant="primary", elem_id="match")
                parts["match_error"] = _error("match_error")
            with gr.Column(scale=3, min_width=320, elem_id="results"):
                kind, tab = _results(parts, opening)
        gr.HTML(_footer(), elem_id="footer")
        outputs = [parts[name] for name in PARTS]
        quiet = {"outputs": outputs, **_QUIET}
        numbers = [parts[name] for name in ("metres", "source", *NUMBERS_OF_CAMERAS)]
        matching: dict[str, Any] = {
            **quiet,
            "fn": _streamed(handlers.match),
            "inputs": [parts["chosen"], *engine, *numbers, *limits],
            "js": _SHOW_RESULTS,
            # One after the other, whichever way a match is asked for.
            "concurrency_id": "match",
            "concurrency_limit": 1,
        }
        taken = [
            parts["drop"].upload(
                _streamed(handlers.take_pair),
                [parts["drop"], *numbers[1:]],
                preprocess=False,
                **quiet,
            ),
            swap.click(_streamed(handlers.swap), parts["chosen"], **quiet),
            gallery.select(_chosen(handlers.take_example), **quiet),
        ]
        matches = [button.click(**matching), *(event.success(**matching) for event in taken)]
        parts["cancel"].click(_streamed(handlers.cancel), cancels=matches, **quiet)
        file.upload(_streamed(handlers.take_calibration), file, preprocess=False, **quiet)
        # Not before its tab is open: a viewer that has a model when it is mounted stays empty (seen
        # in gradio 6.31). Nobody who does not look at the points waits for them, either.
        for event in (tab.select, kind.change):
            event(
                handlers.shape,
                [parts["chosen"], kind, parts["distance"]],
                parts["shape"],
                api_visibility="private",
            )
        page.unload(handlers.leave)
    # gradio looks for files in whatever is sent to a component, be it a number.
    for block in page.blocks.values():
        _refuse_addresses(block)
    page.queue(max_size=config.limits.waiting, default_concurrency_limit=1, api_open=False)
    return page


def _streamed(handler: Callable[..., Iterator[Updates]]) -> Callable[..., Iterator[list[Any]]]:
    """A handler as gradio calls it: values for all parts, and a failure ends what follows."""

    def run(request: gr.Request, *inputs: Any) -> Iterator[list[Any]]:
        yield from _values(handler(request, *inputs))

    return run


def _chosen(handler: Callable[..., Iterator[Updates]]) -> Callable[..., Iterator[list[Any]]]:
    """A handler of a choice, likewise."""

    def run(choice: gr.SelectData, request: gr.Request) -> Iterator[list[Any]]:
        yield from _values(handler(choice, request))

    return run


def _values(steps: Iterator[Updates]) -> Iterator[list[Any]]:
    try:
        for updates in steps:
            yield [updates.get(name, gr.skip()) for name in PARTS]
    except Exception as error:  # whatever it is, the page must come to rest
        if not isinstance(error, InputError):
            _log.exception("an event of the page failed")
        yield [failed(error).get(name, gr.skip()) for name in PARTS]
        # The page has the words at their field.
        raise gr.Error("", visible=False, print_exception=False) from error


def _refuse_addresses(block: Any) -> None:
    """Keep gradio from fetching a web address that is sent in place of an upload's path."""
    move = block.async_move_resource_to_block_cache

    async def move_local(path: Any) -> Any:
        if "://" in str(path):
            raise gr.Error("upload the picture itself", print_exception=False)
        return await move(path)

    block.async_move_resource_to_block_cache = move_local


def _pair_inputs(parts: dict[str, Any], opening: Updates, config: PageConfig) -> tuple[Any, Any]:
    gr.Markdown(
        "**Your pair**: two pictures, or one with both views (side by side, MPO)",
        elem_id="pair-title",
    )
    parts["drop"] = gr.File(
        show_label=False,
        file_count="multiple",
        file_types=["image", ".mpo", ".jps"],
        height=132,
        elem_id="drop",
    )
    parts["pair_error"] = _error("pair_error")
    parts["chosen"] = gr.Checkbox(False, visible=False)  # whether the visitor has chosen a pair
    with gr.Row(elem_id="pair", equal_height=True):
        for side in ("left", "right"):
            parts[side] = gr.Image(
                opening[side],
                label=side.capitalize(),
                type="filepath",
                interactive=False,
                height=110,
                min_width=110,
                buttons=[],
                elem_id=side,
            )
            if side == "left":
                swap = gr.Button("⇄", min_width=44, scale=0, elem_id="swap")
    gr.Markdown("**Examples**: two photographed, four rendered", elem_id="examples-title")
    gallery = gr.Gallery(
        [(to_picture(sample.left), sample.name) for sample in config.examples],
        show_label=False,
        columns=3,
        height="auto",
        allow_preview=False,
        object_fit="cover",
        buttons=[],
        format="webp",
        elem_id="examples",
    )
    return swap, gallery


def _cameras(parts: dict[str, Any], opening: Updates, config: PageConfig) -> Any:
    known = " Without it, this page's own cameras count." if config.rectifier else ""
    metres = gr.Checkbox(
        opening["metres"],
        label="I want metres",
        info=f"Depth in metres needs to know the cameras.{known}",
        elem_id="metres",
    )
    with gr.Group(visible=opening["metres"]) as group:
        source = gr.Dropdown(
            [FILE, NUMBERS, *CAMERAS, UNKNOWN],
            value=opening["source"],
            label="The cameras",
            info="Models count with their makers' nominal values.",
            elem_id="source",
        )
        with gr.Row(visible=opening["source"] == NUMBERS) as row:
            for name, label in zip(
                NUMBERS_OF_CAMERAS, ("Focal length, px", "Baseline, m", "doffs, px"), strict=True
            ):
                parts[name] = gr.Number(opening[name], label=label, min_width=90, elem_id=name)
        file = gr.File(
            label="OpenCV, ROS, Kalibr, ZED, OAK, RealSense, KITTI, Middlebury ...",
            file_types=list(CALIBRATIONS),
            height=110,
            visible=False,
            elem_id="calibration",
        )
        guess = gr.Markdown(
            "Supposed: a field of view of 60 degrees, cameras 65 mm apart. **The scale is a "
            "guess**: proportions are right, metres are not.",
            visible=False,
            elem_id="guess",
        )
        parts["cameras_error"] = _error("cameras_error")
    parts |= {"metres": metres, "source": source}
    # In the browser: it needs no server.
    metres.change(None, metres, group, js=f"(metres) => {_visible('metres')}")
    shown = ", ".join(_visible(f"name === {json.dumps(own)}") for own in (NUMBERS, FILE, UNKNOWN))
    source.change(None, source, [row, file, guess], js=f"(name) => [{shown}]")
    return file


def _visible(condition: str) -> str:
    """JavaScript for an update of a component that shows it on a condition."""
    return f"({{ __type__: 'update', visible: {condition} }})"


def _settings(config: PageConfig) -> tuple[list[Any], list[Any]]:
    with gr.Accordion("More settings", open=False):
        with gr.Row():
            model = gr.Dropdown(
                config.models,
                label="Quality or network",
                info="fast, balanced, best; sgbm: not a network",
                min_width=140,
            )
            engine = gr.Dropdown(
                config.engines, label="Engine", info="msnet bench times them", min_width=140
            )
        gr.Markdown("What is left out of 3D files:")
        with gr.Row():
            max_depth = gr.Number(
                0,
                label="Farther than, m",
                info=f"0: {MAX_DEPTH_RATIO:.0f} times the median depth",
                min_width=140,
            )
            confidence = gr.Slider(
                0, 1, MIN_CONFIDENCE, step=0.05, label="Less confident than", min_width=140
            )
    return [model, engine], [max_depth, confidence]


def _results(parts: dict[str, Any], opening: Updates) -> tuple[Any, Any]:
    with gr.Row(elem_id="waiting"):
        parts["progress"] = gr.HTML(
            html_template="<div><span><i></i></span><output></output></div>",
            js_on_load=_script("progress.js"),
            elem_id="progress",
        )
        parts["cancel"] = gr.Button(
            "Cancel", visible=False, size="sm", scale=0, min_width=90, elem_id="cancel"
        )
    with gr.Tabs() as parts["tabs"]:
        with gr.Tab("Depth", id="depth"):
            parts["view"] = gr.HTML(
                opening["view"],
                html_template="<div></div>",
                js_on_load=_viewer(),
                elem_id="view",
            )
        with gr.Tab("3D", id="shape") as tab:
            kind = gr.Radio(list(SHAPES), value="Surface", show_label=False, elem_id="kind")
            parts["distance"] = gr.Number(opening["distance"], visible=False)
            parts["shape"] = gr.Model3D(
                camera_position=(90, 90, None),
                show_label=False,
                interactive=False,
                elem_id="shape",
            )
            gr.Markdown(
                "Drag to turn, scroll or pinch to come closer. Without metres the shape supposes a "
                "field of view of 60 degrees."
            )
    with gr.Row(elem_id="downloads"):
        for name, label in _DOWNLOADS.items():
            known = opening[name]
            parts[name] = gr.DownloadButton(
                label,
                value=known["value"],
                interactive=known["interactive"],
                size="md",
                min_width=140,
                elem_id=f"download-{name}",
            )
    parts["facts"] = gr.Markdown(opening["facts"], elem_id="facts")
    return kind, tab


def _error(name: str) -> Any:
    return gr.HTML("", elem_id=name, elem_classes="field-error")


def _footer() -> str:
    links: list[str] = []
    with suppress(PackageNotFoundError):  # run from its sources
        for entry in metadata("mobilestereonet").get_all("Project-URL", []):
            name, _, url = (html.escape(part.strip()) for part in entry.partition(","))
            links.append(f"<a href='{url}' target='_blank' rel='noopener'>{name.lower()}</a>")
    parts = [
        f"mobilestereonet {html.escape(mobilestereonet.__version__)}",
        "code and weights under Apache-2.0",
        *links,
        "help: <code>msnet web --help</code>",
        "pictures stay on the machine that serves this page",
    ]
    return " · ".join(parts)


def _viewer() -> str:
    """The script of the viewer, which the exported page has, too."""
    levels = np.arange(256, dtype=np.float32)[None] / 256
    colours = colour_disparity(levels, maximum=1.0).tobytes().hex()
    shared = files("mobilestereonet.export").joinpath("page")
    scripts = [shared.joinpath(name).read_text("utf-8") for name in ("reading.js", "viewer.js")]
    return "\n".join([f'const COLOURS = "{colours}";', *scripts, _script("view.js")])


def _script(name: str) -> str:
    return files(__package__).joinpath(name).read_text("utf-8")


def page_style() -> dict[str, Any]:
    """Arguments of ``launch`` that style the page, with the system's own fonts."""
    fonts = ["system-ui", "sans-serif"], ["ui-monospace", "monospace"]
    theme = gr.themes.Default(font=fonts[0], font_mono=fonts[1]).set(
        block_info_text_color="*neutral_600", block_info_text_color_dark="*neutral_300"
    )
    shared = files("mobilestereonet.export").joinpath("page/viewer.css").read_text("utf-8")
    return {
        "theme": theme,
        "css": shared + _script("page.css"),
    }
