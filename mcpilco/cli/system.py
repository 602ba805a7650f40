"""What several commands need: one thread, an env by its id, the numbers of a preset, a trial."""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcpilco.typing import InputError, RunFolderError

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.agent import TrialAgent
    from mcpilco.logbook import RunFolder
    from mcpilco.task import TaskSpec


def use_one_thread() -> None:
    """Keep torch and BLAS to one thread: the matrices are small, and runs share a machine.

    It also makes results equal to the last digit, wherever the command runs.
    """
    import scipy.linalg  # noqa: F401  loads the BLAS whose threads are limited
    import torch
    from threadpoolctl import threadpool_limits

    torch.set_num_threads(1)
    threadpool_limits(1)


def algorithm(name: str) -> type[TrialAgent]:
    """The class of an algorithm: of this package, of `baselines`, or of another one.

    Args:
        name: as it is registered; of `package:name` the package is imported first.

    Raises:
        InputError: there is none of this name.
    """
    import baselines  # noqa: F401  registers its algorithms
    from mcpilco.agent import find_after_import

    _search_here()
    return find_after_import(name)


def with_package(name: str) -> str:
    """The name of an algorithm as any process can find it: `package:name` where it needs one."""
    package = algorithm(name).__module__.partition(".")[0]
    return name if ":" in name or package == "mcpilco" else f"{package}:{name}"


def _search_here() -> None:
    """Let modules be imported from where the user is, as with `python -m`."""
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)


def algorithm_of(run: RunFolder) -> type[TrialAgent]:
    """The class of the algorithm that a run names, `mcpilco` where it names none.

    Code that lies in the run folder itself is not executed.

    Raises:
        RunFolderError: there is none of this name, or its package lies in the run folder.
    """
    name = run.config.get("algo", "mcpilco")
    _require_outside(run, "algorithm", name)
    try:
        return algorithm(name)
    except InputError as error:
        raise RunFolderError(f"{run.path / 'config.json'} cannot be used: {error}") from error


def numbers(
    kind: type[TrialAgent],
    preset_name: str,
    env_id: str,
    horizon: int | None,
    exploration: int | None = None,
) -> tuple[Any, dict[str, Any]]:
    """The agent's configuration and the env's keywords, of a preset.

    Args:
        kind: the algorithm.
        preset_name: of its presets.
        env_id: of the env.
        horizon: of a rollout [steps]; None: the env's time limit.
        exploration: random inputs at first [steps]; None: one rollout.

    Raises:
        InputError: the algorithm has no such preset, or does not explore beforehand.
    """
    if preset_name not in kind.presets:
        raise InputError(
            f"--preset of the algorithm {kind.algo} must be one of {sorted(kind.presets)}, "
            f"got {preset_name!r}."
        )
    preset = kind.presets[preset_name]
    env_kwargs = preset.keywords(env_id)
    config = preset.config_for(env_id)
    if exploration is not None:
        if not hasattr(config, "exploration"):
            raise InputError(
                f"--exploration is no option of the algorithm {kind.algo}; its presets say how it "
                "begins."
            )
        config = dataclasses.replace(config, exploration=exploration)
    if horizon is None:
        return config, env_kwargs
    config = dataclasses.replace(config, horizon=horizon)
    return config, {**env_kwargs, "max_episode_steps": horizon}


def open_env(env_id: str, kwargs: Mapping[str, Any]) -> gym.Env:
    """The env registered under an id; `module:Id` imports the module first.

    Raises:
        EnvError: no such id or module, or its constructor refuses the keywords.
    """
    import envs  # noqa: F401  registers its ids
    from mcpilco.agent import make_env

    _search_here()
    return make_env(env_id, **kwargs)


def open_run_env(run: RunFolder, kwargs: Mapping[str, Any] | None = None) -> gym.Env:
    """The env that a run was trained in; code that lies in the run folder itself is not executed.

    Args:
        run: names the env.
        kwargs: to make it with; None: those of the training.

    Raises:
        RunFolderError: the env's module lies in the run folder.
        EnvError: the env cannot be made.
    """
    env_id = run.config["env"]
    _require_outside(run, "env", env_id)
    return open_env(env_id, run.config["env_kwargs"] if kwargs is None else kwargs)


def _require_outside(run: RunFolder, kind: str, name: str) -> None:
    """Raises RunFolderError where the module of `module:Name` would be taken from the run folder.

    Args:
        run: names it.
        kind: of what is named, for the message.
        name: as the run has it.
    """
    module = str(name).rpartition(":")[0]
    folder = run.path.resolve()
    for place in {*sys.path, os.getcwd()} if module else ():
        if Path(place or ".", *module.split(".")).resolve().is_relative_to(folder):
            raise RunFolderError(
                f"{run.path} names the {kind} {name!r}, whose module would be taken from the run "
                "folder itself, where nothing is executed; move the module out, if you trust it."
            )


def given_task(path: Path | None) -> TaskSpec | None:
    """The task in the file that the user names, if any; Python in it is executed.

    Raises:
        InputError: the file holds no task.
    """
    from mcpilco.agent import load_task

    return None if path is None else load_task(path)


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


def finished_trial(run: RunFolder, asked: int | None) -> int:
    """The finished trial asked for, or the last.

    Raises:
        RunFolderError: none is finished.
        InputError: the one asked for is not.
    """
    none = f"{run.path} holds no finished trial yet; train until the first one ends."
    return choose_trial(run.finished_trials(), asked, none)


def agent_of(run: RunFolder, trial: int, env: gym.Env | None = None) -> TrialAgent:
    """The run's agent with the policy of one trial, and the estimator that it was learned behind.

    Raises:
        RunFolderError: a file is missing or damaged, or the files do not belong together.
        EnvError: the env does not fit.
    """
    from mcpilco.agent import load_policy

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
