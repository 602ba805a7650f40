"""`mcpilco train`: learn a policy and write a run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from mcpilco.cli.options import TaskPath, optional
from mcpilco.cli.system import given_task, numbers, open_env, use_one_thread
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError

_OUT = "runs/out"


@dataclass(frozen=True)
class Train:
    """Learn a policy from scratch and write a run folder."""

    env: str = CART_POLE
    """Gymnasium id of the env; `module:Id` imports the module first"""
    preset: Literal["default", "thesis", "tro2022"] = "default"
    """setting of the agent, and of the cart-pole"""
    seed: int = 0
    """of everything random; equal seeds give equal results"""
    trials: int = 4
    """policies to learn, each from one more rollout; a rollout of random inputs comes first"""
    out: Annotated[Path | None, optional("FOLDER", f"{_OUT}/<env>-<preset>-seed<seed>-<time>")] = (
        None
    )
    """run folder to make"""
    horizon: Annotated[int | None, optional("INT", "the env's time limit")] = None
    """steps of a rollout"""
    task: TaskPath = None
    """what to know of the env, where it does not show it"""
    exploration: Annotated[int | None, optional("INT", "one rollout")] = None
    """steps of random inputs at first; several rollouts, where they end early"""
    quiet: bool = False
    """show no progress"""
    tensorboard: bool = False
    """write event files for TensorBoard into the run folder too"""

    def __call__(self) -> int:
        """Train, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        if self.trials < 1:
            raise InputError(f"--trials must be at least 1, got {self.trials}.")
        if self.seed < 0:
            raise InputError(f"--seed must not be negative, got {self.seed}.")
        use_one_thread()

        from mcpilco.agent import MCPILCO
        from mcpilco.run_folder import RunFolder

        config, env_kwargs = numbers(self.preset, self.env, self.horizon, self.exploration)
        env = open_env(self.env, env_kwargs)
        with contextlib.closing(env):
            task = given_task(self.task)
            agent = MCPILCO("SumOfGaussians", env, config=config, seed=self.seed, task=task)
            run = RunFolder.create(self._folder(), self._record(config, env_kwargs))
            try:
                with self._callbacks(run) as callbacks:
                    agent.learn(agent.timesteps_of(self.trials), callback=callbacks)
            except KeyboardInterrupt:
                print(f"mcpilco: interrupted; {_saved(run)}", file=sys.stderr)
                return 130
        where = shlex.quote(str(run.path))
        print(f"Run folder: {run.path}")
        print(f"Look at it: {_command()} view {where}")
        print(f"Judge it:   {_command()} evaluate {where}")
        return 0

    def _folder(self) -> Path:
        if self.out is not None:
            return self.out
        name = re.sub(r"[^\w.-]", "_", re.split(r"[/:]", self.env)[-1])
        time = datetime.now().strftime("%Y%m%d-%H%M%S")
        return Path(_OUT) / f"{name}-{self.preset}-seed{self.seed}-{time}"

    def _record(self, config: Any, env_kwargs: dict[str, Any]) -> dict[str, Any]:
        """What config.json holds."""
        return {
            "env": self.env,
            "env_kwargs": env_kwargs,
            "preset": self.preset,
            "seed": self.seed,
            "trials": self.trials,
            "config": dataclasses.asdict(config),
        }

    @contextlib.contextmanager
    def _callbacks(self, run: Any) -> Iterator[list[Any]]:
        """What listens to the training; terminal and files are given back whatever happens."""
        from mcpilco.callbacks import JsonLines, Progress, TensorBoard
        from mcpilco.recorder import Recorder

        callbacks = [JsonLines(run.policy_steps_path), Recorder(run)]
        if self.tensorboard:
            callbacks.append(TensorBoard(run.path / "tensorboard"))
        if not self.quiet:
            callbacks.append(Progress())
        with contextlib.ExitStack() as stack:
            for callback in callbacks:
                stack.callback(callback.close)
            yield callbacks


def _saved(run: Any) -> str:
    """A sentence on what an interrupted run holds."""
    trials = run.finished_trials()
    where = shlex.quote(str(run.path))
    if trials:
        saved = "trial 1 is" if len(trials) == 1 else f"trials 1 to {trials[-1]} are"
        return f"{saved} saved in {run.path}; see `mcpilco view {where}`."
    if run.recording_path(0).exists():
        return f"no trial was finished, the exploration is saved in {run.path}."
    return f"nothing was measured yet; {run.path} holds the configuration only."


def _command() -> str:
    """How the user can call this program: by its path, where its name is not on PATH."""
    called = Path(sys.argv[0])
    if shutil.which("mcpilco") or called.name != "mcpilco":
        return "mcpilco"
    return os.path.relpath(called)
