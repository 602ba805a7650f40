"""Laws of the configuration: what JSON keeps, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.config import (
    PRESETS,
    Config,
    ModelConfig,
    Phase,
    PolicyConfig,
    SearchConfig,
    from_dict,
)
from mcpilco.typing import InputError

ROOT = Path(__file__).parent.parent.parent

positive = st.floats(1e-6, 1e6)
phases = st.builds(Phase, positive, st.floats(0, 0.99), st.floats(0, 1), st.floats(0, 1))
searches = st.builds(
    SearchConfig,
    particles=st.integers(1, 10**6),
    steps=st.lists(st.integers(1, 10**6), min_size=1, max_size=4).map(tuple),
    rates=st.lists(positive, min_size=1, max_size=4).map(tuple),
    phases=st.lists(phases, min_size=1, max_size=3).map(tuple),
    monitored=st.booleans(),
    clip_norm=st.none() | positive,
)
policies = st.builds(
    PolicyConfig,
    bases=st.integers(1, 10**4),
    span=positive | st.sampled_from(["rms", "data"]),
    lengthscale=positive | st.just("span"),
)
configs = st.builds(
    Config,
    model=st.builds(
        ModelConfig,
        kernel=st.sampled_from(["rbf", "mpk", "rbf+mpk"]),
        sampling=st.sampled_from(["step", "path"]),
        path_features=st.integers(1, 10**4).map(lambda pairs: 2 * pairs),
    ),
    policy=policies,
    search=searches,
    horizon=st.none() | st.integers(1, 10**6),
    engine=st.sampled_from(["fused", "eager"]),
)


def through_json(config: Config) -> Config:
    return from_dict(Config, json.loads(json.dumps(dataclasses.asdict(config))))


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_json(name: str) -> None:
    assert through_json(PRESETS[name].config) == PRESETS[name].config


@given(configs)
def test_every_config_survives_json(config: Config) -> None:
    assert through_json(config) == config


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"horizons": 3}, r"Config has no entries \['horizons'\]"),
        ({"horizon": "3"}, r"Config.horizon must be of type int \| None, got '3'."),
        ({"horizon": True}, "got True"),
        ({"horizon": 0}, "horizon must be >= 1 step, got 0"),
        ({"engine": "gpu"}, "Config.engine must be of type Literal"),
        ({"model": 5}, "ModelConfig must be an object with named entries, got 5."),
        ({"model": {"kernel": "matern"}}, "kernel must be a sum of different parts"),
        (
            {"model": {"noise_floor": float("nan")}},
            "ModelConfig.noise_floor must be of type float and finite, got nan",
        ),
        ({"model": {"sampling": "paths"}}, "ModelConfig.sampling must be of type Literal"),
        ({"policy": {"span": "wide"}}, "PolicyConfig.span"),
        ({"search": {"steps": 5}}, "SearchConfig.steps must be of type tuple"),
        ({"search": {"steps": ["a"]}}, "SearchConfig.steps"),
        ({"search": {"phases": [{}]}}, "Phase lacks an entry"),
        ({"search": {"phases": [{"learning_rate": 0.1, "rate": 1}]}}, "Phase has no entries"),
        ([], "Config must be an object"),
    ],
)
def test_wrong_json_is_answered_with_a_sentence(values, message: str) -> None:
    with pytest.raises(InputError, match=message):
        from_dict(Config, values)


@pytest.mark.parametrize(
    ("kind", "entry", "wrong"),
    [
        (ModelConfig, "degree", 0),
        (ModelConfig, "noise_floor", 0.0),
        (ModelConfig, "plausible", 1.0),
        (ModelConfig, "subset_threshold", -0.5),
        (ModelConfig, "path_features", 0),
        (ModelConfig, "path_features", 7),
        (PolicyConfig, "bases", 0),
        (PolicyConfig, "span", 0.0),
        (PolicyConfig, "lengthscale", -1.0),
        (PolicyConfig, "angle_lengthscale", 0.0),
        (PolicyConfig, "squash", 0.0),
        (SearchConfig, "particles", 0),
        (SearchConfig, "evaluation_particles", 1),
        (SearchConfig, "restarts", -1),
        (SearchConfig, "steps", ()),
        (SearchConfig, "steps", (5, 0)),
        (SearchConfig, "rates", ()),
        (SearchConfig, "rates", (0.0,)),
        (SearchConfig, "phases", ()),
        (SearchConfig, "clip_norm", 0.0),
        (SearchConfig, "widening", 0.5),
        (Config, "horizon", -3),
    ],
)
def test_numbers_that_make_no_sense_are_refused_by_name(kind: type, entry: str, wrong) -> None:
    with pytest.raises(InputError, match=entry):
        kind(**{entry: wrong})


@pytest.mark.parametrize(("entry", "wrong"), [("learning_rate", 0.0), ("dropout", 1.0)])
def test_a_phase_without_sense_is_refused(entry: str, wrong: float) -> None:
    with pytest.raises(InputError, match=entry):
        Phase(**{"learning_rate": 0.1, entry: wrong})


def test_the_last_entry_of_a_schedule_holds_from_there_on() -> None:
    search = SearchConfig(steps=(5, 7), rates=(1.0, 0.5, 0.25))
    assert [search.steps_of(trial) for trial in (1, 2, 3, 9)] == [5, 7, 7, 7]
    assert [search.rate_of(trial) for trial in (1, 2, 3, 9)] == [1.0, 0.5, 0.25, 0.25]


def test_presets_are_what_they_are_named_after() -> None:
    thesis, later = PRESETS["thesis"].config, PRESETS["tro2022"].config
    assert PRESETS["default"].config == Config()
    assert (thesis.policy.bases, thesis.search.particles) == (100, 100)
    steps = [thesis.search.steps_of(trial) for trial in range(1, 6)]
    rates = [thesis.search.rate_of(trial) for trial in range(1, 6)]
    assert steps == sorted(steps)
    assert rates == sorted(rates, reverse=True)
    assert (later.policy.bases, later.search.particles) == (200, 400)
    assert [phase.dropout for phase in later.search.phases] == [0.25, 0.125, 0.0]
    assert later.search.monitored
    assert later.model.subset_threshold == 0.5


@pytest.mark.parametrize(
    ("env_id", "described"),
    [
        ("mcpilco/CartPoleSwingUp-v0", True),
        ("envs:mcpilco/MujocoCartPoleSwingUp-v0", True),
        ("mcpilco/Pendulum-v0", False),
        ("mine:My/CartPoleSwingUp-v0", False),
    ],
)
def test_keywords_of_a_preset_describe_the_cart_poles_and_no_other_env(env_id, described) -> None:
    preset = PRESETS["tro2022"]
    assert preset.keywords(env_id) == (preset.env_kwargs if described else {})


def test_reading_a_config_does_not_wait_for_torch() -> None:
    code = "import sys, mcpilco.config; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "False", done.stderr
