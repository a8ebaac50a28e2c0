"""What the page looks like: its layout, and which handler each event has."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import gradio as gr

from mobilestereonet.data.images import to_picture
from mobilestereonet.web.answer import MAX_DEPTH_RATIO
from mobilestereonet.web.handlers import Handlers, PageConfig
from mobilestereonet.web.sessions import MAX_IDLE_SECONDS

_ABOUT = """# Depth from two pictures
Two pictures of one scene, taken side by side (a **rectified stereo pair**), become a disparity
map, a depth in metres for every pixel, and a 3D point cloud. Take an example, or your own pair.
"""


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
    # gradio looks for files in whatever is sent to a component, be it a number.
    for block in page.blocks.values():
        _refuse_addresses(block)
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


def _refuse_addresses(block: Any) -> None:
    """Keep gradio from fetching a web address that is sent in place of an upload's path."""
    move = block.async_move_resource_to_block_cache

    async def move_local(path: Any) -> Any:
        if "://" in str(path):
            raise gr.Error("upload the picture itself", print_exception=False)
        return await move(path)

    block.async_move_resource_to_block_cache = move_local


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
    known = " Left empty, this page's cameras are taken." if config.rectifier else ""
    gr.Markdown(
        "### 2. The cameras\nFrom your calibration, for pictures of this size; doffs is the "
        "principal points' difference, mostly 0. Without focal length and baseline there is a "
        f"disparity, but no depth in metres and no 3D.{known}"
    )
    with gr.Row():
        focal = gr.Number(0, label="Focal, px", min_width=90, elem_id="focal")
        baseline = gr.Number(0, label="Baseline, m", min_width=90, elem_id="baseline")
        doffs = gr.Number(0, label="doffs, px", min_width=90, elem_id="doffs")
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
                js_on_load=_readout(),
                elem_id="readout",
            )
        with gr.Tab("Confidence"):
            gr.Markdown("White: sure to be within 3 px. Black: a guess. (sgbm tells none.)")
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


def _readout() -> str:
    """The script that tells the depth under the pointer."""
    shared = files("mobilestereonet.export").joinpath("page/reading.js")
    return "\n".join(f.read_text("utf-8") for f in (shared, files(__package__) / "readout.js"))


def page_style() -> dict[str, Any]:
    """Arguments of ``launch`` that style the page, with the system's own fonts."""
    fonts = ["system-ui", "sans-serif"], ["ui-monospace", "monospace"]
    return {
        "theme": gr.themes.Default(font=fonts[0], font_mono=fonts[1]),
        "css": files(__package__).joinpath("page.css").read_text("utf-8"),
    }
