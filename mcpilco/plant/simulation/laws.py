"""The formulas of the effects for compiled callers: the same Python functions, compiled by numba.

The forces of the catalogue are compiled into the loops. That of a user's own effect is compiled for
itself and called by its address, so that the loops need not be compiled anew for it.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import cfunc, njit, types
from numba.core.errors import NumbaError
from numba.extending import intrinsic, overload

from mcpilco.bodies import INLINED, INNER, lane, lanes_of, with_lane
from mcpilco.plant import arithmetic
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.effects.actuator import ActuatorLag, ActuatorRateLimit, serving, shaping
from mcpilco.plant.effects.joint import JointForce, SoftFriction
from mcpilco.plant.effects.memory import Moment, RememberingForce
from mcpilco.plant.simulation.layout import CONSTANTS
from mcpilco.typing import InputError

_BUILT_IN = (
    *(effect for effect in CATALOGUE.values() if isinstance(effect, JointForce)),
    SoftFriction(),
)
"""forces that are compiled into the loops; the code of each is its place here"""
_REMEMBERING = tuple(k for k, each in enumerate(_BUILT_IN) if isinstance(each, RememberingForce))
_OTHERS = {}
"""class of a user's force -> its code, which is the address of its compiled formula"""
_COMPILED = {}
"""code of a user's force -> the effect, and what keeps its compiled formula alive"""


def _overload_one(ours, for_floats):
    @overload(ours)
    def typed(x):
        return lambda x: for_floats(x)  # noqa: PLW0108  numba compiles its source


def _overload_two(ours, for_floats):
    @overload(ours)
    def typed(a, b):
        return lambda a, b: for_floats(a, b)  # noqa: PLW0108


@njit(**INLINED)
def _tanh(x):
    """Exact to rounding of 1, in half the time of the library's, which is of x near 0 too."""
    e = math.exp(-2.0 * abs(x))
    return math.copysign((1.0 - e) / (1.0 + e), x)


for _name in ("sin", "cos", "exp", "sqrt"):
    _overload_one(getattr(arithmetic, _name), getattr(math, _name))
_overload_one(arithmetic.tanh, _tanh)
_overload_two(arithmetic.smaller, min)
_overload_two(arithmetic.larger, max)


def code_of(effect: JointForce) -> int:
    """The code of a force in the column `Tables.law`; compiles a user's own formula.

    Raises:
        InputError: numba cannot compile its formula.
    """
    kind = type(effect)
    for code, known in enumerate(_BUILT_IN):
        if kind is type(known):
            return code
    if kind not in _OTHERS:
        formula, n = njit(**INLINED)(kind.force), len(kind.symbols)
        signature = types.float64(*[types.float64] * (2 + CONSTANTS))
        try:
            made = cfunc(signature, error_model="numpy", fastmath=INLINED["fastmath"])(
                lambda q, v, a, b, c, d: formula(q, v, *(a, b, c, d)[:n])
            )
        except (NumbaError, TypeError) as error:
            raise InputError(
                f"numba cannot compile the force of {effect.name}: write it with + - * / abs and "
                f"the functions of mcpilco.plant (sin, cos, tanh, exp, sqrt, smaller, larger). "
                f"{str(error).strip().splitlines()[0]}"
            ) from None
        _OTHERS[kind] = made.address
        _COMPILED[made.address] = effect, made
    return _OTHERS[kind]


def force_of(code: int) -> JointForce:
    """The effect of a code in the column `Tables.law`.

    Raises:
        InputError: there is no such law.
    """
    if 0 <= code < len(_BUILT_IN):
        return _BUILT_IN[code]
    if code not in _COMPILED:
        names = ", ".join(effect.name for effect in _BUILT_IN)
        raise InputError(f"there is no law {code} of a joint; 0, 1, ... are {names}.")
    return _COMPILED[code][0]


@intrinsic
def _call(context, address, q, v, a, b, c, d):
    """Calls the function of six numbers that is at an address."""

    def generate(context, builder, signature, arguments):
        double = ir.DoubleType()
        function = ir.FunctionType(double, [double] * (2 + CONSTANTS))
        target = builder.inttoptr(arguments[0], function.as_pointer())
        return builder.call(target, arguments[1:], attrs=("nounwind", "readnone"))

    return types.float64(types.int64, *[types.float64] * (2 + CONSTANTS)), generate


