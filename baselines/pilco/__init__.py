"""PILCO: a Gaussian-process model, one Gaussian over the state matched in its moments, L-BFGS.

from baselines.pilco import PILCO

agent = PILCO("GPMean", "mcpilco/CartPoleSwingUp-v0", seed=0)
agent.learn(total_timesteps=150, progress_bar=True)
"""

from __future__ import annotations

from baselines.pilco.agent import PILCO
from baselines.pilco.model import PRESETS, PilcoConfig

__all__ = ["PILCO", "PRESETS", "PilcoConfig"]
