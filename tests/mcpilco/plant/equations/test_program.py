"""A formula left on a tape is the formula, and nothing is on the tape in vain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import pytest
import torch

from mcpilco.plant.arithmetic import Tape, cos, exp, larger, sin, smaller, sqrt, tanh
from mcpilco.plant.equations.program import Program

FORMULAS: dict[str, Callable[[Any, Any], Any]] = {
    "sums": lambda x, y: 2.0 + x - y + (x - 3.0) - (1.0 - y),
    "products": lambda x, y: -x * y * 3.0 / 7.0 + 2.0 / y + x / y,
    "waves": lambda x, y: sin(x) * cos(y) + tanh(x * y),
    "powers": lambda x, y: exp(-1.0 * x * x) + sqrt(2.0 + x * x) + abs(y) * y,
    "choices": lambda x, y: smaller(larger(x, -0.5), y) + larger(y, 0.2),
}


def traced(formula: Callable[..., Any], width: int = 2) -> Program:
    tape = Tape(width)
    return Program.of(tape, [formula(*tape.inputs)])


@pytest.mark.parametrize("name", FORMULAS)
def test_a_program_computes_its_formula(name):
    formula, points = FORMULAS[name], torch.randn(20, 2, dtype=torch.float64)
    points = points + points.sign()  # away from a division by 0
    found = traced(formula)(points)[:, 0]
    expected = [formula(x, y) for x, y in points.tolist()]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize("name", FORMULAS)
def test_a_program_on_another_tape_is_the_same(name):
    program, tape = traced(FORMULAS[name]), Tape(2)
    again = Program.of(tape, program.on_tape(tape.inputs))
    points = torch.rand(20, 2, dtype=torch.float64) + 1.0
    torch.testing.assert_close(again(points), program(points), rtol=1e-15, atol=1e-15)
    assert len(again.operations) == len(program.operations)


@pytest.mark.parametrize("name", FORMULAS)
def test_a_programs_gradient_is_that_of_differences(name):
    points = torch.tensor([[0.3, 1.2], [-1.1, 0.7]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(traced(FORMULAS[name]), points)


def test_what_changes_nothing_is_not_on_the_tape():
    def idle(x: Any, y: Any) -> Any:
        return (x + 0.0) * 1.0 - 0.0 + 0.0 * y + 0.0 / y

    assert len(traced(idle).operations) == 0


def test_an_operation_that_occurs_twice_is_done_once():
    def repeated(x: Any, y: Any) -> Any:
        return sin(x * y) + sin(y * x)

    assert len(traced(repeated).operations) == 3


def test_what_no_result_needs_is_left_out():
    tape = Tape(1)
    (x,) = tape.inputs
    exp(x)
    assert len(Program.of(tape, [cos(x)]).operations) == 1


def results(values: Sequence[float]) -> Program:
    tape = Tape(2)
    return Program.of(tape, [*values, tape.inputs[1]])


def test_a_result_may_be_constant_or_an_input():
    found = results([math.pi])(torch.tensor([[1.0, 2.0], [3.0, 4.0]], dtype=torch.float64))
    assert found.tolist() == [[math.pi, 2.0], [math.pi, 4.0]]
