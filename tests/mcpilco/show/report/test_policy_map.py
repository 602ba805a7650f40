from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mcpilco.agent import MCPILCO
from mcpilco.show.report.policy_map import policy_maps, read_policy
from mcpilco.typing import RunFolderError


def test_policy_read_answers_as_the_saved_agent(history) -> None:
    import envs  # noqa: F401

    agent = MCPILCO.load(history.run.agent_path)
    trial = history.learned[-1]
    policy = read_policy(history, trial)
    import torch

    for state in trial.rollout.observations[:3]:
        action, _ = agent.predict(state)
        with torch.no_grad():
            np.testing.assert_allclose(policy(torch.from_numpy(state[None]))[0], action, rtol=1e-6)


def test_there_is_a_map_for_each_position_with_its_velocity(history) -> None:
    labels = [found.labels for found in policy_maps(history, history.learned[-1])]
    assert labels == [
        ("cart_position [m]", "cart_velocity [m/s]", "force [N]"),
        ("pole_angle [rad]", "pole_velocity [rad/s]", "force [N]"),
    ]


def test_map_holds_what_the_policy_answers_with_the_other_states_at_the_end(history) -> None:
    import torch

    trial = history.learned[-1]
    policy = read_policy(history, trial)
    found = policy_maps(history, trial)[1]
    state = trial.rollout.shown_states[-1].copy()
    state[2], state[3] = found.x[7], found.y[40]
    with torch.no_grad():
        expected = policy(torch.from_numpy(state[None])).item()
    assert found.values[40, 7] == pytest.approx(expected)
    assert (found.low, found.high) == (-10.0, 10.0)
    np.testing.assert_array_equal(found.path, trial.rollout.shown_states[:, 2:])
    for values, path in zip((found.x, found.y), found.path.T, strict=True):
        assert values[0] < path.min()
        assert path.max() < values[-1]


def test_without_velocities_a_map_spans_any_two_states(history) -> None:
    task = dataclasses.replace(history.task, velocities=())
    plain = dataclasses.replace(history, task=task)
    labels = [found.labels[:2] for found in policy_maps(plain, plain.learned[-1])]
    assert len(labels) == 6
    assert ("cart_position [m]", "pole_angle [rad]") in labels


@pytest.mark.parametrize("change", ["lost", "reshaped"])
def test_policy_that_does_not_fit_is_refused(history, change) -> None:
    arrays = history.run.read_arrays(2, "policy")
    arrays.pop("weights")
    if change == "reshaped":
        arrays["weights"] = np.ones((3, 3))
    history.run.write_arrays(2, "policy", arrays)
    with pytest.raises(RunFolderError, match=r"policy.npz is damaged, or of another task"):
        read_policy(history, history.learned[-1])