@njit(**INNER)
def _called(law, q, v, a, b, c, d):
    """The force of a user's own law, lane by lane."""
    force = 0.0 * q
    for k in range(lanes_of(q)):
        own = lane(a, k), lane(b, k), lane(c, k), lane(d, k)
        force = with_lane(force, k, _call(law, lane(q, k), lane(v, k), *own))
    return force


@njit(**INLINED)
def _moment(moment, k):
    """That of lane k."""
    return Moment(lane(moment.q, k), lane(moment.v, k), lane(moment.a, k), lane(moment.F, k))


def _lane_by_lane(method: str, formula, n: int):
    """A formula of n constants that decides by an `if`, for packs too."""
    formula = njit(**INLINED)(formula)

    def force(q, v, F, x, y, a, b, c, d):
        total = 0.0 * q
        for k in range(lanes_of(q)):
            own = (lane(a, k), lane(b, k), lane(c, k), lane(d, k))[:n]
            now = formula(lane(q, k), lane(v, k), lane(F, k), lane(x, k), lane(y, k), *own)
            total = with_lane(total, k, now)
        return total

    def begin(now, a, b, c, d):
        x = y = 0.0 * now.q
        for k in range(lanes_of(x)):
            own = (lane(a, k), lane(b, k), lane(c, k), lane(d, k))[:n]
            first, second = formula(_moment(now, k), *own)
            x, y = with_lane(x, k, first), with_lane(y, k, second)
        return x, y

    def follow(memory, since, before, now, a, b, c, d):
        x, y = memory
        for k in range(lanes_of(x)):
            own = (lane(a, k), lane(b, k), lane(c, k), lane(d, k))[:n]
            were = lane(x, k), lane(y, k)
            ways = lane(since, k), _moment(before, k), _moment(now, k)
            first, second = formula(were, *ways, *own)
            x, y = with_lane(x, k, first), with_lane(y, k, second)
        return x, y

    return njit(**INNER)({"force": force, "begin": begin, "follow": follow}[method])


def _dispatcher(method, given, otherwise, kind=JointForce, how=INLINED):
    """A method of the effects of a kind: called with a law, that of the effect with this code.

    Behind what is given it takes the four constants of the law.
    """
    scope = {"called": _called}
    lines = [f"def {method}(law, {', '.join(given)}, a, b, c, d):"]
    for k, effect in enumerate(_BUILT_IN):
        if not isinstance(effect, kind):
            continue
        n, remembers = len(effect.symbols), isinstance(effect, RememberingForce)
        if remembers and effect.decides:
            own = [*given, *"abcd"]
            scope[f"{method}_{k}"] = _lane_by_lane(method, getattr(effect, method), n)
        else:
            lacks = "F" * (not effect.loaded) + "xy" * (not remembers)
            own = [name for name in given if name not in lacks] + [*"abcd"[:n]]
            scope[f"{method}_{k}"] = njit(**INLINED)(getattr(effect, method))
        lines += [f"    if law == {k}:", f"        return {method}_{k}({', '.join(own)})"]
    lines += [f"    return {otherwise}"]
    exec("\n".join(lines), scope)  # numba compiles one function faster than a chain of them
    return njit(**how)(scope[method])


joint_force = _dispatcher("force", ("q", "v", "F", "x", "y"), "called(law, q, v, a, b, c, d)")
"""force of a law on its joint [N or N m], of position q, velocity v, what its actuators give, and
its memory (x, y)"""
begin = _dispatcher("begin", ("now",), "(0.0, 0.0)", RememberingForce, INNER)
_way = "memory", "since", "before", "now"
follow = _dispatcher("follow", _way, "memory", RememberingForce, INNER)
"""the memory of a law at a start and after a way, see `mcpilco.plant.effects.memory`"""


@njit(**INLINED)
def remembers(law):
    """Whether a law has a memory."""
    return law in _REMEMBERING


shaped = njit(**INLINED)(shaping(njit(**INLINED)))
"""the force that a command asks for, see `mcpilco.plant.effects.actuator.shaping`"""
served = njit(**INLINED)(serving(njit(**INLINED)))
"""the force that a servo gives of it, see `mcpilco.plant.effects.actuator.serving`"""
ramping = njit(**INLINED)(ActuatorRateLimit.shape)
lagging = njit(**INLINED)(ActuatorLag.shape)
"""the force of an actuator on its way, see `mcpilco.plant.effects.actuator`"""
