"""Freed memory is handed out again without the kernel."""

import subprocess
import sys

import pytest

PROGRAM = """
import resource, torch
from mobilestereonet.training.memory import keep_freed_memory
{call}
for _ in range(20):
    torch.ones(2**24)  # 64 MiB
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
"""


def page_faults(call):
    program = [sys.executable, "-c", PROGRAM.format(call=call)]
    return int(subprocess.run(program, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's setting")
def test_freed_memory_is_kept():
    assert page_faults("keep_freed_memory()") < 0.6 * page_faults("pass")
