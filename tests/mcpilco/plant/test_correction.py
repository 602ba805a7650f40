"""A correction survives its file, and whatever is wrong with a file is one sentence."""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.plants import PLANTS, cart_pole
from mcpilco.plant.correction import (
    Addition,
    Correction,
    corrected,
    correction_from,
    correction_json,
    correction_of,
    read_correction,
    write_correction,
)
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.effects.learned import Axis, LearnedForce
from mcpilco.typing import InputError

CART_POLE = "mcpilco/CartPoleSwingUp-v0"
WHOLE = {
    "format": 1,
    "plant": CART_POLE,
    "parameters": {"cart_mass": 0.51},
    "effects": [{"name": "coulomb_friction", "target": "cart", "parameters": {"f_c": 0.3}}],
}
LEARNED = {
    "joint": "pole",
    "axes": [{"of": "pole_angle", "low": -1.0, "high": 1.0, "knots": 4, "slow": 0.0}],
    "weights": [0.0, 0.25, -0.25, 0.0],
}


def everything(plant):
    """Each effect at each target, at values that change nothing."""
    neutral = [(active, active.effect.neutral) for active in plant.candidates()]
    return plant.having(neutral)


@pytest.mark.parametrize("name", PLANTS)
def test_corrected_plant_survives_its_file(tmp_path, name):
    nominal = PLANTS[name]()
    first = nominal.parameters[0]
    plant = everything(nominal).where(**{first.name: 1.1 * first.value})
    path = write_correction(tmp_path / "corrected.json", correction_of(plant, nominal))
    assert "Infinity" not in path.read_text()
    again = corrected(nominal, read_correction(path))
    assert again.parameters == plant.parameters
    assert again.added == plant.added


def test_learned_forces_survive_their_file_and_an_env_simulates_them(tmp_path):
    axes = Axis("pole_angle", -3.0, 2.5, 12, closed=True), Axis("force", -6.0, 6.0, 5)
    weights = np.random.default_rng(0).normal(0.0, 0.3, 60).astype(np.float32)
    nominal = cart_pole()
    plant = nominal.with_learned([LearnedForce("pole", axes, tuple(map(float, weights)))])
    path = write_correction(tmp_path / "corrected.json", correction_of(plant, nominal))
    again = corrected(nominal, read_correction(path))
    assert again.learned[0].axes == axes
    np.testing.assert_allclose(again.learned[0].weights, weights, rtol=1e-7)
    moved = []
    for effects in (None, path):
        env = gymnasium.make(CART_POLE, effects=effects)
        env.reset(seed=0)
        moved.append(env.step(np.array([3.0], dtype=np.float32))[0])
    assert np.abs(moved[1] - moved[0]).max() > 0.01


@pytest.mark.parametrize(("more", "closed"), [({}, False), ({"closed": True}, True)])
def test_an_axis_is_open_unless_its_file_says_otherwise(more, closed):
    (force,) = correction_from(axis(**more)).learned
    assert force.axes[0].closed == closed


def test_correction_of_the_nominal_plant_is_empty():
    assert correction_of(cart_pole(), cart_pole()) == Correction(CART_POLE, {}, ())


def test_what_only_smooths_a_formula_may_be_left_out():
    correction = correction_from(WHOLE)
    assert correction.effects[0].values == (0.3, 0.002)


def test_correction_changes_the_motion():
    nominal = cart_pole()
    start, push = np.array([[0.0, 1.0, 0.5, 0.0]]), np.zeros((1, 5, 1))
    apart = corrected(nominal, correction_from(WHOLE)).simulate(start, push, 0.1)
    assert np.abs(apart - nominal.simulate(start, push, 0.1)).max() > 0.01


def damaged(**changes):
    return {**WHOLE, **changes}


def learned(**changes):
    return damaged(learned=[{**LEARNED, **changes}])


def axis(**changes):
    return learned(axes=[{**LEARNED["axes"][0], **changes}])


