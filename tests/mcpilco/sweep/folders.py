"""Folders of sweeps that never ran."""

from __future__ import annotations

import json

SETTING = {
    "format": 1,
    "env": "envs:mcpilco/CartPoleSwingUp-v0",
    "env_kwargs": {},
    "preset": "default",
    "config": {"horizon": None},
    "trials": 2,
    "fresh": 100,
    "task": None,
    "fresh_horizon": None,
    "algo": "mcpilco",
}


def trials_of(shares, cpu_s=10.0, after=3.0, **values):
    """Rows whose policies succeed in these shares of their fresh rollouts."""
    return [
        {
            "trial": k,
            "experience_s": after * k,
            "success": None if p is None else p > 0.5,
            "p": p,
            "time_up_s": p,
            "mean_abs_cart_m": 0.1,
            "return": 10.0 * k,
            "fresh_return": None,
            "cpu_s": cpu_s,
            **values,
        }
        for k, p in enumerate(shares, start=1)
    ]


def write_sweep(path, seeds, cpu="Zen", **setting):
    """A folder with the trials of each seed; returns its path."""
    (path / "seeds").mkdir(parents=True)
    (path / "sweep.json").write_text(json.dumps(SETTING | setting))
    for seed, trials in seeds.items():
        result = {"format": 1, "seed": seed, "trials": trials, "machine": {"cpu": cpu}}
        (path / "seeds" / f"{seed:04d}.json").write_text(json.dumps(result))
    return path
