"""From an episode on an env to a recording."""

from __future__ import annotations

import numpy as np

from mcpilco.data import Rollout
from mcpilco.recordings.recording import Recording
from mcpilco.task import TaskSpec


def from_rollout(name: str, rollout: Rollout, task: TaskSpec) -> Recording:
    """What the sensors and the controller logged in an episode of T steps: T + 1 samples.

    Angles count turns. The last sample repeats the last input. A state that is not measured is NaN.
    """
    states = np.full((len(rollout.observations), len(task.state_names)), np.nan)
    states[:, list(task.measured_states)] = rollout.observations
    angles = list(task.angles)
    states[:, angles] = np.unwrap(states[:, angles], axis=0)
    return Recording(
        name=name,
        time=rollout.times,
        states=states,
        inputs=np.concatenate([rollout.inputs, rollout.inputs[-1:]]),
        state_names=task.state_names,
        input_names=task.input_names,
        angles=task.angles,
        velocities=task.velocities,
    )
