"""The numbers of SAC, TQC and PPO, named as in rl-baselines3-zoo, and their presets.

A file of presets is YAML; each env id at its left margin has the entries of the algorithm's config,
named as the arguments of stable-baselines3. `default` is for envs that are not named. Nothing in it
is executed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from mcpilco.config import Checked, Preset, from_dict
from mcpilco.typing import InputError

_OURS = ("n_timesteps", "trial_steps", "n_envs", "policy", "policy_kwargs", "horizon")
"""entries that the constructors of stable-baselines3 do not know, or know in another form"""


@dataclass(frozen=True)
class PolicyKwargs(Checked):
    """The networks."""

    net_arch: tuple[int, ...] = (64, 64)
    """units of each hidden layer, of policy and critics alike"""
    activation_fn: Literal["relu", "tanh"] = "relu"
    """of the hidden layers"""
    log_std_init: float | None = None
    """starting log standard deviation of the actions, of PPO or with `use_sde`; None: the
    library's"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.net_arch or min(self.net_arch) < 1:
            raise InputError(f"net_arch must name layers of at least 1 unit, got {self.net_arch}.")

    def keywords(self) -> dict[str, Any]:
        """As the policies of stable-baselines3 take them."""
        from torch import nn

        activation = {"relu": nn.ReLU, "tanh": nn.Tanh}[self.activation_fn]
        given: dict[str, Any] = {"net_arch": list(self.net_arch), "activation_fn": activation}
        return given if self.log_std_init is None else given | {"log_std_init": self.log_std_init}


@dataclass(frozen=True)
class SB3Config(Checked):
    """The numbers that all three algorithms have."""

    n_timesteps: int = 20_000
    """steps of the env that `mcpilco train` spends by default"""
    trial_steps: int = 600
    """steps of the env between two checkpoints, after each of which the policy is tried"""
    n_envs: int = 1
    """copies of the env that are stepped together; each of their steps counts"""
    policy: str = "MlpPolicy"
    """name of the policy's class"""
    policy_kwargs: PolicyKwargs = field(default_factory=PolicyKwargs)
    """the networks"""
    learning_rate: float = 3e-4
    """Adam's step size [-]"""
    batch_size: int = 256
    """transitions of one gradient step"""
    gamma: float = 0.99
    """discount of a step [-]"""
    use_sde: bool = False
    """state-dependent exploration in place of noise that is drawn for each step"""
    sde_sample_freq: int = -1
    """steps between two draws of it; -1: one a rollout"""
    horizon: int | None = None
    """steps of one episode; None takes the env's time limit"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(n_timesteps=1, trial_steps=1, n_envs=1, batch_size=1, sde_sample_freq=-1)
        self._at_least(horizon=1)
        self._positive("learning_rate", "gamma")
        self._at_most(gamma=1.0)
        if self.policy != "MlpPolicy":
            raise InputError(f'policy must be "MlpPolicy", got {self.policy!r}.')
        if self.trial_steps % self.steps_at_once:
            raise InputError(
                f"trial_steps must be a multiple of the {self.steps_at_once} steps that are taken "
                f"between two updates, got {self.trial_steps}."
            )

    @property
    def steps_at_once(self) -> int:
        """Steps of the env between two updates of the networks."""
        return self.n_envs

    @property
    def trials(self) -> int:
        """Trials that take `n_timesteps`."""
        return -(-self.n_timesteps // self.trial_steps)

    def keywords(self) -> dict[str, Any]:
        """As the constructor of the algorithm in stable-baselines3 takes them."""
        given = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        rest = {name: value for name, value in given.items() if name not in _OURS}
        return rest | {"policy_kwargs": self.policy_kwargs.keywords()}


@dataclass(frozen=True)
class SACConfig(SB3Config):
    """Soft actor-critic."""

    buffer_size: int = 100_000
    """transitions that the replay buffer holds; then the oldest go"""
    learning_starts: int = 500
    """steps of random inputs before the first update"""
    tau: float = 0.02
    """share of the critic that its slow copy takes on in an update [-]"""
    train_freq: int = 1
    """steps of each copy of the env between two updates"""
    gradient_steps: int = 1
    """gradient steps of an update; -1: as many as steps of the env"""
    ent_coef: str | float = "auto"
    """weight of the policy's entropy; auto: learned, from 1; auto_0.1: from 0.1 [-]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(buffer_size=1, learning_starts=0, train_freq=1, gradient_steps=-1)
        self._positive("tau")
        self._at_most(tau=1.0)
        if isinstance(self.ent_coef, str) and not _is_auto(self.ent_coef):
            raise InputError(
                f"ent_coef must be a number, auto, or auto_ and a number, got {self.ent_coef!r}."
            )

    @property
    def steps_at_once(self) -> int:
        return self.n_envs * self.train_freq


@dataclass(frozen=True)
class TQCConfig(SACConfig):
    """Truncated quantile critics: SAC with critics that predict quantiles of the return."""

    top_quantiles_to_drop_per_net: int = 2
    """highest quantiles that each critic leaves out, against optimism"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(top_quantiles_to_drop_per_net=0)


@dataclass(frozen=True)
class PPOConfig(SB3Config):
    """Proximal policy optimisation."""

    n_steps: int = 150
    """steps of each copy of the env between two updates"""
    n_epochs: int = 10
    """passes over these steps in an update"""
    gae_lambda: float = 0.95
    """weight of long returns in the advantage [-]"""
    clip_range: float = 0.2
    """largest change of an action's probability ratio [-]"""
    ent_coef: float = 0.0
    """weight of the policy's entropy [-]"""
    vf_coef: float = 0.5
    """weight of the value's error [-]"""
    max_grad_norm: float = 0.5
    """the gradient is scaled down to this norm"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(n_steps=2, n_epochs=1, ent_coef=0.0, vf_coef=0.0, gae_lambda=0.0)
        self._positive("clip_range", "max_grad_norm")
        self._at_most(gae_lambda=1.0)

    @property
    def steps_at_once(self) -> int:
        return self.n_envs * self.n_steps


def _is_auto(text: str) -> bool:
    """Whether it is `auto`, or `auto_` and a positive number."""
    start, _, number = text.partition("_")
    try:
        return start == "auto" and (text == "auto" or float(number) > 0)
    except ValueError:
        return False


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

    Raises:
        InputError: the file cannot be read, or an entry is unknown or of another type.
    """
    import yaml

    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeError) as error:
        raise InputError(f"The presets in {path} cannot be read: {error}.") from error
    except yaml.YAMLError as error:
        raise InputError(f"{path} is no YAML: {error}.") from error
    if not isinstance(content, Mapping):
        raise InputError(f"{path} must hold entries under env ids, got {content!r}.")
    try:
        return {str(env): from_dict(config_type, _entries(v)) for env, v in content.items()}
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from error


def shipped(algo: str, config_type: type[SB3Config]) -> dict[str, TunedPreset]:
    """The preset that this package ships for an algorithm, under the name `default`."""
    by_env = read_presets(Path(__file__).parent / "presets" / f"{algo}.yml", config_type)
    fallback = by_env.pop(_FALLBACK)
    return {_FALLBACK: TunedPreset("tuned for the envs of this package", fallback, {}, by_env)}


def _entries(values: Any) -> Any:
    """With n_timesteps as a whole number: the zoo writes 2e4."""
    steps = values.get("n_timesteps") if isinstance(values, Mapping) else None
    if isinstance(steps, float) and steps.is_integer():
        return {**values, "n_timesteps": int(steps)}
    return values
