"""Freed memory is handed out again without the kernel."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, resource, torch
from mobilestereonet.memory import keep_freed_memory
ctypes.CDLL("libc.so.6").prctl(41, 1, 0, 0, 0)  # PR_SET_THP_DISABLE: pages of one size
{call}
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
before = faults()
for _ in range(20):
    torch.ones(2**24)  # 64 MiB
print(faults() - before)
"""


def page_faults(call):
    program = [sys.executable, "-c", PROGRAM.format(call=call)]
    return int(subprocess.run(program, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_freed_memory_is_kept():
    assert page_faults("keep_freed_memory()") < 0.6 * page_faults("pass")
