"""The options that say which model an agent learns, of several commands."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

from mcpilco.cli.options import optional
from mcpilco.config import KERNELS
from mcpilco.typing import InputError

PHYSICS = "physics"
"""what a model's name says of its mean"""

SuitablePreset = Annotated[
    str | None, optional("NAME", "default; thorough where the mean is physics")
]
"""a preset, or the one that suits the model"""


def suitable_preset(given: str | None, algo: str, model: str | None) -> str:
    """The preset of a training: the one that is given, or the one that suits its model.

    Equations hold from the first trial on, so that it pays to search for longer in them.
    """
    physics = algo == "mcpilco" and PHYSICS in (model or "").split("+")
    return given or ("thorough" if physics else "default")


def with_model(
    config: Any,
    name: str | None = None,
    prior: Path | None = None,
    memory: int | None = None,
    delay: float | None = None,
) -> Any:
    """The agent's numbers with another model.

    Args:
        config: those of the preset.
        name: a sum of parts out of `mcpilco.config.KERNELS`; with `physics` the plant's equations
            are the mean.
        prior: file of the plant that the model knows, as `mcpilco gap` writes it.
        memory: how many past inputs a state holds.
        delay: how late the actuator answers [s].

    Raises:
        InputError: the algorithm has no such model, a part is unknown, or the file is no plant.
    """
    if (name, prior, memory, delay) == (None,) * 4:
        return config
    if not hasattr(config, "model"):
        raise InputError(
            "--model, --prior, --memory and --delay are options of the algorithm mcpilco."
        )
    numbers = {"memory": memory, "delay": delay}
    changes: dict[str, Any] = {key: value for key, value in numbers.items() if value is not None}
    if name is not None:
        parts = name.split("+")
        kernel = [part for part in parts if part != PHYSICS]
        if not kernel or not set(kernel) <= set(KERNELS):
            raise InputError(
                f"--model must be a sum of parts out of {', '.join(KERNELS)}, with {PHYSICS}+ "
                f"before it where the mean is the plant's, such as physics+rbf, got {name!r}."
            )
        mean = PHYSICS if PHYSICS in parts else "zero"
        changes |= {"kernel": "+".join(kernel), "mean": mean}
    if prior is not None:
        changes["plant"] = _described(prior)
    return dataclasses.replace(config, model=dataclasses.replace(config.model, **changes))


def _described(path: Path) -> dict[str, Any]:
    """What a file says of a plant, after a check that it does."""
    from mcpilco.plant import read_correction

    read_correction(path)
    return json.loads(path.read_text(encoding="utf-8"))
