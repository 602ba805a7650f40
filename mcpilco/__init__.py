"""MC-PILCO: reinforcement learning with Gaussian-process models, particles and policy gradients.

import envs  # registers mcpilco/CartPoleSwingUp-v0
from mcpilco import MCPILCO

agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", seed=0)
agent.learn(total_timesteps=150, progress_bar=True)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mcpilco.agent import MCPILCO
    from mcpilco.config import PRESETS, Config
    from mcpilco.data import Rollout, Transitions
    from mcpilco.task import TaskSpec

__all__ = ["MCPILCO", "PRESETS", "Config", "Rollout", "TaskSpec", "Transitions"]
__version__ = "0.1.0"

_HOMES = {
    "MCPILCO": "mcpilco.agent.agent",
    "PRESETS": "mcpilco.config",
    "Config": "mcpilco.config",
    "Rollout": "mcpilco.data",
    "TaskSpec": "mcpilco.task",
    "Transitions": "mcpilco.data",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: `mcpilco --help` then answers at once."""
    if name not in _HOMES:
        public = ", ".join(__all__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {public}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """The public names, which are loaded when they are first asked for."""
    return sorted(__all__)
