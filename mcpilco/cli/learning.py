"""The options of every command that learns: in which env, by which algorithm, of which model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mcpilco.cli.model import SuitablePreset, suitable_preset, with_model
from mcpilco.cli.options import Algo, TaskPath, optional
from mcpilco.cli.pairs import EnvKeywords, keywords
from mcpilco.cli.system import algorithm, given_task, numbers
from mcpilco.config import CART_POLE

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.agent import TrialAgent


@dataclass(frozen=True, kw_only=True)
class Learning:
    """What is learnt, and how."""

    env: str = CART_POLE
    """Gymnasium id of the env; `module:Id` imports the module first"""
    env_kwargs: EnvKeywords = ()
    """keywords of the env; of a JSON file, such as effects=gap/corrected.json, the content"""
    algo: Algo = "mcpilco"
    """mcpilco: particles; pilco: one Gaussian, matched in its moments; sac, tqc, ppo: of
    stable-baselines3; of another package `package:name`, or the name of its entry point"""
    preset: SuitablePreset = None
    """setting of the agent, and of the cart-pole; mcpilco has default, thorough, thesis and
    tro2022, pilco default and tip, the others default"""
    horizon: Annotated[int | None, optional("INT", "the env's time limit")] = None
    """steps of a rollout"""
    task: TaskPath = None
    """what to know of the env, where it does not show it"""
    exploration: Annotated[int | None, optional("INT", "one rollout")] = None
    """steps of random inputs at first; several rollouts, where they end early"""
    model: Annotated[str | None, optional("NAME", "that of the preset, rbf+mpk")] = None
    """of mcpilco: rbf, mpk, sed-mpk, sed-fir, features, friction, joined by +; physics+ before them
    makes the plant's equations the mean, physics+gip+ adds the forces that they lack"""
    prior: Annotated[Path | None, optional("FILE.json", "the nominal plant of the env")] = None
    """of mcpilco: the plant that physics and features know, such as gap/corrected.json"""
    memory: Annotated[int | None, optional("INT", "that of the preset, 0")] = None
    """of mcpilco: past inputs that model and policy see, for actuators that lag"""
    delay: Annotated[float | None, optional("SECONDS", "that of the preset, 0")] = None
    """of mcpilco: how late the actuator answers [s]; policies act on states predicted for then"""

    @property
    def chosen_preset(self) -> str:
        """The one that is given, or the one that suits the model."""
        return suitable_preset(self.preset, self.algo, self.model)

    def numbers(self) -> tuple[Any, dict[str, Any]]:
        """The agent's configuration and the env's keywords.

        Raises:
            InputError: the algorithm has no such preset, model or exploration, or a keyword of the
                env cannot be read.
        """
        config, env_kwargs = numbers(
            algorithm(self.algo), self.chosen_preset, self.env, self.horizon, self.exploration
        )
        config = with_model(config, self.model, self.prior, self.memory, self.delay)
        return config, env_kwargs | keywords("--env-kwargs", self.env_kwargs)

    def agent(self, env: gym.Env, config: Any, seed: int = 0) -> TrialAgent:
        """What learns: the algorithm with these numbers, in an env whose task is given or shown.

        Raises:
            McPilcoError: the numbers, the env and the task do not fit one another.
        """
        kind = algorithm(self.algo)
        return kind(kind.policy_name, env, config=config, seed=seed, task=given_task(self.task))
