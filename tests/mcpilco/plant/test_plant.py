"""What a plant takes, and that its motions are those of its values."""

from __future__ import annotations

import numpy as np
import pytest

from envs.plants import cart_pole, double_pendulum, pendubot, pendulum
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.plant import EffectInstance
from mcpilco.typing import InputError

COULOMB = EffectInstance(CATALOGUE["coulomb_friction"], "cart")
DT = 0.02


def some_motions(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(0, [0.3, 1, 2, 3], (n, 4)), rng.uniform(-8, 8, (n, 15, 1))


def test_other_values_are_those_that_are_given():
    plant = cart_pole().where(pole_mass=0.8, cart_friction=0.0)
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    assert (values["pole_mass"], values["cart_friction"], values["cart_mass"]) == (0.8, 0.0, 0.5)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"pole_weight": 1.0}, "has no parameter 'pole_weight'; it has cart_mass, pole_mass"),
        ({"pole_mass": 0.0}, "pole_mass must be finite and at least 1e-06, got 0"),
        ({"pole_mass": -1.0}, "pole_mass must be finite and at least 1e-06, got -1"),
        ({"gravity": float("nan")}, "gravity must be finite and at least 0, got nan"),
        ({"cart_friction": float("inf")}, "cart_friction must be finite"),
    ],
)
def test_values_that_make_no_sense_are_refused(values, said):
    with pytest.raises(InputError, match=said):
        cart_pole().where(**values)


def test_an_effect_is_felt_from_when_the_plant_has_it():
    start, inputs = some_motions(2)
    without = cart_pole().simulate(start, inputs, DT)
    plant = cart_pole().having([(COULOMB, [0.5, 2e-3])])
    assert np.abs(plant.simulate(start, inputs, DT) - without).max() > 1e-2
    nothing = cart_pole().having([(COULOMB, [0.0, 2e-3])])
    np.testing.assert_array_equal(nothing.simulate(start, inputs, DT), without)


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.place != "contact"])
def test_effects_begin_as_nothing_and_end_as_they_are(name):
    effect = CATALOGUE[name]
    make = pendubot if name == "body_length" else cart_pole
    target = effect.targets(make().layout)[0]
    values = [0.05 if np.isinf(s.neutral) else s.neutral + 0.05 for s in effect.symbols]
    plant = make().having([(EffectInstance(effect, target), values)])
    start, inputs = some_motions(2)
    moved = [
        some.simulate(start, inputs, DT)
        for some in (make(), plant.weakened(0.0), plant.weakened(0.5), plant.weakened(1.0))
    ]
    np.testing.assert_array_equal(moved[1], moved[0])
    np.testing.assert_array_equal(moved[3], plant.simulate(start, inputs, DT))
    assert all(np.abs(moved[2] - moved[end]).max() > 1e-6 for end in (0, 3))


def test_effects_add_up_in_any_number_of_steps():
    start, inputs = some_motions(2)
    drag, delay = (
        EffectInstance(CATALOGUE["quadratic_drag"], "cart"),
        EffectInstance(CATALOGUE["actuator_delay"], "actuator"),
    )
    at_once = cart_pole().having([(drag, [0.3]), (delay, [0.03])])
    by_and_by = (
        cart_pole().having([(delay, [0.01])]).having([(drag, [0.3])]).having([(delay, [0.02])])
    )
    np.testing.assert_allclose(
        by_and_by.simulate(start, inputs, DT), at_once.simulate(start, inputs, DT), atol=1e-6
    )


@pytest.mark.parametrize(
    ("active", "values", "said"),
    [
        (
            EffectInstance(CATALOGUE["coulomb_friction"], "wheel"),
            [1.0, 2e-3],
            "cannot act at 'wheel'",
        ),
        (EffectInstance(CATALOGUE["center_of_mass"], "cart"), [0.1], "its targets are pole"),
        (COULOMB, [1.0], "coulomb_friction \\(cart\\) must have values for f_c, v_r, got 1"),
    ],
)
def test_an_effect_that_does_not_fit_is_refused(active, values, said):
    with pytest.raises(InputError, match=said):
        cart_pole().having([(active, values)])


def test_values_of_each_motion_equal_separate_plants():
    start, inputs = some_motions(3)
    masses, gains = np.array([0.3, 0.5, 0.9]), np.array([1.1, 1.0, 0.7])
    together = cart_pole().simulate(start, inputs, DT, {"pole_mass": masses, "force_gain": gains})
    for n in range(3):
        plant = cart_pole().where(pole_mass=masses[n], force_gain=gains[n])
        alone = plant.simulate(start[n : n + 1], inputs[n : n + 1], DT)
        np.testing.assert_array_equal(together[n], alone[0])


def test_a_parameter_that_no_plant_has_is_refused():
    start, inputs = some_motions(1)
    with pytest.raises(InputError, match="has no parameter 'mass'"):
        cart_pole().simulate(start, inputs, DT, {"mass": np.ones(1)})


def test_a_motion_begins_at_its_start_and_has_one_sample_more_than_inputs():
    start, inputs = some_motions(2)
    found = cart_pole().simulate(start, inputs, DT)
    assert found.shape == (2, 16, 4)
    np.testing.assert_array_equal(found[:, 0], start)
    np.testing.assert_array_equal(cart_pole().simulate(start, inputs[:, :0], DT)[:, 0], start)


def test_arguments_are_left_as_they_were():
    start, inputs = some_motions(2)
    before = start.copy(), inputs.copy()
    cart_pole().simulate(start, inputs, DT)
    np.testing.assert_array_equal(start, before[0])
    np.testing.assert_array_equal(inputs, before[1])


def test_candidates_are_every_effect_at_every_target():
    found = [str(candidate) for candidate in cart_pole().candidates()]
    assert len(found) == len(set(found)) == 11 * 2 + 4 + 2 + 1 + 1 + 2 + 8 + 4 * 4 + 2
    names = {c.effect.name for p in (cart_pole, double_pendulum) for c in p().candidates()}
    assert names == {name for name, effect in CATALOGUE.items() if effect.place != "contact"}
    assert "center_of_mass (pole)" in found
    assert "center_of_mass (cart)" not in found  # it moves without turning
    assert "backlash (elbow_torque)" in map(str, double_pendulum().candidates())


def test_each_angle_is_the_position_of_a_hinge():
    for plant in (cart_pole(), pendulum(), double_pendulum()):
        hinges = [2 * j for j, slides in enumerate(plant.layout.slides) if not slides]
        assert list(plant.angles) == hinges
