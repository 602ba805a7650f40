"""`mcpilco record`: informative data from an env, as log files."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from mcpilco.cli.new_files import make_folder, require_new
from mcpilco.cli.options import optional
from mcpilco.cli.pairs import EnvKeywords, keywords
from mcpilco.cli.system import agent_of, finished_trial, open_env, use_one_thread
from mcpilco.config import CART_POLE
from mcpilco.typing import EnvError, InputError

FEWEST = 10
"""steps of a rollout"""
REMEDY = "name another folder or another seed"
"""where a file is there already"""
KINDS = ("excitation", "random")
"""policies that are no run folder"""


@dataclass(frozen=True)
class Record:
    """Record an env's sensors and inputs: a CSV a rollout, with the columns of its task."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for the files; none in it is overwritten"""
    policy: Annotated[str, tyro.conf.arg(metavar="excitation|random|RUN")] = "excitation"
    """informative inputs, uniformly random ones, or the last policy of a run folder"""
    env: Annotated[str | None, optional("ID", f"the run's, or {CART_POLE}")] = None
    """Gymnasium id of the env; `module:Id` imports the module first"""
    env_kwargs: EnvKeywords = ()
    """keywords of the env; of a JSON file, such as effects=gap/corrected.json, the content"""
    seconds: float = 60.0
    """of data, all rollouts together [s]"""
    rollouts: int = 6
    """files, of equal length; each begins with a reset of the env"""
    dt: Annotated[float | None, optional("FLOAT", "the env's")] = None
    """sampling time [s], for envs with the keyword `dt`"""
    seed: int = 0
    """of everything random; equal seeds give equal files"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        """Record, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        self._check()
        use_one_thread()

        run = None if self.policy in KINDS else _run(self.policy)
        env = self._env(run)
        paths = [self.out / f"{self._stem()}-{k:02d}.csv" for k in range(self.rollouts)]
        done: list[Path] = []
        with contextlib.closing(env):
            recordings = self._recordings(env, run, paths)
            make_folder(self.out, paths, REMEDY)
            try:
                with _progress(len(paths), self.quiet) as tell:
                    for path, recording in recordings:
                        _write(path, recording)
                        done.append(path)
                        tell(path, recording)
            except KeyboardInterrupt:
                print(
                    f"mcpilco: interrupted; {len(done)} of {len(paths)} recordings are saved in "
                    f"{self.out}.",
                    file=sys.stderr,
                )
                return 130
        print(f"Recordings: {shlex.quote(str(self.out))}")
        return 0

    def _check(self) -> None:
        for name in ("seconds", "dt"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"--{name} must be positive [s], got {value}.")
        if self.rollouts < 1:
            raise InputError(f"--rollouts must be at least 1, got {self.rollouts}.")
        if self.seed < 0:
            raise InputError(f"--seed must not be negative, got {self.seed}.")

    def _stem(self) -> str:
        kind = self.policy if self.policy in KINDS else "policy"
        return f"{kind}-seed{self.seed}"

    def _env(self, run: Any) -> Any:
        """The env, without its time limit."""
        if run is not None and self.env in (None, run.config["env"]):
            env_id, kwargs = run.config["env"], dict(run.config["env_kwargs"])
        else:
            env_id, kwargs = self.env or CART_POLE, {}
        kwargs |= keywords("--env-kwargs", self.env_kwargs)
        if self.dt is not None:
            kwargs["dt"] = self.dt
        return open_env(env_id, {**kwargs, "max_episode_steps": -1})

    def _recordings(self, env: Any, run: Any, paths: list[Path]) -> Iterator[tuple[Path, Any]]:
        """Each file's path and recording, one rollout after the other.

        Raises:
            McPilcoError: the env, the run and the options do not fit; before the first rollout.
        """
        from mcpilco.agent import input_bounds, task_of

        agent = None if run is None else agent_of(run, finished_trial(run, None))
        shown = getattr(env.unwrapped, "task", None)
        task = task_of(env, agent.task if agent is not None and shown is None else None)
        low, high = input_bounds(env)
        steps = round(self.seconds / self.rollouts / task.dt)
        if steps < FEWEST:
            raise InputError(
                f"--seconds must leave each rollout at least {FEWEST} steps of {task.dt:g} s, got "
                f"{self.seconds:g} s for {self.rollouts} of them; record for longer."
            )
        act = _actor(self.policy, run, agent, task, low, high, steps)
        return self._rollouts(env, task, act, steps, paths)

    def _rollouts(
        self, env: Any, task: Any, act: Any, steps: int, paths: list[Path]
    ) -> Iterator[tuple[Path, Any]]:
        import numpy as np

        from mcpilco.agent import run_episode
        from mcpilco.recordings import from_rollout
        from mcpilco.sensing import state_view

        view, seeds = state_view(env, task), np.random.SeedSequence(self.seed).spawn(len(paths))
        for path, seed in zip(paths, seeds, strict=True):
            rng = np.random.default_rng(seed)
            reset_seed = int(rng.integers(2**31))
            rollout = run_episode(view, act(rng), steps, task.dt, seed=reset_seed)
            yield path, from_rollout(path.stem, rollout, task)


def _run(policy: str) -> Any:
    from mcpilco.logbook import RunFolder

    if not Path(policy).is_dir():
        raise InputError(
            f"--policy expected {' or '.join(KINDS)} or a run folder, got {policy!r}; name the "
            "folder that `mcpilco train` printed."
        )
    return RunFolder.open(policy)


def _actor(policy: str, run: Any, agent: Any, task: Any, low: Any, high: Any, steps: int) -> Any:
    """From random numbers to a policy for one rollout."""
    import numpy as np

    from mcpilco.recordings import excitation

    def excite(rng: np.random.Generator) -> Callable[[Any], Any]:
        script = iter(excitation(low, high, steps, task.dt, rng))
        return lambda observation: next(script)

    def draw(rng: np.random.Generator) -> Callable[[Any], Any]:
        return lambda observation: rng.uniform(low, high)

    if agent is None:
        return excite if policy == "excitation" else draw
    if (agent.task.state_names, agent.task.input_names) != (task.state_names, task.input_names):
        raise EnvError(
            f"The policy in {run.path} expected the states {', '.join(agent.task.state_names)} and "
            f"the inputs {', '.join(agent.task.input_names)}, got an env with "
            f"{', '.join(task.state_names)} and {', '.join(task.input_names)}; leave --env out."
        )
    return lambda rng: agent.on_states()


def _write(path: Path, recording: Any) -> None:
    from mcpilco.recordings import write_recording

    require_new(path, REMEDY)
    write_recording(path, recording)


@contextlib.contextmanager
def _progress(count: int, quiet: bool) -> Iterator[Callable[[Path, Any], None]]:
    """What is told of each recording; draws a line for each, above a bar on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(quiet=quiet)
    columns = (TextColumn("recordings"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task("recordings", total=count)

        def tell(path: Path, recording: Any) -> None:
            line = f"{path}: {recording.time[-1]:.2f} s, {len(recording)} samples"
            bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            bar.advance(task)

        yield tell
