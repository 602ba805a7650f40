"""Long-term predictions from one random rollout: PILCO's Gaussian and particles of three kernels.

python runs/model_learning/run.py                  # 30 seeds on both cart-poles: minutes
python runs/model_learning/run.py --seeds 0:2      # a first look
python runs/model_learning/run.py --quick          # seconds: does it run at all?

Results are kept in results/<system>/, a file a seed; the same command goes on where it was stopped,
and rewrites the pictures, and README.md between its marked lines, from all results that are there.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import gymnasium as gym
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # its modules, wherever it is run from

from harness import fill, folder, keep, parse_seeds, places
from model_learning import pictures, tables
from model_learning.forecasts import MODELS, Forecast, read_policy
from model_learning.forecasts import forecaster as fitted
from model_learning.measures import Measured, averaged, measure, read_measured, write_measured

import envs  # noqa: F401  registers its ids
from mcpilco.agent import Streams, input_bounds, make_env, run_episode, task_of
from mcpilco.data import Rollout
from mcpilco.logbook import read_json
from mcpilco.sweep import one_thread
from mcpilco.task import TaskSpec

HERE = Path(__file__).parent
SYSTEMS = {
    "cartpole": "mcpilco/CartPoleSwingUp-v0",
    "mujoco": "mcpilco/MujocoCartPoleSwingUp-v0",
}
KINDS = ("random", "swing-up")
"""rollouts that are predicted: of random inputs, of a policy that swings the pole up"""
ROLLOUTS = 5
"""of each kind, for each seed"""


@dataclass(frozen=True)
class Arguments:
    """Fit, predict, and write tables and pictures."""

    seeds: str = "0:30"
    """`0:30` are 0 to 29"""
    systems: tuple[Literal["cartpole", "mujoco"], ...] = ("cartpole", "mujoco")
    """analytic and MuJoCo's"""
    quick: bool = False
    """one seed, one rollout of each kind; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/, pictures and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    seeds, count = parse_seeds(arguments.seeds), ROLLOUTS
    if arguments.quick:
        seeds, count = seeds[:1], 1
    with one_thread():
        for system in arguments.systems:
            with contextlib.closing(Bench(system)) as bench:
                for seed in seeds:
                    path = out / "results" / system / f"{seed:04d}.csv"
                    if not path.exists():
                        write_measured(path, bench.measured(seed, count), bench.task.dt)
                        keep(path.with_suffix(".json"), {"seed": seed}, HERE.name)
                        print(f"{system}, seed {seed}", flush=True)
                pictures.write_example(out / f"{system}-example.png", bench.example(seeds[0]))
        write_readme(out)
    print(f"Tables: {out / 'README.md'}")
    return 0


class Bench:
    """A system, and what is tried on it."""

    def __init__(self, system: str) -> None:
        self.env: gym.Env = make_env(SYSTEMS[system])
        self.task: TaskSpec = task_of(self.env, None, quiet=True)
        self.noise_std = np.array(self.env.unwrapped.swing_up.noise_std)
        self.policy = read_policy(HERE / "policies" / f"{system}.npz", self.env, self.task)
        self.cart = self.task.state_names.index("cart_position")
        self.angle = self.task.state_names.index("pole_angle")
        self._steps = self.env.spec.max_episode_steps

    def close(self) -> None:
        self.env.close()

    def measured(self, seed: int, count: int) -> Mapping[tuple[str, str], Measured]:
        """What each model is worth, on so many rollouts of each kind."""
        models = self._models(seed)
        found = {}
        for kind in KINDS:
            rollouts = [self.rollout(kind, seed, k) for k in range(1, count + 1)]
            for model in MODELS:
                told = [
                    self._measure(self._forecast(models[model], kind, truth, (seed, k)), truth)
                    for k, truth in enumerate(rollouts)
                ]
                found[kind, model] = averaged(told)
        return found

    def example(self, seed: int) -> Sequence[pictures.Example]:
        """The first rollout of each kind, as each model predicts it."""
        models = self._models(seed)
        return [
            pictures.Example(
                kind,
                model,
                truth.times,
                truth.shown_states[:, self.angle],
                self._forecast(models[model], kind, truth, (seed, 0)),
                self.angle,
            )
            for kind in KINDS
            for truth in (self.rollout(kind, seed, 1),)
            for model in MODELS
        ]

    def rollout(self, kind: str, seed: int, number: int) -> Rollout:
        """A rollout on the system; number 0 is what an agent of this seed would learn from."""
        streams = Streams(seed)
        if kind == "random":
            rng, bounds = streams.inputs(trial=number), input_bounds(self.env)
            act = lambda _: rng.uniform(*bounds)  # noqa: E731
        else:
            act = self._answer
        return run_episode(self.env, act, self._steps, self.task.dt, seed=streams.reset(number))

    def _answer(self, seen: np.ndarray) -> np.ndarray:
        import torch

        with torch.no_grad():
            return self.policy(torch.from_numpy(seen)).numpy()

    def _models(self, seed: int) -> Mapping[str, object]:
        data = self.rollout("random", seed, 0).transitions()
        return {name: fitted(name, data, self.task, self.noise_std) for name in MODELS}

    def _forecast(
        self, model: object, kind: str, truth: Rollout, numbers: tuple[int, int]
    ) -> Forecast:
        """Of equal random numbers for all models."""
        policy = None if kind == "random" else self.policy
        return model(truth, policy, np.random.default_rng(numbers))

    def _measure(self, forecast: Forecast, truth: Rollout) -> Measured:
        return measure(forecast, truth, self.noise_std, self.cart, self.angle)


def write_readme(out: Path) -> None:
    """Put pictures and tables of the results that are there into README.md."""
    parts: list[str] = []
    for system, env in SYSTEMS.items():
        paths = sorted((out / "results" / system).glob("*.csv"))
        if not paths:
            continue
        found = tables.gather([read_measured(path) for path in paths])
        pictures.write_errors(out / f"{system}-errors.png", found)
        parts.append(f"### `{env}`, {len(paths)} seed{'s' * (len(paths) > 1)}")
        parts.append(f"![RMSE, coverage and likelihood over the horizon]({system}-errors.png)")
        parts.append(f"![The angle as each model predicts it]({system}-example.png)")
        parts += tables.tables(found, KINDS, MODELS)
    about = [read_json(path) for path in (out / "results").glob("*/*.json")]
    where = places(about) if about else "Machine: not recorded."
    fill(out / "README.md", [*parts, where] if parts else ["Not run yet."], HERE / "README.md")


if __name__ == "__main__":
    sys.exit(main())
