"""What the processor can do, told to the library that multiplies matrices."""

from __future__ import annotations

import os
from pathlib import Path

_AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}


def choose_blas_kernels(cpuinfo: Path = Path("/proc/cpuinfo")) -> None:
    """Let OpenBLAS use AVX-512 where the processor has it.

    OpenBLAS knows processors by their model numbers and treats one it has never heard of, or one
    behind a hypervisor, as an older one: its products then take up to three times as long. It
    reads the variable when it is loaded, so this runs before numpy or scipy are imported. A
    choice made by the user stands.
    """
    if "OPENBLAS_CORETYPE" in os.environ:
        return
    try:
        flags = next(line for line in cpuinfo.open() if line.startswith("flags"))
    except (OSError, StopIteration):
        return  # not Linux, or not x86: OpenBLAS decides
    if set(flags.split()) >= _AVX512:
        os.environ["OPENBLAS_CORETYPE"] = "SKYLAKEX"
