"""``msnet live``."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from mobilestereonet.cli.calibration import CalibrationOptions
from mobilestereonet.cli.early import one_of
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.sinks import SinkOptions, TopicOptions
from mobilestereonet.cli.streaming import LeftSource, MatchedStream, RightSource, StreamOptions
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.streams.batch import Sink

_SHOW = "--show"
_SCREENS = ("window", "browser")


class LiveCommand(TyperCommand):
    """Command whose ``--show`` may stand alone, for a window."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of a call."""
        words = []
        for word, following in zip(args, [*args[1:], ""], strict=False):
            words += [word]
            if word == _SHOW and not _names_screen(following):
                words += [_SCREENS[0]]
        return super().parse_args(ctx, words)


def _names_screen(word: str) -> bool:
    """Whether a word is a screen, perhaps a misspelt one, and not a source."""
    return word in _SCREENS or (word.isalpha() and not Path(word).exists())


def live(
    left: LeftSource,
    right: RightSource = None,
    show: Annotated[
        str | None,
        typer.Option(
            _SHOW,
            metavar="[window|browser]",
            help="Show left view, disparity and frames per second: in a window (q or Escape ends "
            "it), or on a page of this machine, whose address is printed.",
            callback=one_of(_SCREENS),
        ),
    ] = None,
    confidence: Annotated[
        bool, typer.Option("--confidence", help="Show how sure the network is, too.")
    ] = False,
    *,
    source: StreamOptions,
    views: ViewFlags,
    topics: TopicOptions,
    sinks: SinkOptions,
    options: MatcherOptions,
    filters: FilterOptions,
    cameras: CalibrationOptions,
) -> None:
    """Match a camera as it runs: the newest frame wins.

    Takes what `msnet video` takes; a recording runs as fast as it was taken. Frames that come while
    another one is matched are dropped. The end of the source, Ctrl-C or closing the window ends it.
    """
    if show is None and not sinks.given:
        raise InputError(
            "nothing to show: give --show, --show browser, --rerun spawn or --bag FILE"
        )
    if confidence and show is None:
        raise InputError("--confidence needs --show: --rerun and --bag have the confidence anyway")
    from mobilestereonet.streams.stream import as_live

    stop = Event()
    with ExitStack() as stack:
        screens = [] if show is None else [_open_screen(show, stack, stop)]
        opened = MatchedStream.open(
            left,
            right,
            source=source,
            topics=topics,
            views=views,
            options=options,
            filters=filters,
            cameras=cameras,
            outputs=sinks.files,
            metric=bool(sinks.given),
            confidence=confidence,
        )
        opened = replace(opened, stream=as_live(opened.stream))
        files = opened.open_sinks(sinks, stack)
        told = opened.run(stop, [*screens, *files])
    print(told)


def _open_screen(show: str, stack: ExitStack, stop: Event) -> Sink:
    """Open a window or a page; closing the window sets the event."""
    from mobilestereonet.streams.browser import BrowserPage
    from mobilestereonet.streams.show import Screen, Window

    if show == "window":
        return Screen(stack.enter_context(Window(stop)).show).write
    page = stack.enter_context(BrowserPage())
    print(f"{page.address} (end with Ctrl-C)", flush=True)
    return Screen(page.show).write
