"""`mcpilco record`: informative data from an env, as log files."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli import options
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.logbook import RunFolder

REMEDY = "name another folder or another seed"
"""where a file is there already"""
KINDS = ("excitation", "random")
"""policies that are no run folder"""
MOST_FILES = 100_000
"""of rollouts, in one folder"""


@dataclass(frozen=True)
class Record(options.OnMachine):
    """Record an env's sensors and inputs: a CSV a rollout, with the columns of its task."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for the files; none in it is overwritten"""
    policy: Annotated[str, tyro.conf.arg(metavar="excitation|random|RUN")] = "excitation"
    """informative inputs, uniformly random ones, or the last policy of a run folder"""
    env: Annotated[str | None, options.optional("ID", f"the run's, or {CART_POLE}")] = None
    """Gymnasium id of the env; `module:Id` imports the module first"""
    env_kwargs: options.EnvKeywords = ()
    """keywords of the env; of a JSON file, such as effects=gap/corrected.json, the content"""
    seconds: float = 60.0
    """of data, all rollouts together [s]"""
    rollouts: int = 6
    """files, of equal length; each begins with a reset of the env"""
    dt: Annotated[float | None, options.optional("FLOAT", "the env's")] = None
    """sampling time [s], for envs with the keyword `dt`"""
    seed: int = 0
    """of everything random; equal seeds give equal files"""
    trust: options.Trust = ()
    """modules of your own that the run of --policy names; they are imported"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        self._check()
        options.use_one_thread()
        options.register(self.env or "", trusted=self.trust)

        from mcpilco.agent import agent_of, finished_trial
        from mcpilco.crossing import record_rollouts
        from mcpilco.files import make_folder
        from mcpilco.logbook import counting
        from mcpilco.recordings import write_recording

        run = None if self.policy in KINDS else _run(self.policy)
        kind = "policy" if run is not None else self.policy
        paths = [self.out / f"{kind}-seed{self.seed}-{k:02d}.csv" for k in range(self.rollouts)]
        done = 0
        with self.met(self.out / "machine"), contextlib.closing(self._env(run)) as env:
            policy: Any = self.policy if run is None else agent_of(run, finished_trial(run))
            names = [path.stem for path in paths]
            recordings = record_rollouts(env, policy, self.seconds, names, self.seed)
            make_folder(self.out, *(path.name for path in paths))
            options.require_new(*paths, remedy=REMEDY)
            try:
                with counting("recordings", len(paths), quiet=self.quiet) as show:
                    for path, recording in zip(paths, recordings, strict=True):
                        options.require_new(path, remedy=REMEDY)
                        write_recording(path, recording)
                        done += 1
                        show(f"{path}: {recording.time[-1]:.2f} s, {len(recording)} samples")
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"{done} of {len(paths)} recordings are saved in {self.out}."
                ) from None
        print(f"Recordings: {shlex.quote(str(self.out))}")
        return 0

    def _check(self) -> None:
        for name in ("seconds", "dt"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InputError(f"--{name} must be positive [s], got {value}.")
        options.require_at_least(1, rollouts=self.rollouts)
        if self.rollouts > MOST_FILES:
            raise InputError(f"--rollouts must be at most {MOST_FILES}, got {self.rollouts}.")
        options.require_at_least(0, seed=self.seed)

    def _env(self, run: RunFolder | None) -> gym.Env:
        """The env, without its time limit; that of the run where no other is named."""
        from mcpilco.agent import make_env

        kwargs = options.keywords("--env-kwargs", self.env_kwargs)
        if self.dt is not None:
            kwargs["dt"] = self.dt
        kwargs["max_episode_steps"] = -1
        if run is not None and self.env in (None, run.config["env"]):
            env, kwargs = run.config["env"], {**run.config["env_kwargs"], **kwargs}
        else:
            env = self.env or CART_POLE
        env, kwargs = self.place(env, kwargs)
        return make_env(env, **kwargs)


def _run(policy: str) -> RunFolder:
    from mcpilco.logbook import RunFolder

    if not Path(policy).is_dir():
        raise InputError(
            f"--policy expected {' or '.join(KINDS)} or a run folder, got {policy!r}; name the "
            "folder that `mcpilco train` printed."
        )
    return RunFolder.open(policy)
