"""Results of a stream for somebody who looks: in a window, or on a page of this machine."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable
from threading import Event
from types import TracebackType

import cv2
import numpy as np

from mobilestereonet.data.images import Mask, Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoResult
from mobilestereonet.inference.filter import NO_LIMITS
from mobilestereonet.plots import side_by_side
from mobilestereonet.streams.colours import SmoothedRange
from mobilestereonet.streams.stream import StereoFrame

_ESCAPE = 27
_MAX_WINDOW_PX = 1280


class FrameRate:
    """Frames per second over the last two seconds, or since the first frame."""

    memory = 2.0

    def __init__(self) -> None:
        self._moments: deque[float] = deque()

    def update(self, moment: float) -> float:
        """Count a frame at a moment in s; gives the rate, 0 at the first one."""
        self._moments.append(moment)
        while moment - self._moments[0] > self.memory and len(self._moments) > 2:
            self._moments.popleft()
        past = moment - self._moments[0]
        return (len(self._moments) - 1) / past if past > 0 else 0.0


class Screen:
    """Sink that shows each result as it comes: left view, disparity, confidence, and the rate.

    Pixels that the matcher's filter or the left-right check leaves out are black.

    Args:
        show: Shows a picture, such as `Window.show` or `BrowserPage.show`.
    """

    def __init__(self, show: Callable[[Picture], object]) -> None:
        self._show = show
        self._colours, self._rate = SmoothedRange(), FrameRate()

    def write(
        self, frame: StereoFrame, result: StereoResult, calibration: Calibration | None
    ) -> None:
        """Show a frame's result.

        Raises:
            InputError: If the calibration is known to be of another size.
        """
        rate = self._rate.update(time.monotonic())
        shown = _passing(result, calibration)
        panels = {
            "left view": result.left,
            f"disparity, {rate:.1f} frames per second": self._colours.colour(
                frame.seconds, result, shown
            ),
        }
        if result.confidence is not None:
            grey = np.rint(255 * result.confidence).astype(np.uint8)
            panels["confidence"] = grey[..., None].repeat(3, axis=2)
        self._show(side_by_side(list(panels.values()), list(panels)))


def _passing(result: StereoResult, calibration: Calibration | None) -> Mask:
    """The pixels whose disparity is known and that pass the result's filter."""
    if result.filter == NO_LIMITS and result.occluded is None:
        return result.valid
    return result.depth(calibration or Calibration(focal=1, baseline=1)) > 0


class Window:
    """A window of OpenCV, a context manager.

    Args:
        stop: Set when the window is closed, or when q or Escape is pressed in it.

    Raises:
        InputError: If there is no screen, or OpenCV is built without windows.
    """

    title = "msnet live"

    def __init__(self, stop: Event) -> None:
        page = "--show browser shows a page instead"
        if sys.platform == "linux" and not (
            os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        ):
            raise InputError(f"--show window: there is no screen here; {page}")
        try:
            cv2.namedWindow(self.title, cv2.WINDOW_NORMAL | cv2.WINDOW_KEEPRATIO)
        except cv2.error:
            raise InputError(
                f"--show window: this OpenCV opens no windows (opencv-python-headless); {page}, "
                "and pip install --force-reinstall opencv-python brings windows"
            ) from None
        self._stop = stop
        self._shown = False

    def show(self, picture: Picture) -> None:
        """Show an RGB picture until the next one comes."""
        if not self._shown:
            height, width = picture.shape[:2]
            scale = min(1.0, _MAX_WINDOW_PX / width)
            cv2.resizeWindow(self.title, round(scale * width), round(scale * height))
            self._shown = True
        cv2.imshow(self.title, picture[..., ::-1])
        pressed = cv2.waitKey(1) & 0xFF
        closed = cv2.getWindowProperty(self.title, cv2.WND_PROP_VISIBLE) < 1
        if closed or pressed in (_ESCAPE, ord("q")):
            self._stop.set()

    def __enter__(self) -> Window:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        cv2.destroyAllWindows()
