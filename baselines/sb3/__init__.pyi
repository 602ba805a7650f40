from .agent import PPOAgent, SACAgent, SB3Agent, TQCAgent, make_learner
from .config import (
    PolicyKwargs,
    PPOConfig,
    SACConfig,
    SB3Config,
    TQCConfig,
    read_presets,
)
from .from_model import WarmStart, warm_start

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
