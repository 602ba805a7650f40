"""A spread: its draws are plants, each moved by the program as its simulation moves it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from envs.plants import cart_pole
from mcpilco.plant.correction import (
    corrected,
    correction_from,
    correction_of,
    read_correction,
    write_correction,
)
from mcpilco.plant.equations.step import numbers_of, step_of
from mcpilco.plant.plant import Plant
from mcpilco.plant.simulation.motion import simulate
from mcpilco.plant.spread import Member, Spread, members_of, moved, opened, recipe_of
from mcpilco.typing import InputError
from tests.mcpilco.plant.equations.test_step import DT, task_of

F_C, D, T = "coulomb_friction.cart.f_c", "actuator_delay.actuator.d", "actuator_lag.actuator.T"
RECIPE = {"mass": 0.1, "f_c": 0.3, "d": 0.2}


def plant_with(*effects: tuple[str, str, dict[str, float]]) -> Plant:
    keys = "name", "target", "parameters"
    added = [dict(zip(keys, effect, strict=True)) for effect in effects]
    content = {"format": 1, "plant": cart_pole().name, "parameters": {}, "effects": added}
    return corrected(cart_pole(), correction_from(content))


FRICTION = "coulomb_friction", "cart", {"f_c": 1.0, "v_r": 0.1}
LATE = "actuator_delay", "actuator", {"d": 0.05}
LAG = "actuator_lag", "actuator", {"T": 0.02}
HARD = plant_with(FRICTION, LATE, LAG)


def normal(spread: Spread, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, spread.dimensions))


def drawn(spread: Spread, count: int) -> dict[str, np.ndarray]:
    return dict(zip(spread.names, spread.rows(normal(spread, count)).T, strict=True))


def test_draws_have_the_means_and_the_spreads_of_their_recipe():
    found = drawn(Spread(HARD, recipe_of(HARD, RECIPE)), 20_000)
    for name, mean, part in (("cart_mass", 0.5, 0.1), (F_C, 1.0, 0.3), (D, 0.05, 0.2)):
        assert found[name].mean() == pytest.approx(mean, rel=0.02)
        assert found[name].std() == pytest.approx(part * mean, rel=0.03)
    assert np.ptp(found["pole_length"]) < 1e-12
    assert found["cart_mass"].min() > 0.0
    assert found[F_C].min() >= 0.0


def test_numbers_that_are_found_together_are_drawn_together():
    close = ((1.0, 0.99), (0.99, 1.0))
    member = Member(1.0, {}, {"cart_mass": 0.05, "force_gain": 0.1}, close)
    found = drawn(Spread(HARD, (member,)), 5_000)
    ratio = found["force_gain"] / found["cart_mass"]
    assert ratio.std() / ratio.mean() < 0.3 * found["force_gain"].std()


def test_a_draw_has_the_effects_of_one_member():
    other = {
        "stribeck_friction.cart.f_c": 0.7,
        "stribeck_friction.cart.f_d": 0.5,
        "stribeck_friction.cart.v_s": 0.2,
    }
    spread = Spread(HARD, (Member(0.75, {F_C: 1.0}, {}, ()), Member(0.25, other, {}, ())))
    found = drawn(spread, 4_000)
    coulomb, stribeck = found[F_C] == 1.0, found["stribeck_friction.cart.f_c"] == 0.7
    assert (coulomb ^ stribeck).all()
    assert (found[F_C] + 0.7 * stribeck > 0.69).all()
    assert coulomb.mean() == pytest.approx(0.75, abs=0.03)
    assert (found[D] == 0.05).all()  # no member speaks of it
    source = dict(zip(spread.names, spread.expected({}), strict=True))
    assert (source[F_C], source["stribeck_friction.cart.f_c"]) == (1.0, 0.0)


def test_each_particle_is_moved_as_the_simulation_moves_its_plant():
    spread = Spread(HARD, recipe_of(HARD, {**RECIPE, "T": 0.3, "all": 0.1}))
    points, rng, memory, B = normal(spread, 8), np.random.default_rng(1), 2, 8
    step = step_of(spread.plant, task_of(HARD), 0.005, memory, drawn=spread.rows(points))
    own = numbers_of(spread.plant, step.slots, spread.rows(points))
    states, commands = rng.normal(size=(B, 4)), rng.uniform(-5, 5, (B, memory + 1, 1))
    given = np.concatenate([states, commands[:, 1], commands[:, 0], commands[:, 2], own], 1)
    found = step.program(torch.from_numpy(given)).numpy()[:, :4]
    for b, plant in enumerate(spread.plants(points)):
        window = np.pad(commands[b : b + 1], ((0, 0), (0, 1), (0, 0)))
        tables, none = plant.tables(plant.nominal[None]), np.zeros(1, dtype=int)
        seen = simulate(tables, none, states[b : b + 1], none, window, memory, DT)[0, :, 1]
        np.testing.assert_allclose(found[b], seen, atol=5e-3)
    apart = (
        found
        - step_of(HARD, task_of(HARD), 0.005, memory)
        .program(torch.from_numpy(np.concatenate([given[:, :7], _nominal(HARD, memory, B)], 1)))
        .numpy()[:, :4]
    )
    assert np.abs(apart).max() > 0.05  # and the plants differ


def _nominal(plant: Plant, memory: int, count: int) -> np.ndarray:
    step = step_of(plant, task_of(plant), 0.005, memory)
    return numbers_of(plant, step.slots, np.tile(plant.nominal, (count, 1)))


def test_a_moved_plant_is_that_of_its_correction():
    plant = moved(HARD, {F_C: 2.0, "cart_mass": 0.7})
    again = corrected(cart_pole(), correction_of(plant))
    assert (again.values, again.added) == (plant.values, plant.added)
    assert opened(plant).values[F_C] == 2.0


def test_a_spread_survives_the_file_of_its_correction(tmp_path):
    members = (*recipe_of(HARD, RECIPE), Member(0.2, {F_C: 0.5}, {F_C: 0.1}, ((1.0,),)))
    correction = correction_of(HARD, cart_pole())
    whole = type(correction)(**{**vars(correction), "spread": members})
    path = write_correction(tmp_path / "corrected.json", whole)
    assert read_correction(path).spread == members
    assert corrected(cart_pole(), read_correction(path)).added == HARD.added


MEMBER = {"probability": 1.0, "values": {}, "std": {"cart_mass": 0.1}, "correlation": [[1.0]]}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"std": {"cart_mass": -0.1}}, "no std below 0"),
        ({"std": {"cart_mass": "wide"}}, "could not convert"),
        ({"correlation": []}, "correlation of 1 x 1"),
        ({"probability": 0.0}, r"probability must be in \(0, 1\], got 0"),
        ({"probability": float("nan")}, "probability"),
        ({"values": None}, "must have probability, values, std"),
    ],
)
def test_a_wrong_member_gets_a_sentence(changed, sentence):
    with pytest.raises(InputError, match=sentence):
        members_of([{**MEMBER, **changed}])


@pytest.mark.parametrize("content", [3, "mass", [1], None, {"mass": 0.1}])
def test_what_is_no_member_gets_a_sentence(content):
    with pytest.raises(InputError, match="a member of a spread"):
        members_of([content])


@pytest.mark.parametrize(
    ("recipe", "sentence"),
    [
        ({"wheel": 0.1}, "no 'wheel' that is not 0; it has cart_mass"),
        ({"mass": -0.1}, "must be from 0 to 1, got -0.1"),
        ({"mass": "much"}, "got 'much'"),
    ],
)
def test_a_wrong_recipe_gets_a_sentence(recipe, sentence):
    with pytest.raises(InputError, match=sentence):
        recipe_of(HARD, recipe)


def test_a_name_that_the_plant_does_not_have_gets_a_sentence():
    with pytest.raises(InputError, match="names 'wheel'; the plant has cart_mass"):
        Spread(HARD, (Member(1.0, {}, {"wheel": 0.1}, ((1.0,),)),))
    with pytest.raises(InputError, match="names 'magic.cart.m'; the plant has"):
        Spread(HARD, (Member(1.0, {"magic.cart.m": 1.0}, {}, ()),))
