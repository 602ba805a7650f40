"""A plant with effects as a function of a vector of parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem
from mcpilco.gap.plant_model import PlantModel
from mcpilco.gap.thresholds import FIT
from mcpilco.plant import (
    CATALOGUE,
    EffectInstance,
    correction_of,
    read_correction,
    write_correction,
)
from tests.mcpilco.gap.lagging import recorded

FREE = "mass", "length"


def model(**parameters: float) -> PlantModel:
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]().where(**parameters)
    problem = GapProblem.of(plant, recorded(plant, 1), 0.01, FREE, {})
    return problem.model(problem.windows())


def test_no_step_changes_a_mass_or_a_logarithm_by_more_than_its_factor() -> None:
    friction = EffectInstance(CATALOGUE["stribeck_friction"], "pendulum")
    grown, theta = model().grown(np.array([1.0, -0.5, 0.0, 0.0]), friction, (0.1, 0.1, 0.1, 2e-3))
    low, high = grown.reach(theta)
    own = slice(grown.nuisances)
    np.testing.assert_allclose(1.0 + high[own], FIT.farthest * (1.0 + theta[own]))
    np.testing.assert_allclose((1.0 + low[own]) * FIT.farthest, 1.0 + theta[own])
    logs = grown.logarithmic
    assert logs.sum() == 2
    assert np.exp((high - low)[logs]).max() <= FIT.farthest**2 * (1 + 1e-9)


def test_of_a_free_mass_the_order_of_magnitude_is_known() -> None:
    found = model()
    loose = dict(zip(found.priors, found.precision, strict=True))
    assert loose["mass"] == loose["length"] == FIT.free_std**-2
    assert loose["friction"] == pytest.approx(0.01**-2)


def test_what_is_free_and_what_effects_are_have_no_nominal_value() -> None:
    spring = EffectInstance(CATALOGUE["spring"], "pendulum")
    grown, theta = model().grown(np.array([0.2, 0.3, 0.4, 0.5]), spring, (0.1,))
    held = [name not in FREE for name in grown.priors]
    assert sum(held) == 2
    nominal = grown.nominal(theta)
    np.testing.assert_array_equal(nominal[:4], np.where(held, 0.0, theta[:4]))
    assert nominal[4:].tolist() == [0.1]


def test_an_effect_is_enlarged_by_what_it_changes_and_not_in_its_shape() -> None:
    friction = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
    gain = EffectInstance(CATALOGUE["actuator_gain"], "actuator")
    inertia = EffectInstance(CATALOGUE["armature"], "pendulum")
    grown = model()
    theta = np.where([name == "torque_gain" for name in grown.priors], -0.2, 0.0)
    sizes = {friction: (0.1, 2e-3), gain: (0.8,), inertia: (0.02,)}
    for instance, values in sizes.items():
        grown, theta = grown.grown(theta, instance, values)
    expected = {friction: (0.2, 2e-3), gain: (0.6,), inertia: (0.04,)}
    for instance in sizes:
        values = dict(grown.effect_values(grown.scaled(theta, instance, 2.0)[None]))
        for each in sizes:
            wanted = (expected if each == instance else sizes)[each]
            np.testing.assert_allclose(values[each][0], wanted, rtol=1e-9)


def test_a_correction_at_the_bounds_of_its_values_can_be_read_again(tmp_path: Path) -> None:
    nominal = model()
    nobody = np.zeros(nominal.nuisances)
    for active in nominal.plant.candidates():
        for values in zip(*((s.low, s.high) for s in active.effect.symbols), strict=True):
            grown, theta = nominal.grown(nobody, active, np.clip(values, -1e3, 1e3))
            plant = nominal.plant.having(
                [(a, told[0]) for a, told in grown.effect_values(theta[None])]
            )
            path = write_correction(tmp_path / "at.json", correction_of(plant, nominal.plant))
            assert read_correction(path).effects


def test_only_friction_that_is_far_too_large_turns_over_more_slowly() -> None:
    friction = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
    nominal = model()
    for size, softer in ((0.2, False), (20.0, True)):
        grown, theta = nominal.grown(np.zeros(nominal.nuisances), friction, (size, 1e-2))
        width = float(np.exp(theta[-1]))
        assert (width > 1e-2 * (1 + 1e-9)) == softer
        rest = width * nominal.scales["pendulum"].inertia / size
        assert rest >= 1e-4 * (1 - 1e-9)
        np.testing.assert_array_equal(grown.softened(theta), theta)


@pytest.mark.parametrize("size", [0.02, 0.2, 2.0])
def test_friction_turns_over_as_slowly_as_none_could_tell_from_a_quicker_one(size: float) -> None:
    """Its joint comes to rest in a millisecond, where that is a small part of its usual speed."""
    friction = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
    nominal = model()
    scale = nominal.scales["pendulum"]
    theta = nominal.grown(np.zeros(nominal.nuisances), friction, (size, 1e-9))[1]
    width, millisecond = float(np.exp(theta[-1])), size / scale.inertia * 1e-3
    assert width == pytest.approx(max(5e-4, min(millisecond, 0.003 * scale.velocity)))
    assert millisecond / 10.0 < width


def test_friction_of_another_size_each_way_turns_over_as_the_two_effects_that_make_it() -> None:
    """A Coulomb friction and a constant force: one tells it as plainly as the other."""
    nominal, turns = model(), []
    for name, values in (("coulomb_friction", (0.1,)), ("asymmetric_friction", (0.14, 0.06))):
        friction = EffectInstance(CATALOGUE[name], "pendulum")
        theta = nominal.grown(np.zeros(nominal.nuisances), friction, (*values, 1e-9))[1]
        turns.append(float(np.exp(theta[-1])))
    assert turns[1] == pytest.approx(turns[0], rel=1e-9)


@pytest.mark.parametrize(("friction", "frees"), [(0.05, True), (1e-5, False), (0.0, False)])
def test_a_parameter_of_next_to_nothing_is_no_start_for_an_effect(friction, frees) -> None:
    """As a joint's damping of 0.001 N m s/rad that is there for the integrator."""
    viscous = EffectInstance(CATALOGUE["viscous_friction"], "pendulum")
    before = model(friction=friction)
    grown, theta = before.grown(np.zeros(before.nuisances), viscous, (0.2,))
    assert (before.frees(viscous) is not None) == (viscous in grown.freed) == frees
    assert (viscous in grown.added) != frees
    assert theta.tolist() == [0.0] * before.nuisances + [0.2] * (not frees)
