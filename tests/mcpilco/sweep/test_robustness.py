"""The map of success is that of the env with one number of its plant changed."""

from __future__ import annotations

import numpy as np
import pytest

from envs.plants import pendulum
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.sweep.robustness import FACTORS, directions

ENV, STEPS, LIMIT = "mcpilco/Pendulum-v0", 40, {"torque_limit": 6.0}


def held_up(observations):
    """Enough torque to lift the pendulum at once, and to hold it."""
    angle, velocity = observations[..., 0:1], observations[..., 1:2]
    return 8.0 * (np.pi - angle) - 1.5 * velocity


@pytest.mark.slow
def test_success_falls_where_a_number_matters_and_nowhere_else():
    stiff = pendulum().having([(EffectInstance(CATALOGUE["spring"], "pendulum"), (0.05,))])
    found = directions(stiff, ENV, LIMIT, lambda: held_up, STEPS, seed=0, episodes=4)
    by_name = {one.name: one for one in found}
    assert set(by_name) == {"mass", "length", "friction", "torque_gain", "spring.pendulum.k"}
    assert by_name["spring.pendulum.k"].value == 0.05
    own = FACTORS.index(1.0)
    assert {one.success[own] for one in found} == {1.0}
    assert set(by_name["friction"].success) == {1.0}
    heavy = directions(stiff.where(mass=1.9), ENV, LIMIT, lambda: held_up, STEPS, 0, episodes=4)
    lengths = next(one.success for one in heavy if one.name == "length")
    assert lengths[0] > lengths[-1]


def test_there_is_no_map_where_success_is_not_told(monkeypatch):
    outcomes = "mcpilco.sweep.job.FreshEpisodes.outcomes"
    monkeypatch.setattr(outcomes, lambda self, begin, seed, trial: {"return": np.zeros(1)})
    assert directions(pendulum(), ENV, {}, lambda: held_up, STEPS, 0) == []
