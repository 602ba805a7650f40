"""Maps of what a model misses, over time and over the motion."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.gap import Gap
from mcpilco.show.report.gap_maps import missing_force, time_map
from tests.mcpilco.gap.pendulum import DT, dry_friction, record
from tests.mcpilco.gap.pushed import HIDDEN_FRICTION, PUSH_S, pushed


@pytest.mark.parametrize("dt", [DT, pytest.param(0.005, marks=pytest.mark.slow)])
def test_the_force_left_over_is_the_hidden_one_and_nothing_once_it_is_added(
    found: Gap, dt: float
) -> None:
    assert found.models is not None
    assert found.comparison is not None
    plants = found.models.plants()
    friction = dry_friction(HIDDEN_FRICTION)
    recordings = [record(np.random.default_rng(1), friction, number, dt=dt) for number in range(2)]
    for name, size in (("nominal", HIDDEN_FRICTION), ("corrected", 0.0)):
        left = missing_force(*plants[name], recordings, found.comparison.windows.std)
        fast = np.abs(left.v[:, 0]) > 1.0
        along = np.median(left.force[fast, 0] * np.sign(left.v[fast, 0]))
        assert along == pytest.approx(-size, abs=0.015)


def test_the_misfit_is_noise_where_the_correction_holds_and_large_at_a_push(found: Gap) -> None:
    assert found.models is not None
    assert found.comparison is not None
    models = found.models.plants()
    std = found.comparison.windows.std
    recordings = [found.recordings[0], pushed(found.recordings[1])]
    maps = {name: time_map(*models[name], recordings, std) for name in ("nominal", "corrected")}
    edges, (quiet, disturbed) = maps["corrected"].edges, maps["corrected"].misfit[0]
    inside = (edges[:-1] < PUSH_S[1]) & (edges[1:] > PUSH_S[0])
    assert np.all(disturbed[inside] > 5.0)
    assert np.nanmax(quiet) < 2.0
    assert np.nanmedian(maps["nominal"].misfit[0]) > 3.0
    assert np.isnan(maps["nominal"].misfit[1]).all()  # velocities were not measured
