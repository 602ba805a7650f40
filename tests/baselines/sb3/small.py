"""Agents of stable-baselines3 that learn nothing in no time."""

from __future__ import annotations

from baselines.sb3 import PolicyKwargs, PPOConfig, SACConfig, SB3Config, TQCConfig

TINY_NET = PolicyKwargs(net_arch=(4,))
COMMON = {
    "n_timesteps": 24,
    "trial_steps": 12,
    "batch_size": 4,
    "policy_kwargs": TINY_NET,
    "horizon": 6,
}
TINY: dict[str, SB3Config] = {
    "sac": SACConfig(learning_starts=6, buffer_size=2000, **COMMON),
    "tqc": TQCConfig(learning_starts=6, buffer_size=2000, **COMMON),
    "ppo": PPOConfig(n_envs=2, n_steps=6, n_epochs=1, **COMMON),
}
