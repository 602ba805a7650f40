"""The compiled loops on processors that have narrower vectors than this one."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="names the features of x86 processors"
)


def run(features: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    told = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": features, **environment}
    return subprocess.run(
        [sys.executable, *arguments], env={**os.environ, **told}, capture_output=True, text=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("features", ["+sse2,+fma", "+sse2,+avx,+avx2,+fma"])
def test_narrower_vectors_compute_the_same(features: str, tmp_path) -> None:
    chosen = "tests/mcpilco/search/fused", "-k", "kernel or number_of_particles or product"
    pytest_ = "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow"
    ran = run(features, *pytest_, *chosen, NUMBA_CACHE_DIR=str(tmp_path))
    assert ran.returncode == 0, ran.stdout


@pytest.mark.slow
def test_processor_without_fused_multiply_add_is_refused() -> None:
    ran = run("+sse2", "-c", "import mcpilco.search.fused")
    assert "ImportError: this processor has no fused multiply-add" in ran.stderr
