"""The numbers of a training: a preset of an algorithm, and the model that is asked for."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcpilco.config import KERNELS
from mcpilco.plant import read_correction
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.agent.trial_agent import TrialAgent

PHYSICS = "physics"
"""the part of a model's name that makes the equations of the plant its mean"""


def suitable_preset(given: str | None, algo: str, model: str | None) -> str:
    """The preset of a training: the one that is given, or the one that suits its model.

    Equations hold from the first trial on, so that it pays to search for longer in them.
    """
    physics = algo == "mcpilco" and PHYSICS in (model or "").split("+")
    return given or ("thorough" if physics else "default")


def preset_numbers(
    kind: type[TrialAgent],
    preset_name: str,
    env_id: str,
    horizon: int | None = None,
    exploration: int | None = None,
) -> tuple[Any, dict[str, Any]]:
    """The agent's configuration and the env's keywords, of a preset.

    Without `horizon` [steps] it is the env's time limit, without `exploration` [steps] one rollout.

    Raises:
        InputError: the algorithm has no such preset, or does not explore beforehand.
    """
    if preset_name not in kind.presets:
        raise InputError(
            f"--preset of the algorithm {kind.algo} must be one of {sorted(kind.presets)}, "
            f"got {preset_name!r}."
        )
    preset = kind.presets[preset_name]
    env_kwargs = preset.keywords(env_id)
    config = preset.config_for(env_id)
    if exploration is not None:
        if not hasattr(config, "exploration"):
            raise InputError(
                f"--exploration is no option of the algorithm {kind.algo}; its presets say how it "
                "begins."
            )
        config = dataclasses.replace(config, exploration=exploration)
    if horizon is None:
        return config, env_kwargs
    config = dataclasses.replace(config, horizon=horizon)
    return config, {**env_kwargs, "max_episode_steps": horizon}


def with_model(
    config: Any,
    name: str | None = None,
    prior: Path | None = None,
    memory: int | None = None,
    delay: float | None = None,
) -> Any:
    """The agent's numbers with another model.

    `name` is a sum of parts out of `mcpilco.config.KERNELS`; with `physics` the equations of the
    plant are the mean, which the file `prior` describes, as `mcpilco gap` writes it. `memory` is
    how many past inputs a state holds, `delay` how late the actuator answers [s].

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
        read_correction(prior)  # it says what is wrong with the file
        changes["plant"] = json.loads(prior.read_text(encoding="utf-8"))
    return dataclasses.replace(config, model=dataclasses.replace(config.model, **changes))
