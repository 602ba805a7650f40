"""Shapes are checked while the tests run: jaxtyping's annotations, enforced by beartype.

Of each function the first calls in a test are: with checks of all calls tests took 1.4 to 1.6 times
as long, and the hundredth step of a search seldom has other shapes than the first.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import cache, partial, wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import beartype

ROOT = Path(__file__).parent.parent
PACKAGES = ("mcpilco", "envs", "baselines")
MOST = 20
"""calls of a function that are checked in a test"""

_running = SimpleNamespace(test=0)
"""number of the test that runs"""


def install() -> None:
    """Check every module of the project that is imported from now on."""
    jaxtyping.jaxtyped = partial(_checked_at_first, jaxtyping.jaxtyped)  # the hook's decorator
    jaxtyping.install_import_hook(_checked_modules(), f"{__name__}.check")


def begin_test() -> None:
    """Check the first calls again."""
    _running.test += 1


def check(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with its array arguments and results checked.

    Other arguments are mypy's, and the code's own checks': a test may hand over a fake or a wrong
    value.
    """
    arrays = {name: hint for name, hint in function.__annotations__.items() if _has_array(hint)}
    function.__annotations__ = arrays
    return beartype(function)


def _checked_at_first(
    jaxtyped: Callable[..., Any], kind: Any = None, *, typechecker: Callable[..., Any]
) -> Any:
    """What is checked for its first calls, where it has arrays; the `__init__` of a dataclass too.

    Without a function or class: the decorator.
    """
    if kind is None:
        return partial(_checked_at_first, jaxtyped, typechecker=typechecker)
    if inspect.isclass(kind):
        if is_dataclass(kind) and "__init__" in vars(kind):
            kind.__init__ = _checked_at_first(jaxtyped, kind.__init__, typechecker=typechecker)
        return kind
    if not _takes_arrays(kind):
        return kind

    @cache  # when it is first called, for few of all functions are called in a run
    def checked() -> Callable[..., Any]:
        return jaxtyped(kind, typechecker=typechecker)

    left, test = MOST, _running.test

    @wraps(kind)
    def function(*args: Any, **kwargs: Any) -> Any:
        nonlocal left, test
        if test != _running.test:
            left, test = MOST, _running.test
        left -= 1
        return (checked() if left >= 0 else kind)(*args, **kwargs)

    return function


def _takes_arrays(function: Callable[..., Any]) -> bool:
    """Whether a function takes or returns arrays, or may."""
    try:
        return any(map(_has_array, get_type_hints(function).values()))
    except NameError:  # of a module that is imported for types only
        return True


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
