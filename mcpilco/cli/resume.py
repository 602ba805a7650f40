"""What `mcpilco train --resume` goes on with: a run folder, its env, and the agent as it was."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcpilco.cli.system import algorithm_of, given_task, open_run_env
from mcpilco.typing import InputError, RunFolderError


@contextlib.contextmanager
def reopened(path: Path, trials: int | None, task: Path | None = None) -> Iterator[tuple[Any, Any]]:
    """The run folder, as it was at the end of its last finished trial, and the agent of that time.

    Args:
        path: of the run folder.
        trials: policies that the run shall have in the end; None: as many as it was begun with.
        task: the file that it was begun with, if any; the run names it, and nothing that a run
            names is executed.

    Raises:
        RunFolderError: the run cannot be read, or has ended.
        InputError: it has more trials already, or was begun with a task's file.
        EnvError: its env cannot be made.
    """
    from mcpilco.logbook import READABLE, RunFolder

    run = RunFolder.open(path)
    if run.config["format"] != READABLE[-1]:
        raise RunFolderError(
            f"{path} was recorded by an older mcpilco, which drew other random numbers, so it "
            "cannot be resumed; it can be viewed, evaluated and exported. Train anew instead."
        )
    if task is None and "task" in run.config:
        raise InputError(
            f"{path} was begun with --task {run.config['task']}; pass that file again, for none "
            "that a run folder names is executed."
        )
    with run.writing(), contextlib.closing(open_run_env(run)) as env:
        agent = _agent(run, env, given_task(task))
        planned = run.config["trials"] if trials is None else trials
        if planned < agent.trials or (planned == agent.trials and run.summary() is not None):
            raise InputError(
                f"{path} has {agent.trials} finished trials; for more of them pass a larger "
                f"number than that, such as --trials {agent.trials + 4}."
            )
        _warn_of_versions(run)
        run.rewind(agent.trials if agent.num_timesteps else None)
        if planned != run.config["trials"]:
            run = run.with_trials(planned)
        yield run, agent


def _agent(run: Any, env: Any, task: Any) -> Any:
    """The agent after the last finished trial; a new one where nothing was measured yet."""
    from mcpilco.config import from_dict

    kind = algorithm_of(run)
    try:
        config, seed = from_dict(kind.config_type, run.config["config"]), run.config["seed"]
    except InputError as error:
        raise RunFolderError(f"{run.path / 'config.json'} is damaged: {error}") from error
    if not run.agent_path.exists():
        agent = kind(kind.policy_name, env, config=config, seed=seed, task=task)
        _warm_again(run, agent)
        return agent
    agent = kind.load(run.agent_path, env, task=task)
    if (agent.config, agent.seed) != (config, seed):
        raise RunFolderError(
            f"{run.agent_path} is of another run than config.json beside it: their numbers or "
            "seeds differ; restore it from a copy."
        )
    return agent


def _warm_again(run: Any, agent: Any) -> None:
    """What `--warm-start` had not finished when the run was stopped."""
    if "warm_start" in run.config:
        from baselines.sb3.from_model import warm_start
        from mcpilco.cli.warm_start import teacher

        warm_start(agent, teacher(Path(run.config["warm_start"]), agent))
        agent.save(run.agent_path)


def _warn_of_versions(run: Any) -> None:
    from mcpilco.logbook import versions

    now, then = versions(), run.config["versions"]
    changed = [
        f"{name} {then.get(name)} -> {now[name]}" for name in now if now[name] != then.get(name)
    ]
    if changed:
        print(
            f"mcpilco: note: {', '.join(changed)} since the run began; its numbers may differ from "
            "those of an uninterrupted one.",
            file=sys.stderr,
        )
