"""Shapes are checked while the tests run: jaxtyping's annotations, enforced by beartype."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import jaxtyping
from beartype import beartype

ROOT = Path(__file__).parent.parent
PACKAGES = ("mcpilco", "envs", "baselines")


def install() -> None:
    """Check every module of the project that is imported from now on."""
    jaxtyping.install_import_hook(_checked_modules(), f"{__name__}.check")


def check(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with its array arguments and results checked.

    Other arguments are mypy's, and the code's own checks': a test may hand over a fake or a wrong
    value.
    """
    arrays = {name: hint for name, hint in function.__annotations__.items() if _has_array(hint)}
    function.__annotations__ = arrays
    return beartype(function)


def _has_array(hint: Any) -> bool:
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return True
    return any(_has_array(part) for part in get_args(hint))


def _checked_modules() -> list[str]:
    """All modules but lists of names (`__init__`) and what numba compiles: plain functions only."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return sorted(
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in paths
        if path.stem != "__init__" and "from numba import" not in path.read_text(encoding="utf-8")
    )