def effect(**changes):
    return damaged(effects=[{**WHOLE["effects"][0], **changes}])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ([], "must be an object"),
        ({}, 'must have "format", "plant"'),
        ({**WHOLE, "more": 1}, "and no more"),
        (damaged(format=2), '"format" must be 1, got 2'),
        (damaged(format=True), '"format" must be 1'),
        (damaged(plant=3), '"plant" must be the name'),
        (damaged(parameters=[1]), '"parameters" must be an object'),
        (damaged(parameters={"cart_mass": "heavy"}), "'cart_mass' must be a finite number"),
        (damaged(parameters={"cart_mass": math.inf}), "'cart_mass' must be a finite number"),
        (damaged(parameters={"cart_mass": 10**400}), "'cart_mass' must be a finite number"),
        (damaged(effects={}), '"effects" must be a list'),
        (effect(name="magic"), "there is no effect 'magic'; there are viscous_friction"),
        (effect(name=["magic"]), '"name" of an effect must be a word'),
        (effect(parameters={"k": 1.0}), "coulomb_friction has no parameter 'k'; it has f_c"),
        (effect(parameters={}), r"coulomb_friction \(cart\) needs a value of f_c"),
        (effect(parameters={"f_c": -1.0}), "f_c of .* must be a finite number at least 0, got -1"),
        (effect(parameters={"f_c": None}), "f_c of .* must be a finite number"),
        (effect(parameters={"f_c": math.nan}), "must be a finite number at least 0, got nan"),
        (effect(parameters={"f_c": True}), "must be a finite number"),
        (effect(parameters={"f_c": 0.1, "v_r": 0.0}), "at least 0.0005 and at most 0.1"),
        (damaged(learned={}), '"learned" must be a list'),
        (damaged(learned=[{}]), 'a learned force must have "joint", "axes", "weights"'),
        (learned(joint=1), '"joint" of a learned force must be a word, got 1'),
        (learned(axes={}), '"axes" of a learned force must be a list'),
        (learned(axes=[]), "must have one axis or two, got 0"),
        (learned(weights=[0.0]), "must have 4 finite weights, one a knot, got 1"),
        (learned(weights=[0.0, 0.0, 0.0, None]), "a weight .* must be a finite number, got None"),
        (learned(weights=[0.0, 0.0, 0.0, "x"]), "a weight .* must be a finite number, got 'x'"),
        (axis(knots=True), '"knots" of an axis must be a count, got True'),
        (axis(knots=10**9), "4 to 200 knots"),
        (axis(closed=1), '"closed" of an axis must be true or false, got 1'),
        (axis(of=None), '"of" of an axis must be a word'),
        (axis(low=math.nan), "low of the axis pole_angle must be a finite number, got nan"),
        (axis(slow=-1.0), "slow >= 0"),
    ],
)
def test_wrong_file_gets_a_sentence_that_names_the_part(tmp_path, content, sentence):
    path = tmp_path / "corrected.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"corrected.json is no correction.*{sentence}"):
        read_correction(path)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_damaged_file_is_no_json(tmp_path, content):
    path = tmp_path / "corrected.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match="corrected.json is no JSON file"):
        read_correction(path)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="nowhere.json: No such file"):
        read_correction(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("correction", "sentence"),
    [
        (Correction("robot", {}, ()), "is for the plant 'robot', got 'mcpilco/CartPole"),
        (Correction(CART_POLE, {"wheel": 1.0}, ()), "has no parameter 'wheel'; it has cart_mass"),
        (Correction(CART_POLE, {"cart_mass": -1.0}, ()), "cart_mass must be finite and at least"),
        (
            Correction(CART_POLE, {}, (Addition("spring", "elbow", {"k": 1.0}),)),
            "spring cannot act at 'elbow' .*; its targets are cart, pole",
        ),
    ],
)
def test_correction_that_does_not_fit_its_plant_gets_a_sentence(correction, sentence):
    with pytest.raises(InputError, match=sentence):
        corrected(cart_pole(), correction)


LEAVES = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5)
NAMES = st.sampled_from(["format", "plant", "effects", "name", "target", "f_c", *CATALOGUE])
JSON = st.recursive(
    LEAVES | NAMES, lambda x: st.lists(x, max_size=3) | st.dictionaries(NAMES, x, max_size=3)
)


@settings(max_examples=200, deadline=None)
@given(key=st.sampled_from([*WHOLE, "name", "target", "values", "learned", *LEARNED]), value=JSON)
def test_any_content_is_a_correction_or_a_sentence(key, value):
    if key in LEARNED:
        content = learned(**{key: value})
        with contextlib.suppress(InputError):
            assert isinstance(correction_from(content), Correction)
        return
    content = {"values": {"parameters": value}}.get(key, {key: value})
    content = damaged(**content) if key in (*WHOLE, "learned") else effect(**content)
    with contextlib.suppress(InputError):
        assert isinstance(correction_from(content), Correction)


def test_a_file_may_hold_an_mjcf_and_what_a_command_tells_besides(tmp_path):
    content = correction_json(replace(correction_from(WHOLE), mjcf="<mujoco/>"))
    path = tmp_path / "identified.json"
    path.write_text(json.dumps({**content, "about": {"rows": 3}}))
    read = read_correction(path)
    assert read.mjcf == "<mujoco/>"
    assert read.parameters == WHOLE["parameters"]
    with pytest.raises(InputError, match='"mjcf" must be a word, got 3'):
        correction_from({**WHOLE, "mjcf": 3})
