from __future__ import annotations

import os
from pathlib import Path

import pytest

from mcpilco.processor import choose_blas_kernels

FULL = "flags\t\t: fpu avx2 avx512f avx512dq avx512cd avx512bw avx512vl\n"


@pytest.fixture(autouse=True)
def _no_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "")
    monkeypatch.delenv("OPENBLAS_CORETYPE")


def described(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "cpuinfo"
    path.write_text(text)
    return path


def test_wide_kernels_where_the_processor_has_all_the_instructions(tmp_path: Path) -> None:
    choose_blas_kernels(described(tmp_path, "processor\t: 0\n" + FULL))
    assert os.environ["OPENBLAS_CORETYPE"] == "SKYLAKEX"


@pytest.mark.parametrize("text", ["flags\t\t: fpu avx2 avx512f\n", "model name\t: unknown\n", ""])
def test_no_choice_where_they_are_missing_or_unknown(tmp_path: Path, text: str) -> None:
    choose_blas_kernels(described(tmp_path, text))
    assert "OPENBLAS_CORETYPE" not in os.environ


def test_no_choice_without_a_description(tmp_path: Path) -> None:
    choose_blas_kernels(tmp_path / "absent")
    assert "OPENBLAS_CORETYPE" not in os.environ


def test_the_users_choice_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "ZEN")
    choose_blas_kernels(described(tmp_path, FULL))
    assert os.environ["OPENBLAS_CORETYPE"] == "ZEN"
