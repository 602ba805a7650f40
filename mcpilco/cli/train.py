"""`mcpilco train` and `demo`: learn a policy, write a run folder; two trials on the cart-pole."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mcpilco.cli import options
from mcpilco.cli.view import View
from mcpilco.typing import InputError, McPilcoError

if TYPE_CHECKING:
    from mcpilco.logbook import RunFolder


_OUT = "runs/out"


@dataclass(frozen=True, kw_only=True)
class Train(options.Learning, options.OnMachine):
    """Learn a policy from scratch and write a run folder."""

    sim: Annotated[Path | None, options.optional("MODEL.xml", "none")] = None
    """MJCF or URDF file to learn in, in the place of the env; what it is to do says --task, a TOML
    or JSON file of the keywords of mcpilco/Model-v0: its cost by state, dt, start, noise"""
    seed: int = 0
    """of everything random; equal seeds give equal results"""
    trials: Annotated[
        int | None, options.optional("INT", "4, those of the preset, or those of the run resumed")
    ] = None
    """policies to learn, each from one more rollout, after one of first inputs; of sac, tqc and
    ppo each from `trial_steps` more steps"""
    out: Annotated[
        Path | None, options.optional("FOLDER", f"{_OUT}/<env>-<preset>-seed<seed>-<time>")
    ] = None
    """run folder to make"""
    warm_start: Annotated[Path | None, options.optional("RUN", "none")] = None
    """mcpilco, pilco: begin with the policy of this run, such as crossing/corrected, and with its
    numbers, in place of random inputs; sac, tqc: fill the replay buffer from the model of this run
    of mcpilco first, and train on it"""
    quiet: bool = False
    """show no progress"""
    tensorboard: bool = False
    """write event files for TensorBoard into the run folder too"""
    live: bool = False
    """show each rollout and the policy search in the viewer; without a display, for a browser"""
    trust: options.Trust = ()
    """modules of your own that the run of --resume names; they are imported"""
    resume: Annotated[Path | None, options.optional("RUN", "none")] = None
    """go on with this run, which was interrupted or shall have more trials; all else about it is
    in its folder"""

    def __call__(self) -> int:
        if self.sim is not None:
            return self._in_model(self.sim)()
        options.require_at_least(1, trials=self.trials)
        options.require_at_least(0, seed=self.seed)
        options.use_one_thread()
        options.register(self.env, self.algo, trusted=self.trust)
        if self.resume is not None:
            return self._go_on()

        from mcpilco.agent import begin_run, make_env

        (config, env_kwargs), path = self.numbers(), self.folder()
        name, env_kwargs = self.place(self.env, env_kwargs)
        with self.met(path / "machine"), contextlib.closing(make_env(name, **env_kwargs)) as env:
            agent = self.agent(env, config, self.seed)
            source = None
            if self.warm_start is not None:
                source = _source(self.warm_start, agent)
            trials = agent.usual_trials(config) if self.trials is None else self.trials
            files = {"task": self.task, "warm_start": self.warm_start}
            more = {name: str(path) for name, path in files.items() if path is not None}
            numbers = name, env_kwargs, self.chosen_preset, trials
            run = begin_run(path, agent, self.algo, *numbers, more)
            with run.writing():
                if source is not None and not self.quiet:
                    print(f"warm start: from {self.warm_start}", flush=True)
                _warm_start(run, agent, source)
                return self._learn(agent, run)

    def _in_model(self, model: Path) -> Train:
        """The same in the env of a model file, whose keywords are the entries of the task file."""
        from mcpilco.agent import task_entries

        if self.env != Train.env or self.machine is not None or self.resume is not None:
            raise InputError("--sim takes the place of --env, --machine and --resume; give one.")
        if self.task is None or self.task.suffix == ".py":
            raise InputError(
                "--sim needs --task FILE, TOML or JSON with the keywords of mcpilco/Model-v0, such "
                f"as dt and cost, got {self.task}."
            )
        entries = {"model": str(model.resolve()), **task_entries(self.task)}
        given = (f"{name}={json.dumps(value)}" for name, value in entries.items())
        kwargs = (*given, *self.env_kwargs)
        known = self.prior or (None if self.model is None else model)
        env = "mcpilco/Model-v0"
        return replace(self, sim=None, env=env, env_kwargs=kwargs, task=None, prior=known)

    def _go_on(self) -> int:
        from mcpilco.agent import changed_versions, reopened

        beside = ["resume", "task", "trials", "trust", "quiet", "tensorboard", "live"]
        beside += ["machine", "machine_key"]
        usual: dict[str, Any] = {name: getattr(Train, name) for name in beside}
        if dataclasses.replace(self, **usual) != Train():
            raise InputError(
                "--resume takes env, its keywords, algo, preset, seed, horizon and folder from the "
                "run; beside it stand only --task, --trials, --trust, --quiet, --tensorboard, "
                "--live, --machine and --machine-key."
            )
        assert self.resume is not None
        resumed = reopened(self.resume, self.trials, self.task, _warm_start)
        with self.met(self.resume / "machine"), resumed as (run, agent):
            if changed := changed_versions(run):
                options.warn(
                    f"note: {', '.join(changed)} since the run began; its numbers may differ from "
                    "those of an uninterrupted one."
                )
            return self._learn(agent, run)

    def _learn(self, agent: Any, run: RunFolder) -> int:
        """Learn the trials that the run lacks, say where they are, and return the exit code."""
        from mcpilco.agent import learn_rest, rehearsed
        from mcpilco.show import run_callbacks

        try:
            with (
                self._watched(run),
                rehearsed(agent) as waiting,
                run_callbacks(run, not self.quiet, self.tensorboard) as callbacks,
            ):
                learn_rest(run, agent, [*waiting, *callbacks])
        except KeyboardInterrupt as stop:  # by a machine with a sentence that says why
            saved = _saved(run, self.as_typed)
            raise KeyboardInterrupt(" ".join([*stop.args, saved])) from None
        except McPilcoError:
            options.warn(f"stopped; {_saved(run, self.as_typed)}")
            raise
        where = shlex.join(_named(run))
        print(f"Run folder: {run.path}")
        print(f"Look at it: {_command()} view {where}")
        print(f"Report it:  {_command()} report {where}")
        print(f"Judge it:   {_command()} evaluate {where}{self.as_typed}")
        return 0

    @property
    def chosen_preset(self) -> str:
        """That of the run whose policy it begins with, or the one that is given or suits."""
        run = self._begun_with
        return super().chosen_preset if run is None else str(run.config["preset"])

    def numbers(self) -> tuple[Any, dict[str, Any]]:
        """Those of the run whose policy it begins with, or what was given; the env's keywords."""
        from mcpilco.agent import config_of

        config, env_kwargs = super().numbers()
        run = self._begun_with
        return (config if run is None else config_of(run)), env_kwargs

    @property
    def _begun_with(self) -> RunFolder | None:
        """The run whose policy and numbers an agent with a model begins with, where it does."""
        from mcpilco.agent import ModelBasedAgent, find
        from mcpilco.logbook import RunFolder

        if self.warm_start is None or not issubclass(find(self.algo), ModelBasedAgent):
            return None
        own = "preset", "horizon", "exploration", "model", "prior", "spread", "memory", "delay"
        if given := [f"--{name}" for name in (*own, "limit") if getattr(self, name)]:
            raise InputError(
                f"--warm-start takes the numbers of its run; leave out {', '.join(given)}."
            )
        run = RunFolder.open(self.warm_start)
        if (algo := run.config.get("algo", "mcpilco")) != self.algo:
            raise InputError(
                f"--warm-start of {self.algo} takes a run of {self.algo}, got {self.warm_start} of "
                f"{algo}."
            )
        return run

    def folder(self) -> Path:
        """The run folder to make; without `--out` its name tells env, preset, seed and time."""
        if self.out is not None:
            return self.out
        name = re.sub(r"[^\w.-]", "_", re.split(r"[/:]", self.env)[-1])
        time = datetime.now().strftime("%Y%m%d-%H%M%S")
        algo = "" if self.algo == "mcpilco" else f"{self.algo.rpartition(':')[2]}-"
        return Path(_OUT) / f"{name}-{algo}{self.chosen_preset}-seed{self.seed}-{time}"

    @contextlib.contextmanager
    def _watched(self, run: RunFolder) -> Iterator[None]:
        """With `--live`, a `mcpilco view` beside the training, which outlives it until closed."""
        if not self.live:
            yield
            return
        from mcpilco.show import ended_by_signals, has_display

        command = [sys.executable, "-P", "-m", "mcpilco.cli", "view", *_named(run), "--live"]
        command += [] if has_display() else ["--web"]
        # The modules of this process, and none of the folder where the user is.
        paths = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with ended_by_signals(), subprocess.Popen(command, env=paths) as viewer:
            try:
                yield
            except BaseException:
                viewer.send_signal(signal.SIGINT)
                raise
            if viewer.poll() is None:
                print("The training has ended; close the viewer, or press Ctrl-C.", flush=True)
                with contextlib.suppress(KeyboardInterrupt):
                    viewer.wait()


