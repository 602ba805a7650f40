"""What a model may take over from a correction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mcpilco.crossing import as_mean, remembered_inputs
from mcpilco.plant import Correction, correction_from


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
