"""Setting of the C library: keep the memory that tensors free."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress

# Parameters of glibc's mallopt, from its malloc.h.
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4


def keep_freed_memory() -> None:
    """Let this process keep freed memory for the next tensors, for good.

    By default glibc returns large blocks to the kernel, which hands them out again page by page,
    each cleared first: that can take longer than the convolution that fills them. The price: the
    process stays as large as it ever was. Hence only the command line calls this, never a library
    function. Elsewhere than in glibc nothing happens.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            mallopt = ctypes.CDLL("libc.so.6").mallopt
            mallopt(_MMAP_MAX, 0)
            mallopt(_TRIM_THRESHOLD, -1)