def _source(path: Path, agent: Any) -> Any:
    """The agent of the run that a warm start names, after its last trial."""
    from mcpilco.agent import ModelBasedAgent, agent_of, finished_trial
    from mcpilco.logbook import RunFolder

    if isinstance(agent, ModelBasedAgent):
        run = RunFolder.open(path)
        return agent_of(run, finished_trial(run))
    from baselines.sb3.from_model import stored_source

    return stored_source(path, agent)


def _warm_start(run: RunFolder, agent: Any, source: Any = None) -> None:
    """Begin with what the run has that `--warm-start` named, if any, and save the agent."""
    if "warm_start" in run.config:
        from mcpilco.agent import ModelBasedAgent

        source = source or _source(Path(run.config["warm_start"]), agent)
        if isinstance(agent, ModelBasedAgent):
            agent.begin_with(source)
        else:
            from baselines.sb3.from_model import warm_start

            warm_start(agent, source)
        agent.save(run.agent_path)


def _saved(run: RunFolder, machine: str) -> str:
    trials = run.finished_trials()
    where = shlex.join(_named(run))
    go_on = f"go on with `mcpilco train --resume {where}{machine}`"
    if trials:
        saved = "trial 1 is" if len(trials) == 1 else f"trials 1 to {trials[-1]} are"
        return f"{saved} saved in {run.path}; see `mcpilco view {where}`, or {go_on}."
    if run.agent_path.exists():
        return f"no trial was finished, the exploration is saved in {run.path}; {go_on}."
    return f"nothing was measured yet; {run.path} holds the configuration only; {go_on}."


