"""Numbers that take note of what is computed with them.

A formula that is written for floats, and called with these, leaves its operations on a tape: each
once, however often it occurs, and none that changes nothing, such as a product with 0 or 1. What a
general algorithm does in vain for a plane chain is so gone before anything is computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

INPUT, CONSTANT = -2, -1
ADD, SUBTRACT, MULTIPLY, DIVIDE, MINIMUM, MAXIMUM, SINE, COSINE, TANH, EXP, SQRT, ABS = range(12)
"""operations; those from `SINE` on take one number"""

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
        """A tape on which nothing is computed yet.

        Args:
            inputs: how many numbers will be given.
        """
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


def operate(operation: int, a: Real, b: Real) -> Real:
    """The result of an operation, of which one that takes one number takes the first."""
    return _binary(operation, a, b) if operation < SINE else _unary(operation, a)


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


def _unary(operation: int, x: Real) -> Real:
    if isinstance(x, Number):
        return Number(x.tape, x.tape.node(operation, x.node))
    return FLOATS[operation](x)


def sin(x: Real) -> Real:
    """Sine of an angle [rad]."""
    return _unary(SINE, x)


def cos(x: Real) -> Real:
    """Cosine of an angle [rad]."""
    return _unary(COSINE, x)


def tanh(x: Real) -> Real:
    """Hyperbolic tangent."""
    return _unary(TANH, x)


def exp(x: Real) -> Real:
    """e^x."""
    return _unary(EXP, x)


def sqrt(x: Real) -> Real:
    """Square root."""
    return _unary(SQRT, x)


def smaller(a: Real, b: Real) -> Real:
    """min(a, b)."""
    return _binary(MINIMUM, a, b)


def larger(a: Real, b: Real) -> Real:
    """max(a, b)."""
    return _binary(MAXIMUM, a, b)
