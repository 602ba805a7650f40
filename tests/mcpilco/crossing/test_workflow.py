"""What a model may take over from a correction."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from envs.plants import cart_pole, pendubot
from mcpilco.crossing import as_mean, remembered_inputs
from mcpilco.plant import (
    CATALOGUE,
    Correction,
    EffectInstance,
    corrected,
    correction_from,
    correction_of,
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
    assert as_mean(whole) == correction(FRICTION, LAG)


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
        kept = as_mean(whole).effects
        assert (kept == whole.effects) == (beyond_equations(plant) == ())
        assert beyond_equations(corrected(bare, as_mean(whole))) == ()
