"""``msnet web``."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.engine import (
    Device,
    MatcherOptions,
    Model,
    NetworkValues,
    Precision,
    QualityLevel,
    Threads,
    Weights,
)
from mobilestereonet.errors import InputError


def web(
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets the whole network in.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(help="Default: the first free one from 7860 on.")
    ] = None,
    model: Model = None,
    weights: Weights = None,
    quality: QualityLevel = None,
    precision: Precision = "auto",
    threads: Threads = None,
    device: Device = "auto",
    settings: NetworkValues = None,
    max_megapixels: Annotated[
        float, typer.Option(help="Larger pictures are scaled down to so much.")
    ] = 2.1,
    max_megabytes: Annotated[int, typer.Option(help="Largest upload that is taken.")] = 20,
    queue: Annotated[int, typer.Option(help="Visitors who may wait.")] = 8,
    *,
    cameras: RigFiles,
) -> None:
    """Serve a page to try pairs on, to this machine alone by default.

    --model, --weights or --quality choose what it begins with; visitors can take another. With
    --rig the pairs of one camera need no numbers: raw ones are rectified.
    """
    import signal
    import sys
    from dataclasses import replace
    from importlib.util import find_spec
    from threading import Event

    options = MatcherOptions(precision=precision, threads=threads, device=device, settings=settings)
    own = replace(options, model=model, weights=weights, quality=quality)
    if find_spec("gradio") is None:
        raise InputError('gradio is not installed: pip install "mobilestereonet[web]"')

    from mobilestereonet.engines.choose import ENGINES
    from mobilestereonet.engines.sgbm import StereoSGBM
    from mobilestereonet.inference import DEFAULT_QUALITY, QUALITIES, StereoMatcher
    from mobilestereonet.web.examples import examples
    from mobilestereonet.web.handlers import PageConfig
    from mobilestereonet.web.server import running
    from mobilestereonet.web.uploads import UploadLimits
    from mobilestereonet.weights import embedded_models, load_model

    first = weights.name if weights else model or quality or DEFAULT_QUALITY

    def matcher(name: str, engine: str) -> StereoMatcher:
        if name == StereoSGBM.name:
            return StereoMatcher.from_pretrained(name)
        if name == first and not own.is_default:
            chosen = own
        elif name in QUALITIES:
            chosen = replace(options, quality=name)
        else:
            chosen = replace(options, model=name)
        wanted = {} if chosen.is_standalone else {"confidence": True}
        return replace(chosen, runtime=engine).open_matcher(**wanted)

    rectifier = cameras.read()
    if rectifier is not None:  # where the server keeps its files is nobody's business
        rectifier.rig = replace(rectifier.rig, name="the cameras of this page")
    if settings:  # a mistake is told now, not to the first visitor
        for name in embedded_models():
            load_model(name, config=options.config)
    names = dict.fromkeys([first, *QUALITIES, *embedded_models(), StereoSGBM.name])
    config = PageConfig(
        models=list(names),
        engines=[name for name in ENGINES if find_spec(name)],
        matcher=matcher,
        examples=examples(),
        limits=UploadLimits(max_megabytes, round(max_megapixels * 1e6), queue),
        rectifier=rectifier,
    )
    # So that files are deleted however the server is ended.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    print("msnet: matching the example that the page opens with ...", file=sys.stderr, flush=True)
    with running(config, host=host, port=port) as address:
        print(f"{address} (end with Ctrl-C)", flush=True)
        if host not in ("127.0.0.1", "localhost", "::1"):
            print("msnet: without a password, to all who reach this machine", file=sys.stderr)
        try:
            Event().wait()
        except KeyboardInterrupt:
            print("ended, files deleted")
