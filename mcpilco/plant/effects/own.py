"""A user's own effects: forces in joints, as classes in a file that is executed only when given."""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from mcpilco.plant.effects import CATALOGUE, Effect, Symbol
from mcpilco.plant.effects.joint import JointForce
from mcpilco.plant.simulation.laws import code_of
from mcpilco.typing import InputError

Own = str | os.PathLike[str] | Effect | type[Effect]
"""a Python file with classes of effects, an effect, or its class"""
_STATES = ((0.3, 0.7), (-0.4, -1.1))
"""positions and velocities at which an effect that is neutral must give no force"""


def own_effects(given: Own | Iterable[Own]) -> tuple[Effect, ...]:
    """The effects that a user adds to the catalogue, checked and compiled.

    Of a Python file all classes of effects are taken; effects and their classes may be given too.

    Raises:
        InputError: a file cannot be executed or has no effect, an effect is no force in a joint,
            has a name that is taken, or a formula that cannot be compiled.
    """
    many = (given,) if isinstance(given, str | os.PathLike | Effect | type) else tuple(given)
    effects: dict[str, Effect] = {}
    for one in many:
        for effect in _effects_of(one):
            _check(effect)
            if effects.setdefault(effect.name, effect) is not effect:
                raise InputError(f"two effects have the name {effect.name!r}; rename one of them.")
    return tuple(effects.values())


def _effects_of(given: Own) -> list[Effect]:
    if isinstance(given, Effect):
        return [given]
    if isinstance(given, type):
        return [given()]
    path = Path(given)
    kinds = [
        kind
        for kind in vars(_executed(path)).values()
        if isinstance(kind, type) and issubclass(kind, Effect) and "name" in vars(kind)
        if kind not in map(type, CATALOGUE.values())
    ]
    if not kinds:
        raise InputError(
            f"{path} must have a class of an effect, got none: a subclass of "
            "mcpilco.plant.JointForce with a `name`."
        )
    return [kind() for kind in kinds]


def _executed(path: Path) -> ModuleType:
    """The module of a file, the same for the same content."""
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror or error}.") from None
    content = hashlib.sha256(str(path.resolve()).encode() + source).hexdigest()[:12]
    name = f"mcpilco_own_effects_{content}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None:
            raise InputError(f"{path} must be a Python file, with the ending .py.")
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            raise InputError(f"{path} fails: {type(error).__name__}: {error}") from error
        sys.modules[name] = module
    return sys.modules[name]


def _check(effect: Effect) -> None:
    """Raises InputError where an effect cannot be searched for and simulated."""
    kind = type(effect).__name__
    if not isinstance(effect, JointForce):
        raise InputError(
            f"{kind} must be a force in a joint, a subclass of mcpilco.plant.JointForce; effects "
            "of actuators, bodies and sensors are those of the catalogue."
        )
    if effect.name in CATALOGUE:
        raise InputError(f"{kind} has the name {effect.name!r} of the catalogue; rename it.")
    if not effect.symbols or not all(isinstance(s, Symbol) for s in effect.symbols):
        raise InputError(f"{kind} must have its parameters in `symbols`, as mcpilco.plant.Symbol.")
    if not (effect.__doc__ or "").strip():
        raise InputError(f"{kind} must have its formula as its docstring: reports show it.")
    code_of(effect)
    neutral = effect.neutral.tolist()
    if all(map(math.isfinite, neutral)):
        forces = [effect.force(q, v, *neutral) for q, v in _STATES]
        if any(force != 0.0 for force in forces):
            raise InputError(
                f"{kind} must give no force at the neutral values of its symbols, got {forces[0]:g}"
                f" N or N m at {', '.join(map(str, neutral))}; mend the formula or `neutral`."
            )
