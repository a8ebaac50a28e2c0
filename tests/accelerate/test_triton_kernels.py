import os
import subprocess
import sys
from pathlib import Path

from extras import need_extra

need_extra("triton")


def test_kernels_equal_pytorch():
    script = Path(__file__).with_name("interpreted_kernels.py")
    environment = {**os.environ, "TRITON_INTERPRET": "1"}
    subprocess.run([sys.executable, str(script)], env=environment, check=True)
