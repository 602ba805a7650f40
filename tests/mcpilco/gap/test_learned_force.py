"""Forces that are learned where no effect explains what is missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import envs
from mcpilco.gap import Gap, investigate
from mcpilco.gap.comparison import error_reduction
from mcpilco.gap.data import Windows, cut, usual_scales
from mcpilco.gap.disturbance import Evidence
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model, on_windows
from mcpilco.gap.learned_force import (
    best_force,
    candidates,
    force_places,
    learned_of,
    with_learned_force,
)
from mcpilco.gap.plant_model import GridForce, PlantModel
from mcpilco.gap.report import summary, to_json
from mcpilco.gap.sensitivities import linearise, residual, run
from mcpilco.gap.thresholds import FORCE
from mcpilco.plant import Axis, Plant, correction_of, read_correction, write_correction
from mcpilco.recordings import Recording
from tests.mcpilco.gap.light import LIGHT, spun
from tests.mcpilco.gap.pendulum import STD, Force, record

pytestmark = pytest.mark.xdist_group("learned force")  # one process learns it for all of them


PLANT = envs.PLANTS["mcpilco/Pendulum-v0"]()


def detent(q: float, v: float) -> float:
    """A magnet that draws the pendulum to 0.4 rad."""
    return -0.3 * (q - 0.4) / 0.1 * float(np.exp(-(((q - 0.4) / 0.1) ** 2)))


def feeding(q: float, v: float) -> float:
    return 0.25 * v / (1.0 + v * v)


def nothing(q: float, v: float) -> float:
    return 0.0


def recordings(force: Force, count: int, seed: int = 1) -> list[Recording]:
    rng = np.random.default_rng(seed)
    return [record(rng, force, number) for number in range(count)]


def nominal_fit(measured: list[Recording], plant: Plant = PLANT) -> tuple[Fit, Windows]:
    windows = cut(measured, np.array([STD, 1.0]))
    model = PlantModel(plant, (), {}, usual_scales(plant, windows))
    x0 = fit_initial_states(model, windows, np.zeros(0))
    return fit_model(model, windows, np.zeros(0), x0), windows


@pytest.mark.slow
def test_a_detent_is_learned_where_it_is_and_the_error_on_unseen_recordings_shrinks() -> None:
    measured = recordings(detent, 13)  # few windows of a recording come by the magnet
    before, windows = nominal_fit(measured[:3])
    short = cut(measured[:3], np.array([STD, 1.0]), seconds=FORCE.short_s)
    after = with_learned_force(before, windows, short)
    (place,) = force_places(after, windows)
    assert [axis.of for axis in place.force.axes] == ["angle"]
    ((low, high),) = place.within
    assert -0.1 < low < 0.4 < high < 0.9
    q = np.linspace(0.2, 0.6, 30)
    np.testing.assert_allclose(place.force.at(q), [detent(x, 0.0) for x in q], atol=0.06)
    unseen = cut(measured[3:], np.array([STD, 1.0]), every=0.3)
    evidence = Evidence(0.0, np.zeros(1), np.ones(2), 1000, np.zeros(2))
    assert error_reduction(before, after, unseen, evidence).low > 0.0


def test_of_noise_nothing_is_learned() -> None:
    measured = recordings(nothing, 2)
    before, windows = nominal_fit(measured)
    short = cut(measured, np.array([STD, 1.0]), seconds=FORCE.short_s)
    assert learned_of(with_learned_force(before, windows, short)) == ()


def found_over_turns(measured: Recording) -> Axis:
    """Of the force that is missing first, in a pendulum that turns over."""
    assert np.ptp(measured.states[:, 0]) > 2.0 * FORCE.most_turned_rad
    before, _ = nominal_fit([measured], LIGHT)
    short = cut([measured], np.array([STD, 1.0]), seconds=FORCE.short_s)
    force = best_force(on_windows(before, short), short)
    assert force is not None
    (axis,) = force.axes
    assert axis.of == "angle"
    return axis


def test_a_spring_that_winds_up_over_turns_is_learned_over_all_of_them() -> None:
    axis = found_over_turns(spun("spring", (0.03,), 20))
    assert not axis.closed
    assert axis.high - axis.low > 2.0 * FORCE.most_turned_rad


def test_what_each_turn_repeats_is_learned_over_one() -> None:
    axis = found_over_turns(spun("position_ripple", (0.03, 0.04, 2.0), 40))
    assert axis.closed
    np.testing.assert_allclose(axis.period, 2.0 * np.pi)


def test_beside_a_velocity_the_place_in_a_turn_and_that_among_all_turns_are_tried() -> None:
    measured = spun("spring", (0.03,), 20)
    before, _ = nominal_fit([measured], LIGHT)
    short = cut([measured], np.array([STD, 1.0]), seconds=FORCE.short_s)
    tried = [candidate.prior.axes for candidate in candidates(on_windows(before, short), short)]
    angles = [axes[0] for axes in tried if [axis.of for axis in axes] == ["angle", "velocity"]]
    assert {axis.closed for axis in angles} == {True, False}
    turned = {round(axis.high - axis.low, 3) for axis in angles if not axis.closed}
    assert min(turned) <= 1.01 * FORCE.most_turned_rad
    assert max(turned) > 2.0 * FORCE.most_turned_rad


@pytest.fixture(scope="module")
def fed() -> Gap:
    return investigate(PLANT, recordings(feeding, 4))


@pytest.mark.slow  # a whole investigation
def test_an_unknown_force_is_learned_and_closes_the_gap_on_held_out_recordings(fed: Gap) -> None:
    assert fed.verdict == "unknown"
    assert {force.joint for force in fed.corrected.learned} == {"pendulum"}
    assert fed.where[0].joint == "pendulum"
    assert fed.comparison is not None
    assert fed.comparison.closed.value > 0.95
    assert fed.comparison.closed.low > 0.5  # of few windows; see `rms_interval`
    assert "learned force (pendulum)" in [step.added for step in fed.comparison.steps]


@pytest.mark.slow  # a whole investigation
def test_the_summary_says_in_which_joint_and_where(fed: Gap) -> None:
    assert any(
        line.startswith("  Missing at pendulum: a force of up to 0.") for line in summary(fed)
    )
    (place, *others) = to_json(fed)["where"]
    assert place["joint"] == "pendulum"
    assert all("joint" not in other for other in others)


@pytest.mark.slow  # a whole investigation
def test_an_env_simulates_what_was_learned(fed: Gap, tmp_path: Path) -> None:
    path = write_correction(tmp_path / "corrected.json", correction_of(fed.corrected, PLANT))
    assert len(read_correction(path).learned) == len(fed.corrected.learned)
    env = gymnasium.make("mcpilco/Pendulum-v0", effects=path)
    env.reset(seed=0)
    env.step(np.array([0.5], dtype=np.float32))
    start, push = np.array([[0.5, 1.0]]), np.zeros((1, 50, 1))
    apart = fed.corrected.simulate(start, push, 0.02) - PLANT.simulate(start, push, 0.02)
    assert np.abs(apart).max() > 0.1


@pytest.mark.slow  # a whole investigation
def test_far_from_what_was_recorded_the_learned_force_is_nothing(fed: Gap) -> None:
    for force in fed.corrected.learned:
        far = [np.array([1e6]) for _ in force.axes]
        assert force.at(*far) == 0.0


def test_columns_of_a_learned_force_are_those_of_finite_differences() -> None:
    before, windows = nominal_fit(recordings(feeding, 1))
    axis = Axis("velocity", -6.0, 6.0, 9)
    force = GridForce("pendulum", (axis,), 0.2 * np.eye(9)[:, 2:7])
    model = replace(before.model, learned=(force,))
    theta = np.array([0.1, -0.3, 0.2, 0.4, 0.1])
    lin = linearise(model, windows, theta, before.x0)
    steps = 1e-3 * np.concatenate([np.eye(5), -np.eye(5)])
    r = residual(windows, run(model, windows, theta + steps, np.tile(before.x0, (10, 1, 1))))
    columns = ((r[5:] - r[:5]) / 2e-3).transpose(1, 2, 0)
    apart = np.linalg.norm(lin.Jp - columns, axis=(0, 1))
    assert (apart < 0.1 * np.linalg.norm(columns, axis=(0, 1))).all()
