"""Envs that do what was measured: the keyword `effects`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, TypeVar

from envs.equations import EquationsOfMotion
from mcpilco.plant import Correction, Plant, corrected, correction_from, read_correction
from mcpilco.typing import InputError

Effects = str | os.PathLike[str] | Mapping[str, Any] | Correction
"""a correction, its file, or what that file holds"""
System = TypeVar("System", bound=EquationsOfMotion)


def correct(dynamics: System, plant: Plant, effects: Effects | None) -> tuple[System, Plant | None]:
    """Equations of motion with corrected parameters, and their plant with all effects.

    Args:
        dynamics: nominal equations of motion.
        plant: the same system; parameters have the names that they have there.
        effects: the correction; None leaves the equations alone and gives no plant.

    Raises:
        InputError: the correction cannot be read, or does not fit the plant.
    """
    if effects is None:
        return dynamics, None
    nominal = asdict(dynamics)  # type: ignore[call-overload]  # every system is a dataclass
    plant = corrected(plant.where(**nominal), _read(effects))
    known = {p.name: p.value for p in plant.parameters if p.name in nominal}
    return replace(dynamics, **known), plant  # type: ignore[type-var]


def _read(effects: Effects) -> Correction:
    if isinstance(effects, Correction):
        return effects
    if isinstance(effects, Mapping):
        return correction_from(dict(effects))
    if isinstance(effects, str | os.PathLike):
        return read_correction(os.fspath(effects))
    raise InputError(
        "effects must be a file such as gap/corrected.json, what such a file holds, or a "
        f"mcpilco.plant.correction.Correction, got {effects!r}."
    )
