"""Image decoders without messages of their own: this package's errors say what is wrong."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from threading import Lock

import cv2


class QuietDecoders:
    """Context without warnings of Pillow and messages of OpenCV.

    Both are settings of the process: of several threads in it at once the first sets them, and
    the last puts the caller's back.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._inside = 0
        self._settings = ExitStack()

    def __enter__(self) -> None:
        """Silence the decoders, if no other thread has."""
        with self._lock:
            self._inside += 1
            if self._inside > 1:
                return
            logging = cv2.utils.logging
            self._settings.callback(logging.setLogLevel, logging.getLogLevel())
            logging.setLogLevel(logging.LOG_LEVEL_SILENT)
            self._settings.enter_context(warnings.catch_warnings())
            warnings.filterwarnings("ignore", module=r"PIL\.")

    def __exit__(self, *error: object) -> None:
        """Put the settings back, if no other thread needs them."""
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._settings.close()


quiet_decoders = QuietDecoders()
"""The one of the process."""
