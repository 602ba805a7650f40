"""SAC, TQC and PPO of stable-baselines3, as agents of this package with presets for its envs.

from baselines.sb3 import make_learner

agent = make_learner("sac", "mcpilco/CartPoleSwingUp-v0", seed=0)
agent.learn(600)  # steps of the env
action, _ = agent.predict(observation)
"""

from __future__ import annotations

from baselines.sb3.agent import PPOAgent, SACAgent, SB3Agent, TQCAgent, make_learner
from baselines.sb3.config import (
    PolicyKwargs,
    PPOConfig,
    SACConfig,
    SB3Config,
    TQCConfig,
    read_presets,
)
from baselines.sb3.from_model import WarmStart, warm_start

__all__ = [
    "PPOAgent",
    "PPOConfig",
    "PolicyKwargs",
    "SACAgent",
    "SACConfig",
    "SB3Agent",
    "SB3Config",
    "TQCAgent",
    "TQCConfig",
    "WarmStart",
    "make_learner",
    "read_presets",
    "warm_start",
]
