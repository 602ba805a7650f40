"""`mcpilco train --warm-start`: the model of an MC-PILCO run, as data for SAC or TQC."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcpilco.cli.system import agent_of, finished_trial
from mcpilco.typing import InputError

_TOLERANCE = 0.05
"""mean difference between rewards and 1 - cost that noise may make [-]"""


def teacher(path: Path, agent: Any) -> Any:
    """The agent of a run, as it was after its last trial, for a new agent of the same system.

    Args:
        path: of the run folder.
        agent: new, of SAC or TQC.

    Raises:
        InputError: the run is of another algorithm or system, or its cost is not that of the
            rewards; or the new agent cannot use it.
        RunFolderError: the run has no finished trial, or cannot be read.
    """
    from baselines.sb3 import SB3Agent
    from baselines.sb3.from_model import check_warm_start
    from mcpilco.logbook import RunFolder

    if not isinstance(agent, SB3Agent):
        raise InputError(f"--warm-start is for sac and tqc, got --algo {agent.algo}.")
    run = RunFolder.open(path)
    if (algo := run.config.get("algo", "mcpilco")) != "mcpilco":
        raise InputError(
            f"--warm-start takes a run of the algorithm mcpilco, got {path} of {algo}."
        )
    trial = finished_trial(run, None)
    source: Any = agent_of(run, trial, agent.env)
    _check_rewards(path, source, run.read_arrays(trial, "rollout"))
    check_warm_start(agent, source)
    return source


def _check_rewards(path: Path, source: Any, rollout: dict[str, Any]) -> None:
    """Raises InputError where the model would be judged by other numbers than the env gives."""
    import numpy as np

    from mcpilco.policies import RewardCost

    if isinstance(source.task.cost, RewardCost) or "costs" not in rollout:
        return
    if np.abs(1.0 - rollout["costs"] - rollout["rewards"]).mean() > _TOLERANCE:
        raise InputError(
            f"The rewards in {path} are not 1 - cost, so what its model would be rewarded with is "
            "not what the env gives; give the task a cost of 1 - reward."
        )
