"""Topics of bags, and what results are written to, as options of a command."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from mobilestereonet.cli.early import BAG_ENDINGS, ends_in

if TYPE_CHECKING:
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.streams.batch import Sink


Rerun: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Recording for the Rerun viewer to write, .rrd; or spawn, which opens the viewer, "
        "or the address of one that runs, rerun+http://HOST:9876/proxy.",
    ),
]


@dataclass(frozen=True)
class TopicOptions:
    """Options that say where a bag has its views."""

    left_topic: Annotated[
        str | None, typer.Option("--left", metavar="TOPIC", help="A bag's left images.")
    ] = None
    right_topic: Annotated[
        str | None, typer.Option("--right", metavar="TOPIC", help="A bag's right images.")
    ] = None
    tolerance: Annotated[
        float,
        typer.Option(
            metavar="<s>",
            min=0,
            help="Largest difference between the stamps of a bag's pair, in s.",
        ),
    ] = 0.01


@dataclass(frozen=True)
class SinkOptions:
    """Options that name files to which the results of many frames go together."""

    bag: Annotated[
        Path | None,
        typer.Option(
            help="Bag of results to write, .mcap (ROS 2) or .bag (ROS 1): disparity, confidence "
            "and, with a calibration, depth and points.",
            callback=ends_in(BAG_ENDINGS, "bags are"),
        ),
    ] = None
    rerun: Rerun = None

    @property
    def given(self) -> list[str]:
        """What is asked for."""
        return [str(sink) for sink in (self.bag, self.rerun) if sink is not None]

    @property
    def files(self) -> list[Path]:
        """The files that are asked for; a viewer is none."""
        return [Path(sink) for sink in self.given if sink.endswith((*BAG_ENDINGS, ".rrd"))]

    def open(
        self,
        stack: ExitStack,
        matcher: StereoMatcher,
        topics: tuple[str, ...] = (),
        taken: tuple[str, ...] = (),
    ) -> list[Sink]:
        """Open what the results go to.

        Args:
            stack: Closes it; files appear once it ends without an error.
            matcher: The matcher of the results; they get a confidence where it has one.
            topics: The source's topics of both views, if it is a bag.
            taken: Its topics of camera_info.

        Raises:
            InputError: If a file cannot be written, or an extra is not installed.
        """
        from mobilestereonet.streams import BagFile, RerunLog

        sinks: list[Sink] = []
        if self.bag is not None:
            bag = BagFile(self.bag, matcher.max_disparity, topics=topics, taken=taken)
            sinks.append(stack.enter_context(bag).write)
        if self.rerun is not None:
            log = RerunLog(self.rerun)
            sinks.append(stack.enter_context(log).write)
        if sinks:
            matcher.confidence = matcher.engine.has_confidence
        return sinks
