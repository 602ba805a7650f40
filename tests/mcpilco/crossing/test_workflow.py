"""What a model may take over from a correction."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from envs.plants import cart_pole, pendubot
from mcpilco.crossing import CrossingSettings, Place, Workflow, as_mean, remembered_inputs
from mcpilco.plant import (
    CATALOGUE,
    Correction,
    EffectInstance,
    Member,
    corrected,
    correction_from,
    correction_of,
    write_correction,
)
from mcpilco.plant.equations.step import beyond_equations, require_expressible
from mcpilco.typing import InputError
from tests.mcpilco.plant.equations.test_step import task_of


def as_file(effects=(), learned=()) -> dict[str, Any]:
    plant = "mcpilco/CartPoleSwingUp-v0"
    lists = {"effects": list(effects), "learned": list(learned)}
    return {"format": 1, "plant": plant, "parameters": {}, **lists}


def correction(*effects: tuple[str, str, dict[str, float]]) -> Correction:
    keys = "name", "target", "parameters"
    return correction_from(as_file([dict(zip(keys, effect, strict=True)) for effect in effects]))


FRICTION = "coulomb_friction", "cart", {"f_c": 1.0}
DELAY = "actuator_delay", "actuator", {"d": 0.07}
LAG = "actuator_lag", "actuator", {"T": 0.05}
PAIR = ("actuator_delay", "d", 0.01), ("actuator_lag", "T", 0.02)


@pytest.mark.parametrize(
    ("effects", "inputs"),
    [((), 0), ((FRICTION,), 0), ((FRICTION, DELAY), 1), ((LAG,), 2), ((DELAY, LAG), 3)],
)
def test_inputs_are_remembered_as_long_as_the_actuator_answers_to_them(effects, inputs):
    assert remembered_inputs(correction(*effects), 0.1) == inputs


def test_mean_has_what_can_be_written_and_leaves_the_rest_to_be_learned():
    force = {
        "joint": "cart",
        "axes": [{"of": "cart_position", "low": -1.0, "high": 1.0, "knots": 4, "slow": 0.0}],
        "weights": [0.0] * 4,
    }
    whole = correction(FRICTION, LAG, ("backlash", "actuator", {"p": 0.1}))
    whole = replace(whole, learned=correction_from(as_file(learned=[force])).learned)
    assert len(whole.learned) == 1
    assert as_mean(whole, cart_pole()) == correction(FRICTION, LAG)


@pytest.mark.parametrize(
    ("beyond", "said"),
    [
        (
            ("back_emf", "cart", {"b": 0.4, "T": 0.05}),
            [("viscous_friction", "cart", {"b": 0.4}), LAG],
        ),
        (
            ("elastic_joint", "cart", {"I_m": 0.2, "k": 90.0, "z": 0.1}),
            [("armature", "cart", {"I_a": 0.2})],
        ),
        (("backlash", "actuator", {"p": 0.1}), []),
    ],
    ids=lambda case: case[0] if isinstance(case, tuple) else "",
)
def test_mean_says_the_special_cases_of_what_equations_cannot_say(beyond, said):
    assert as_mean(correction(FRICTION, beyond), cart_pole()) == correction(FRICTION, *said)


def test_mean_has_the_spread_of_what_can_be_written():
    values = {"coulomb_friction.cart.f_c": 1.0, "backlash.actuator.p": 0.1, "cart_mass": 0.5}
    std = dict.fromkeys(values, 0.01)
    member = Member(1.0, values, std, ((1.0, 0.2, 0.3), (0.2, 1.0, 0.4), (0.3, 0.4, 1.0)))
    (kept,) = as_mean(replace(correction(FRICTION), spread=(member,)), cart_pole()).spread
    assert list(kept.std) == list(kept.values) == ["coulomb_friction.cart.f_c", "cart_mass"]
    assert kept.correlation == ((1.0, 0.3), (0.3, 1.0))


def test_inputs_are_remembered_for_every_plant_of_the_spread():
    member = Member(0.1, {"actuator_lag.actuator.T": 0.05, "cart_mass": 0.5}, {}, ())
    assert remembered_inputs(replace(correction(DELAY), spread=(member,)), 0.1) == 3


def test_a_policy_of_the_posterior_is_judged_in_plants_that_it_draws(tmp_path):
    place = Place("mcpilco/CartPoleSwingUp-v0", {"noise_std": 0.0})
    told = CrossingSettings(place, place)
    path = tmp_path / "gap" / "corrected.json"
    path.parent.mkdir()
    member = Member(1.0, {}, {"coulomb_friction.cart.f_c": 0.1}, ((1.0,),))
    write_correction(path, replace(correction(FRICTION), spread=(member,)))
    places = Workflow(tmp_path, told, cart_pole())._possible(place, "corrected")
    sizes = [p.kwargs["effects"].effects[0].values[0] for p in places]
    assert len(set(sizes)) == len(places) > 5
    assert np.std(sizes) == pytest.approx(0.1, rel=0.5)
    assert {p.kwargs["noise_std"] for p in places} == {0.0}
    alone = Workflow(tmp_path, replace(told, spread=False), cart_pole())
    assert alone._possible(place, "corrected") == [place]
    assert Workflow(tmp_path, told, cart_pole())._possible(place, "nominal") == [place]


def test_a_model_remembers_as_many_inputs_as_the_plants_equations_ask_for():
    """d = 0.01 s and T = 0.02 s at 0.1 s: of the input before the last, 1 % is left."""
    dt, task, counts = 0.1, task_of(cart_pole()), []
    for d, T in product(0.002 * np.arange(50), 0.002 * np.arange(41)):
        late = ("actuator_delay", "actuator", {"d": d}), ("actuator_lag", "actuator", {"T": T})
        memory = remembered_inputs(correction(*late), dt)
        plant = corrected(cart_pole(), correction(*late))
        tables = plant.tables(plant.nominal[None])
        require_expressible(plant, task, tables, memory)
        if memory:
            with pytest.raises(InputError, match=f"the last {memory} commands"):
                require_expressible(plant, task, tables, memory - 1)
        forgotten = np.exp(-(memory * dt - d) / T) if T else float(memory * dt < d - 1e-9)
        assert forgotten <= 0.05 + 1e-6
        counts.append(memory)
    assert len(counts) == 2050
    assert remembered_inputs(correction(*((n, "actuator", {s: x}) for n, s, x in PAIR)), dt) == 1


def test_effects_left_out_of_the_mean_are_those_that_equations_cannot_have():
    for effect in (each for each in CATALOGUE.values() if each.place != "contact"):
        values = tuple(
            0.03 if np.isinf(s.neutral) else min(s.neutral + 0.03, s.high) for s in effect.symbols
        )
        bare = cart_pole() if effect.targets(cart_pole().layout) else pendubot()
        plant = bare.having([(EffectInstance(effect, effect.targets(bare.layout)[0]), values)])
        whole = correction_of(plant, bare)
        kept = as_mean(whole, cart_pole()).effects
        assert (kept == whole.effects) == (beyond_equations(plant) == ())
        assert beyond_equations(corrected(bare, as_mean(whole, cart_pole()))) == ()
