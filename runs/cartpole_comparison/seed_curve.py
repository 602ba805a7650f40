"""One seed of any algorithm, judged after given amounts of experience; it goes on after a stop.

settings = CurveSettings(env, config=config, algo="baselines:sac", trials=2, amounts=(120, 600))
make_job = functools.partial(CurveJob, checkpoints=Path("runs/out/sac/checkpoints"))
sweep(settings, range(5), "runs/out/sac", make_job=make_job)

A sweep judges after each trial. An agent that learns from an hour of experience is better judged
here and there: the result is that of a sweep, with a row for each amount.
"""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from baselines.evaluate import Judge, Judgement, learning_curve
from mcpilco.agent import find, import_named, make_env
from mcpilco.data import is_measure
from mcpilco.logbook import read_json, write_json
from mcpilco.sweep import Settings, one_thread, result_of
from mcpilco.typing import InputError


@dataclass(frozen=True)
class CurveSettings(Settings):
    """The settings that all seeds share; `trials` is the number of amounts."""

    amounts: tuple[int, ...] = ()
    """steps of the env after which the policy is judged, rising"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.trials != len(self.amounts):
            raise InputError(
                f"trials must be the number of amounts, {len(self.amounts)}, got {self.trials}."
            )


@dataclass(frozen=True)
class CurveJob:
    """One seed as a job; called again after a stop, it goes on from the last amount."""

    settings: CurveSettings
    """of the sweep"""
    seed: int
    """of everything random"""
    checkpoints: Path
    """folder for what is known so far: the agent and its rows, in a folder a seed"""

    def __call__(self) -> dict[str, Any]:
        """The result, as `mcpilco.sweep.job.run_seed` has it.

        The first of the fresh episodes counts as the test rollout, the rest as fresh ones.

        Raises:
            McPilcoError: the env or the algorithm does not fit, or misbehaves.
        """
        settings, rows = self.settings, self._rows()
        import_named(settings.env, settings.algo)  # as the user typed them, maybe elsewhere
        with (
            one_thread(),
            contextlib.closing(make_env(settings.env, **settings.env_kwargs)) as env,
            Judge(
                settings.env,
                settings.env_kwargs,
                episodes=settings.fresh + 1,
                horizon=settings.fresh_horizon,
                seed=self.seed,
            ) as judge,
        ):
            agent = self._agent(env, len(rows))
            before = Judgement(0.0, 0.0, {})
            for found in learning_curve(agent, judge, settings.amounts[len(rows) :]):
                rows.append(_row(len(rows) + 1, found, before))
                self._keep(agent, rows)
                before = found
        return result_of(self.seed, rows)

    def forget(self) -> None:
        """Take the checkpoint away, once the result is written."""
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def _folder(self) -> Path:
        return self.checkpoints / f"{self.seed:04d}"

    def _rows(self) -> list[dict[str, Any]]:
        path = self._folder / "rows.json"
        return read_json(path)["rows"] if path.exists() else []

    def _agent(self, env: gym.Env, done: int) -> Any:
        """The agent as it was after so many amounts."""
        kind = find(self.settings.algo)
        if done:
            return kind.load(self._file(done), env)
        return kind(kind.policy_name, env, config=self.settings.config, seed=self.seed)

    def _keep(self, agent: Any, rows: list[dict[str, Any]]) -> None:
        """The agent first: rows without it would be of no use."""
        self._folder.mkdir(parents=True, exist_ok=True)
        agent.save(self._file(len(rows)))
        write_json(self._folder / "rows.json", {"rows": rows})
        self._file(len(rows) - 1).unlink(missing_ok=True)

    def _file(self, done: int) -> Path:
        return self._folder / f"agent-{done}.npz"


def _row(trial: int, found: Judgement, before: Judgement) -> dict[str, Any]:
    """A row of a sweep: the first episode, means of the others, and what the stretch took."""
    test = {name: float(values[0]) for name, values in found.outcomes.items()}
    fresh = {name: float(values[1:].mean()) for name, values in found.outcomes.items()}
    success = test.get("is_success")
    return {
        "trial": trial,
        "experience_s": found.experience_s,
        "success": None if success is None else bool(success),
        "p": fresh.get("is_success"),
        **{name: value for name, value in test.items() if is_measure(name)},
        "predicted_cost": None,
        "real_cost": None,
        "return": test["return"],
        "fresh_return": fresh["return"],
        "starts": 0,
        "policy_steps": 0,
        "cpu_s": round(found.cpu_s - before.cpu_s, 3),
        "wall_s": round(found.wall_s - before.wall_s, 3),
    }
