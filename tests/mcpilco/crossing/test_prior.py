"""What a model may take over from a correction."""

from __future__ import annotations

import pytest

from mcpilco.correction import Correction, correction_from
from mcpilco.crossing import has_equations, remembered_inputs


def correction(*effects: tuple[str, str, dict[str, float]]) -> Correction:
    keys = "name", "target", "parameters"
    return correction_from(
        {
            "format": 1,
            "plant": "mcpilco/CartPoleSwingUp-v0",
            "parameters": {},
            "effects": [dict(zip(keys, effect, strict=True)) for effect in effects],
        }
    )


FRICTION = "coulomb_friction", "cart", {"f_c": 1.0}
DELAY = "actuator_delay", "actuator", {"d": 0.07}
LAG = "actuator_lag", "actuator", {"T": 0.05}


@pytest.mark.parametrize(
    ("effects", "inputs"),
    [((), 0), ((FRICTION,), 0), ((FRICTION, DELAY), 1), ((LAG,), 2), ((DELAY, LAG), 3)],
)
def test_inputs_are_remembered_as_long_as_the_actuator_answers_to_them(effects, inputs):
    assert remembered_inputs(correction(*effects), 0.1) == inputs


@pytest.mark.parametrize(
    ("name", "target", "parameters", "written"),
    [(*FRICTION, True), (*LAG, True), ("backlash", "actuator", {"p": 0.1}, False)],
)
def test_what_jumps_has_no_equations(name, target, parameters, written):
    assert has_equations(correction((name, target, parameters))) == written
