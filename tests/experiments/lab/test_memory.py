"""Freed memory is taken again, without a page of it being zeroed anew."""

import platform
import subprocess
import sys

import pytest

_FAULTS = """
import resource, numpy as np
from experiments.lab.pool import keep_freed_memory
{call}
n_faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt
fill = lambda: np.ones(1 << 21)
fill()
before = n_faults()
for _ in range(20):
    fill()
print(n_faults() - before)
"""
_ARRAY_PAGES = 8  # of 16 MB, the largest that there are: 2 MB


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have no mallopt")
def test_arrays_take_the_memory_of_those_before_them() -> None:
    def faults(call: str) -> int:
        command = [sys.executable, "-c", _FAULTS.format(call=call)]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert faults("") >= 20 * _ARRAY_PAGES  # else there is nothing to gain here
    assert faults("keep_freed_memory()") < _ARRAY_PAGES