def _named(run: RunFolder) -> list[str]:
    """The arguments that name a run, with the modules that it needs."""
    names = {run.config.get(key, "").rpartition(":")[0] for key in ("env", "algo")} - {""}
    return [str(run.path), *(["--trust", *sorted(names)] if names else [])]


def _command() -> str:
    """How the user can call this program: by its path, where its name is not on PATH."""
    called = Path(sys.argv[0])
    if shutil.which("mcpilco") or called.name != "mcpilco":
        return "mcpilco"
    return os.path.relpath(called)


_TRIALS = 2


@dataclass(frozen=True, kw_only=True)
class Demo(options.Command):
    """Learn two policies of the cart-pole, and show the last one; takes about a minute."""

    out: Annotated[Path | None, options.optional("FOLDER", "that of `mcpilco train`")] = None
    """run folder to make; the picture goes there too"""
    seed: int = 6
    """of everything random; 6 is one of eleven in 0 to 11 whose second policy swings the pole up"""
    no_view: bool = False
    """do not open the viewer at the end, which opens where there is a display"""

    def __call__(self) -> int:
        train = Train(seed=self.seed, trials=_TRIALS, out=self.out)
        folder = train.folder()
        replace(train, out=folder)()

        from mcpilco.logbook import RunFolder
        from mcpilco.show import has_display

        run = RunFolder.open(folder)
        print(f"Recording:  {run.recording_path(_TRIALS)}")
        with options.without("the picture"):
            print(f"Picture:    {_draw(run)}")
        return View(folder)() if has_display() and not self.no_view else 0


def _draw(run: RunFolder) -> Path:
    """The picture written into the run folder: the cost of each trial, and the last rollout."""
    from mcpilco.logbook import read_history
    from mcpilco.show import plot_input, plot_learning, plot_states
    from mcpilco.show.plots import new_axes, write_picture

    history = read_history(run)
    last, task = history.learned[-1], history.task
    first, *states, force = new_axes(len(task.state_names) + 2)
    plot_learning(history.learned, first)
    plot_states(last.rollout, last.prediction, task, states)
    plot_input(last.rollout, last.prediction, task, 0, force)
    return write_picture(run.path / "demo.png", first)
