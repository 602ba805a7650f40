"""Agents and envs from run folders: to judge a policy, or to go on with an interrupted training.

Nothing that lies in a run folder is executed, and no module is imported because a folder names it.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcpilco.agent.agent_file import load_policy
from mcpilco.agent.algorithms import find
from mcpilco.agent.contract import make_env
from mcpilco.agent.task_file import load_task
from mcpilco.config import from_dict
from mcpilco.logbook import READABLE, RunFolder, as_callback, versions
from mcpilco.typing import InputError, RunFolderError

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.agent.trial_agent import TrialAgent
    from mcpilco.logbook import Callback
    from mcpilco.task import TaskSpec

Prepare = Callable[[RunFolder, Any], None]
"""brings a new agent to where its run began, such as by a warm start"""


def open_run_env(run: RunFolder, kwargs: Mapping[str, Any] | None = None) -> gym.Env:
    """The env that a run was trained in, whose module must have been imported.

    It is made with `kwargs`, by default those of the training.

    Raises:
        EnvError: the env cannot be made.
    """
    return make_env(run.config["env"], **(run.config["env_kwargs"] if kwargs is None else kwargs))


def algorithm_of(run: RunFolder) -> type[TrialAgent]:
    """The class of the algorithm that a run names, `mcpilco` where it names none.

    Raises:
        RunFolderError: none of this name is registered, as its package has not been imported.
    """
    try:
        return find(str(run.config.get("algo", "mcpilco")))
    except InputError as error:
        raise RunFolderError(f"{run.path / 'config.json'} cannot be used: {error}") from error


def config_of(run: RunFolder) -> Any:
    """The numbers that a run's agent was made with.

    Raises:
        RunFolderError: they are none of its algorithm.
    """
    try:
        return from_dict(algorithm_of(run).config_type, run.config["config"])
    except InputError as error:
        raise RunFolderError(f"{run.path / 'config.json'} is damaged: {error}") from error


def choose_trial(trials: Sequence[int], asked: int | None, none: str) -> int:
    """The trial asked for, or the last of those that there are.

    Raises:
        RunFolderError: there are none; `none` is the sentence that says so.
        InputError: the one asked for is not among them.
    """
    if not trials:
        raise RunFolderError(none)
    if asked is None:
        return trials[-1]
    if asked not in trials:
        raise InputError(f"--trial must be one of {', '.join(map(str, trials))}, got {asked}.")
    return asked


def finished_trial(run: RunFolder, asked: int | None = None) -> int:
    """The finished trial asked for, or the last.

    Raises:
        RunFolderError: none is finished.
        InputError: the one asked for is not.
    """
    none = f"{run.path} holds no finished trial yet; train until the first one ends."
    return choose_trial(run.finished_trials(), asked, none)


def agent_of(run: RunFolder, trial: int, env: gym.Env | None = None) -> TrialAgent:
    """The run's agent with the policy of one trial, and the state estimator of that policy.

    Raises:
        RunFolderError: a file is missing or damaged, or the files do not belong together.
        EnvError: the env does not fit.
    """
    agent = algorithm_of(run).load(run.agent_path, env)
    name = "policy"
    try:
        load_policy(agent.policy, run.read_arrays(trial, name))
        if agent.perception is not None:
            name = "perception"
            agent.perception.load_arrays(run.read_arrays(trial, name))
    except ValueError as error:
        path = run.arrays_path(trial, name)
        raise RunFolderError(f"{path} is not a {name} of this agent: {error}") from error
    return agent


# Trainings ----------------------------------------------------------------------------------------


def begin_run(
    path: Path,
    agent: TrialAgent,
    algo: str,
    env: str,
    env_kwargs: Mapping[str, Any],
    preset: str,
    trials: int,
    more: Mapping[str, Any] | None = None,
) -> RunFolder:
    """A new run folder, whose `config.json` says all that the training is begun with.

    The `agent` has learned nothing yet; `algo` is the name by which its class is found.

    Raises:
        RunFolderError: the folder is there already, or cannot be written.
    """
    return RunFolder.create(
        path,
        {
            "env": env,
            "env_kwargs": env_kwargs,
            "algo": algo,
            "preset": preset,
            "seed": agent.seed,
            "config": dataclasses.asdict(agent.config),
            **(more or {}),
            "trials": trials,
        },
    )


@contextlib.contextmanager
def reopened(
    path: Path,
    trials: int | None = None,
    task_file: Path | None = None,
    prepare: Prepare | None = None,
) -> Iterator[tuple[RunFolder, TrialAgent]]:
    """A run folder as it was at the end of its last finished trial, and the agent of that time.

    It shall have `trials` policies in the end, by default as many as it was begun with. The task
    file that it was begun with is given again: the run folder names one too, but nothing that a run
    folder names is executed. `prepare` is called where nothing was measured yet, with the run and a
    new agent.

    Raises:
        RunFolderError: the run cannot be read, or has ended.
        InputError: it has more trials already, or was begun with a task's file.
        EnvError: its env cannot be made.
    """
    run = RunFolder.open(path)
    if run.config["format"] != READABLE[-1]:
        raise RunFolderError(
            f"{path} was recorded by an older mcpilco, which drew other random numbers, so it "
            "cannot be resumed; it can be viewed, evaluated and exported. Train anew instead."
        )
    if task_file is None and "task" in run.config:
        raise InputError(
            f"{path} was begun with --task {run.config['task']}; pass that file again, for none "
            "that a run folder names is executed."
        )
    with run.writing(), contextlib.closing(open_run_env(run)) as env:
        task = None if task_file is None else load_task(task_file)
        agent = _restored(run, env, task, prepare)
        planned = run.config["trials"] if trials is None else trials
        if planned < agent.trials or (planned == agent.trials and run.summary() is not None):
            raise InputError(
                f"{path} has {agent.trials} finished trials; for more of them pass a larger "
                f"number than that, such as --trials {agent.trials + 4}."
            )
        run.rewind(agent.trials if agent.num_timesteps else None)
        if planned != run.config["trials"]:
            run = run.with_trials(planned)
        yield run, agent


def learn_rest(run: RunFolder, agent: TrialAgent, callbacks: Sequence[Callback]) -> None:
    """Learn the trials that a run was planned with and does not have yet.

    Raises:
        McPilcoError: the env misbehaves, or a file cannot be written.
    """
    if rest := run.config["trials"] - len(run.finished_trials()):
        agent.learn(agent.timesteps_of(rest), callback=callbacks)
    else:  # it was stopped after its last trial, before its summary was written
        as_callback(callbacks).on_training_start(agent, 0)
        as_callback(callbacks).on_training_end()


def changed_versions(run: RunFolder) -> list[str]:
    """Packages whose versions are other than when the run began: `name then -> now`."""
    now, then = versions(), run.config["versions"]
    return [
        f"{name} {then.get(name)} -> {now[name]}" for name in now if now[name] != then.get(name)
    ]


def _restored(
    run: RunFolder, env: gym.Env, task: TaskSpec | None, prepare: Prepare | None
) -> TrialAgent:
    """The agent after the last finished trial; a new one where nothing was measured yet."""
    kind, config, seed = algorithm_of(run), config_of(run), run.config["seed"]
    if not run.agent_path.exists():
        agent = kind(kind.policy_name, env, config=config, seed=seed, task=task)
        if prepare is not None:
            prepare(run, agent)
        return agent
    agent = kind.load(run.agent_path, env, task=task)
    if (agent.config, agent.seed) != (config, seed):
        raise RunFolderError(
            f"{run.agent_path} is of another run than config.json beside it: their numbers or "
            "seeds differ; restore it from a copy."
        )
    return agent
