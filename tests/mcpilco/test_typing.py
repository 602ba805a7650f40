"""Laws of what the package shares: one family of errors, and protocols that its parts fit."""

from __future__ import annotations

import pytest

from mcpilco import typing
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, Dynamics, Policy
from tests.mcpilco.conftest import make_dynamics, make_policy

ERRORS = [kind for name, kind in vars(typing).items() if name.endswith("Error")]


@pytest.mark.parametrize("kind", ERRORS)
def test_every_error_can_be_caught_as_one(kind: type) -> None:
    assert issubclass(kind, typing.McPilcoError)
    assert kind.__doc__


def test_errors_are_also_what_python_calls_them() -> None:
    assert issubclass(typing.InputError, ValueError)
    assert issubclass(typing.NotPositiveDefiniteError, ArithmeticError)


def test_the_parts_fit_their_protocols(task: TaskSpec) -> None:
    assert isinstance(make_dynamics(task), Dynamics)
    assert isinstance(make_policy(task), Policy)
    assert isinstance(task.cost, Cost)
