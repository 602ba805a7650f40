"""An agent that learns nothing, and results of trials that never took place."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch

from mcpilco.agent import MCPILCO, horizon_of, input_bounds, run_episode, task_of
from mcpilco.config import PRESETS, Config
from mcpilco.data import Prediction, Rollout, TrialResult
from mcpilco.files import read_arrays, write_arrays
from mcpilco.logbook import as_callback

DT = 0.1
STEPS = 6
PARTICLES = 5


def make_rollout(seed: int = 0, told: bool = True) -> Rollout:
    """Random numbers as an episode; `told`: the env tells the true state and the outcome."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(size=(STEPS + 1, 4))
    outcome = {"is_success": 1.0, "time_up_s": 0.3, "mean_abs_cart_m": 0.25}
    return Rollout(
        dt=DT,
        observations=observations,
        inputs=rng.normal(size=(STEPS, 1)),
        rewards=rng.uniform(size=STEPS),
        states=observations + 0.01 if told else None,
        outcome=outcome if told else {},
    )


def make_prediction(steps: int = STEPS, seed: int = 0) -> Prediction:
    rng = np.random.default_rng(seed)
    return Prediction(
        states=rng.normal(size=(steps + 1, PARTICLES, 4)),
        inputs=rng.normal(size=(steps, PARTICLES, 1)),
        costs=rng.uniform(size=(steps, PARTICLES)),
    )


def make_result(trial: int = 1, rollout: Rollout | None = None, told: bool = True) -> TrialResult:
    rollout = make_rollout(trial, told) if rollout is None else rollout
    return TrialResult(
        trial=trial,
        experience_s=len(rollout) * DT * trial,
        predicted_cost=10.0 / 3 / trial,
        predicted_cost_std=0.5,
        real_cost=float((1 - rollout.rewards).sum()),
        success=bool(rollout.outcome["is_success"]) if "is_success" in rollout.outcome else None,
        noise_std=(0.01, 0.02),
        policy_steps=3,
        starts=1,
        wall_s=1.5,
        cpu_s=1.25,
        rollout=rollout,
        prediction=make_prediction(len(rollout), trial),
    )


class FakeAgent:
    """Calls the callbacks as MCPILCO does, with random inputs in place of a policy."""

    algo, policy_name, config_type, presets = "mcpilco", "SumOfGaussians", Config, PRESETS
    make_model, make_policy = MCPILCO.make_model, MCPILCO.make_policy
    usual_trials = staticmethod(MCPILCO.usual_trials)

    def __init__(self, policy, env, *, preset="default", config=None, seed=0, task=None):
        self.env, self.config, self.seed = env, config, seed
        self.task = task_of(env, task)
        self.low, self.high = input_bounds(env)
        self.horizon = horizon_of(env, None if config is None else config.horizon)
        self.random = np.random.default_rng(seed)
        self.policy = torch.nn.Linear(len(self.task.state_names), 1, dtype=torch.float64)
        torch.nn.init.constant_(self.policy.weight, 0.1 * (seed + 1))
        self.model = SimpleNamespace(to_arrays=lambda: {"noise": np.ones(2)}, memory=0)
        self.perception = None
        self.results = []
        self.transitions = None

    def timesteps_of(self, trials):
        return (trials + 1) * self.horizon

    def learn(self, total_timesteps, callback=None):
        trials = total_timesteps // self.horizon - 1
        events = as_callback(callback)
        events.on_training_start(self, trials)
        events.on_exploration(self._episode(seed=self.seed))
        for trial in range(1, trials + 1):
            events.on_trial_start(trial)
            events.on_model_fitted({"model/noise_std_0": 0.01})
            for step in (1, 2, 3):
                values = {"policy/cost": 5.0 / step, "policy/gradient_norm": float("nan")}
                events.on_policy_step(step, 3, values)
            torch.nn.init.constant_(self.policy.bias, trial)
            self.results.append(make_result(trial, self._episode()))
            events.on_trial_end(self.results[-1])
        events.on_training_end()
        return self

    def _episode(self, seed=None):
        def act(_):
            return self.random.uniform(self.low, self.high)

        return run_episode(self.env, act, self.horizon, self.task.dt, seed=seed)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        with torch.no_grad():
            action = self.policy(torch.as_tensor(observation)).numpy()
        return action, state

    def controller(self):
        return lambda observation: self.predict(observation)[0]

    def save(self, path):
        arrays = {name: value.numpy() for name, value in self.policy.state_dict().items()}
        return write_arrays(Path(path), arrays)

    @classmethod
    def load(cls, path, env):
        agent = cls("SumOfGaussians", env)
        arrays = read_arrays(Path(path))
        agent.policy.load_state_dict({name: torch.from_numpy(a) for name, a in arrays.items()})
        return agent


def play(callback, trials: int = 2, told: bool = True) -> None:
    """Call a callback as a training of `trials` would, without an env."""
    callback.on_training_start(None, trials)
    callback.on_exploration(make_rollout(0, told))
    for trial in range(1, trials + 1):
        callback.on_trial_start(trial)
        callback.on_fit_step(1, 9)
        callback.on_model_fitted({"model/noise_std_0": 0.01})
        for step in (1, 2, 3):
            values = {"policy/cost": 5.0 / step, "policy/gradient_norm": float("nan")}
            callback.on_policy_step(step, 3, values)
        callback.on_trial_end(make_result(trial, told=told))
    callback.on_training_end()
