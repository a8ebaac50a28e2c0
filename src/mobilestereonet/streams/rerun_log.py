"""Results for the Rerun viewer: a recording, or a viewer that runs."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from mobilestereonet.atomic import GrowingFile, check_outputs
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.inference import StereoResult
from mobilestereonet.streams.stream import StereoFrame

RERUN_ENDING = ".rrd"

_JPEG_QUALITY = 90


class RerunLog:
    """Log of results for the Rerun viewer, as a context manager; a file appears once it is whole.

    Entities on the timelines ``time`` and ``frame``: ``camera/left/image``,
    ``camera/right/image``, ``disparity`` (a depth image in px) and, if there is one,
    ``confidence``. With a calibration also the pinhole camera ``camera/left``, its ``depth`` in
    metres, and ``points``.

    Args:
        target: A file to write, ``.rrd``; "spawn", which opens the viewer; or the address of a
            viewer that runs, ``rerun+http://HOST:9876/proxy``.
        max_depth: Farther points are left out, in metres.

    Raises:
        InputError: If the target is none of these, a folder, or rerun is not installed.
    """

    def __init__(self, target: str | Path, *, max_depth: float = float("inf")) -> None:
        with needs_extra("rerun"):
            import rerun
        self._rerun: Any = rerun
        self.max_depth = max_depth
        self.path = file_of(target)
        self._target = str(target)
        self._log: Any = None

    def write(
        self, frame: StereoFrame, result: StereoResult, calibration: Calibration | None
    ) -> None:
        """Log a frame with its result.

        Raises:
            InputError: If the calibration is known to be of another size.
            OSError: If the file cannot be written.
        """
        rerun = self._rerun
        # The depth first: it refuses a calibration of another size.
        depth = None if calibration is None else result.depth(calibration)
        log = self._open() if self._log is None else self._log
        log.set_time("frame", sequence=frame.index)
        if frame.stamp is None:
            log.set_time("time", duration=frame.seconds)
        else:
            log.set_time("time", timestamp=np.datetime64(frame.stamp, "ns"))
        log.log("camera/left/image", rerun.Image(result.left).compress(_JPEG_QUALITY))
        if frame.pair is not None:
            right = rerun.Image(frame.pair.right_image).compress(_JPEG_QUALITY)
            log.log("camera/right/image", right)
        disparity = np.where(result.valid, result.disparity, np.float32(0))
        log.log("disparity", rerun.DepthImage(disparity, colormap="turbo"))
        if result.confidence is not None:
            log.log("confidence", rerun.Image(np.rint(255 * result.confidence).astype(np.uint8)))
        if calibration is not None:
            height, width = result.disparity.shape
            camera = rerun.Pinhole(
                focal_length=calibration.focal_lengths,
                principal_point=calibration.principal_point(width, height),
                resolution=(width, height),
                camera_xyz=rerun.ViewCoordinates.RDF,
            )
            log.log("camera/left", camera)
            log.log("camera/left/depth", rerun.DepthImage(depth, meter=1.0))
            cloud = result.points(calibration, max_depth=self.max_depth)
            log.log("points", rerun.Points3D(cloud.points, colors=cloud.colours))

    def _open(self) -> Any:
        rerun = self._rerun
        log = self._log = rerun.RecordingStream("mobilestereonet")
        if self.path is not None:
            self._growing = GrowingFile(self.path)
            log.save(self._growing.folder / self.path.name)
        elif self._target == "spawn":
            log.spawn()
        else:
            log.connect_grpc(self._target)
        log.log("/", rerun.ViewCoordinates.RDF, static=True)
        return log

    def __enter__(self) -> RerunLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._log is None:
            return
        self._log.flush()
        self._log.disconnect()
        if self.path is not None:
            with self._growing:
                if kind is None:
                    self._growing.appear(self._growing.folder / self.path.name)


def file_of(target: str | Path) -> Path | None:
    """The file that a target of `RerunLog` names; None for a viewer.

    Raises:
        InputError: If it is neither, or a folder.
    """
    if target == "spawn" or str(target).startswith("rerun+http"):
        return None
    path = Path(target)
    if path.suffix.lower() != RERUN_ENDING:
        raise InputError(
            f"{target}: a recording for Rerun is a file that ends in {RERUN_ENDING}; spawn opens "
            "the viewer, and rerun+http://HOST:9876/proxy is the address of one that runs"
        )
    check_outputs(path)
    return path
