"""Presets from files like those of rl-baselines3-zoo: numbers of an algorithm by env id.

A file is YAML; each env id at its left margin has the entries of the algorithm's config, named as
the arguments of stable-baselines3. `default` is for envs that are not named. Nothing in it is
executed.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from baselines.sb3.config import SB3Config
from mcpilco.config import Preset, from_dict
from mcpilco.typing import InputError

_FALLBACK = "default"


@dataclass(frozen=True)
class TunedPreset(Preset):
    """A setting that has numbers of its own for some envs."""

    by_env: Mapping[str, SB3Config] = field(default_factory=dict)
    """numbers by env id; `config` is for all others"""

    def config_for(self, env_id: str) -> SB3Config:
        """The numbers for an env; `module:Id` is `Id`."""
        return self.by_env.get(env_id.rsplit(":", maxsplit=1)[-1], self.config)


def read_presets(path: str | Path, config_type: type[SB3Config]) -> dict[str, SB3Config]:
    """The numbers in a YAML file, by env id.

    Args:
        path: of the file.
        config_type: of the algorithm.

    Raises:
        InputError: the file cannot be read, or an entry is unknown or of another type.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeError) as error:
        raise InputError(f"The presets in {path} cannot be read: {error}.") from error
    return _presets(text, str(path), config_type)


def shipped(algo: str, config_type: type[SB3Config]) -> dict[str, TunedPreset]:
    """The preset that this package ships for an algorithm, under the name `default`."""
    file = resources.files(__package__) / "presets" / f"{algo}.yml"
    by_env = _presets(file.read_text(encoding="utf-8"), file.name, config_type)
    fallback = by_env.pop(_FALLBACK)
    return {_FALLBACK: TunedPreset("tuned for the envs of this package", fallback, {}, by_env)}


def _presets(text: str, name: str, config_type: type[SB3Config]) -> dict[str, SB3Config]:
    import yaml

    try:
        content = yaml.safe_load(io.StringIO(text))
    except yaml.YAMLError as error:
        raise InputError(f"{name} is no YAML: {error}.") from error
    if not isinstance(content, Mapping):
        raise InputError(f"{name} must hold entries under env ids, got {content!r}.")
    try:
        return {str(env): from_dict(config_type, _entries(v)) for env, v in content.items()}
    except InputError as error:
        raise InputError(f"{name} cannot be used: {error}") from error


def _entries(values: Any) -> Any:
    """With n_timesteps as a whole number: the zoo writes 2e4."""
    steps = values.get("n_timesteps") if isinstance(values, Mapping) else None
    if isinstance(steps, float) and steps.is_integer():
        return {**values, "n_timesteps": int(steps)}
    return values
