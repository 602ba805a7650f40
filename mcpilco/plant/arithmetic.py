"""Arithmetic for formulas that are written once: of floats, arrays, tensors, or a tape's numbers.

A formula in Python that uses the operators, `abs` and the functions here (`sin`, `tanh`, `smaller`,
...) takes numbers of any kind. numba compiles the same source (`mcpilco.plant.simulation.laws`).
Called with a tape's numbers it leaves its operations on the tape: each once, however often it
occurs, and none that changes nothing, such as a product with 0 or 1. The operations that a general
algorithm wastes on a plane chain are gone before anything is computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

INPUT, CONSTANT = -2, -1
ADD, SUBTRACT, MULTIPLY, DIVIDE, MINIMUM, MAXIMUM, SINE, COSINE, TANH, EXP, SQRT, ABS = range(12)
"""operations; those from `SINE` on take one number"""
NAMES: tuple[str, ...] = ("add", "subtract", "multiply", "divide", "minimum", "maximum")
NAMES += ("sin", "cos", "tanh", "exp", "sqrt", "abs")
"""of the operations, in numpy and as methods of tensors"""

FLOATS: dict[int, Callable[..., float]] = {
    ADD: lambda a, b: a + b,
    SUBTRACT: lambda a, b: a - b,
    MULTIPLY: lambda a, b: a * b,
    DIVIDE: lambda a, b: a / b,
    MINIMUM: min,
    MAXIMUM: max,
    SINE: math.sin,
    COSINE: math.cos,
    TANH: math.tanh,
    EXP: math.exp,
    SQRT: math.sqrt,
    ABS: abs,
}


class Tape:
    """Operations in the order in which they were first asked for."""

    def __init__(self, inputs: int) -> None:
        self.nodes: list[tuple[int, float, int]] = [(INPUT, i, 0) for i in range(inputs)]
        """(operation, first, second): operands are nodes; a constant has its value in `first`"""
        self._places: dict[tuple[int, float, int], int] = {}
        self.inputs = [Number(self, i) for i in range(inputs)]

    def node(self, operation: int, first: float, second: int = 0) -> int:
        """The place of an operation, which is new only if it was not there yet."""
        key = (operation, first, second)
        if key not in self._places:
            self._places[key] = len(self.nodes)
            self.nodes.append(key)
        return self._places[key]

    def place(self, x: Real) -> int:
        """The node of a number."""
        return x.node if isinstance(x, Number) else self.node(CONSTANT, float(x))


class Number:
    """A number on a tape."""

    def __init__(self, tape: Tape, node: int) -> None:
        self.tape = tape
        self.node = node

    def __add__(self, other: Real) -> Real:
        return self if _is(other, 0.0) else _binary(ADD, self, other)

    def __radd__(self, other: float) -> Real:
        return self if other == 0.0 else _binary(ADD, self, other)

    def __sub__(self, other: Real) -> Real:
        return self if _is(other, 0.0) else _binary(SUBTRACT, self, other)

    def __rsub__(self, other: float) -> Real:
        return _binary(SUBTRACT, other, self)

    def __mul__(self, other: Real) -> Real:
        if _is(other, 0.0):
            return 0.0
        return self if _is(other, 1.0) else _binary(MULTIPLY, self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Real) -> Real:
        return _binary(DIVIDE, self, other) if isinstance(other, Number) else self * (1.0 / other)

    def __rtruediv__(self, other: float) -> Real:
        return 0.0 if other == 0.0 else _binary(DIVIDE, other, self)

    def __neg__(self) -> Real:
        return _binary(SUBTRACT, 0.0, self)

    def __abs__(self) -> Real:
        return _unary(ABS, self)


Real = float | Number


def operate(operation: int, a: Any, b: Any) -> Any:
    """The result of an operation, of which one that takes one number takes the first."""
    if operation >= SINE:
        return _unary(operation, a)
    return (_extreme if operation in (MINIMUM, MAXIMUM) else _binary)(operation, a, b)


def _is(x: Real, value: float) -> bool:
    return not isinstance(x, Number) and x == value


def _binary(operation: int, a: Real, b: Real) -> Real:
    tape = next((x.tape for x in (a, b) if isinstance(x, Number)), None)
    if tape is None:
        return FLOATS[operation](a, b)
    places = tape.place(a), tape.place(b)
    if operation in (ADD, MULTIPLY):
        places = min(places), max(places)
    return Number(tape, tape.node(operation, *places))


def _unary(operation: int, x: Any) -> Any:
    if isinstance(x, Number):
        return Number(x.tape, x.tape.node(operation, x.node))
    if isinstance(x, float | int):
        return FLOATS[operation](x)
    method = getattr(x, NAMES[operation], None)
    return method() if method else getattr(np, NAMES[operation])(x)


def _extreme(operation: int, a: Any, b: Any) -> Any:
    """The smaller or larger number; one that is infinite on the other side changes nothing."""
    endless = math.inf if operation == MINIMUM else -math.inf
    if isinstance(a, Number | float | int) and isinstance(b, Number | float | int):
        if _is(a, endless) or _is(b, endless):
            return b if _is(a, endless) else a
        return _binary(operation, a, b)
    if hasattr(a, "clamp") or hasattr(b, "clamp"):  # tensors
        import torch

        like = a if hasattr(a, "clamp") else b
        same = (torch.as_tensor(x, dtype=like.dtype, device=like.device) for x in (a, b))
        return getattr(torch, NAMES[operation])(*same)
    return getattr(np, NAMES[operation])(a, b)


X = TypeVar("X")


def sin(x: X) -> X:
    """Sine of an angle [rad]."""
    return _unary(SINE, x)


def cos(x: X) -> X:
    """Cosine of an angle [rad]."""
    return _unary(COSINE, x)


def tanh(x: X) -> X:
    """Hyperbolic tangent."""
    return _unary(TANH, x)


def exp(x: X) -> X:
    """e^x."""
    return _unary(EXP, x)


def sqrt(x: X) -> X:
    """Square root."""
    return _unary(SQRT, x)


def smaller(a: Any, b: Any) -> Any:
    """min(a, b)."""
    return _extreme(MINIMUM, a, b)


def larger(a: Any, b: Any) -> Any:
    """max(a, b)."""
    return _extreme(MAXIMUM, a, b)
