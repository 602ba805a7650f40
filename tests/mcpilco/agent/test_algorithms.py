"""Algorithms by name, and the numbers of a training: of a preset, with another model."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest

from baselines.pilco.model import PilcoConfig
from mcpilco.agent import algorithms, import_named, suitable_preset, with_model
from mcpilco.agent.agent import MCPILCO
from mcpilco.config import Config, ModelConfig
from mcpilco.plant import Correction, Member, members_of, write_correction
from mcpilco.sweep import Settings, run_seed
from mcpilco.typing import InputError
from tests.baselines.pilco.models import TINY
from tests.mcpilco.sweep.strange import HERE

ROOT = Path(__file__).parents[3]


def test_the_packages_own_algorithm_is_known():
    assert algorithms.find("mcpilco") is MCPILCO


@pytest.mark.slow
def test_an_algorithm_is_known_once_its_package_is_imported():
    code = (
        "from mcpilco.agent import import_named\n"
        "from mcpilco.agent.algorithms import find, names\n"
        "print(names()); import_named('baselines:pilco')\n"
        "print(find('baselines:pilco').algo, names())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    registered = "['mcpilco', 'pilco', 'ppo', 'sac', 'tqc']"
    assert done.stdout.split("\n")[:2] == ["['mcpilco']", f"pilco {registered}"]


@pytest.mark.parametrize("name", ["dqn", "baselines:dqn", "no_such_package:dqn"])
def test_what_is_not_known_is_refused_with_a_sentence(name):
    with pytest.raises(InputError, match=r"must be one of .* got 'dqn'.*--trust"):
        algorithms.find(name)


@pytest.mark.parametrize("name", ["no_such_package:pilco", "no.such.module:Env-v0"])
def test_a_module_that_is_not_there_is_answered_with_a_sentence(name):
    with pytest.raises(InputError, match=r"Cannot import the module no.*No module named"):
        import_named(name)


def test_a_name_is_taken_once(monkeypatch):
    monkeypatch.setattr(algorithms, "_HOMES", dict(algorithms._HOMES))
    algorithms.register("other", "a.b:C")
    algorithms.register("other", "a.b:C")
    with pytest.raises(InputError, match="registered as a.b:C already"):
        algorithms.register("other", "a.b:D")


def test_a_seed_of_a_sweep_learns_with_its_algorithm():
    settings = Settings(
        f"{HERE}:Sweep/Point-v0", config=TINY, trials=1, fresh=2, algo="baselines:pilco"
    )
    result = run_seed(settings, 0)
    assert result["trials"][0]["policy_steps"] <= TINY.evaluations
    assert result["trials"][0]["fresh_return"] is not None


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("mpk", ModelConfig(kernel="mpk")),
        ("features+rbf", ModelConfig(kernel="features+rbf")),
        ("sed-fir", ModelConfig(kernel="sed-fir", memory=3)),
        ("physics+rbf", ModelConfig(kernel="rbf", mean="physics")),
        ("physics+gip+rbf", ModelConfig(kernel="gip+rbf", mean="physics")),
        ("rbf+physics+mpk", ModelConfig(kernel="rbf+mpk", mean="physics")),
    ],
)
def test_a_name_is_a_sum_of_parts(name, model):
    assert with_model(Config(), name, memory=model.memory).model == model


@pytest.mark.parametrize("name", ["physics", "gauss", "rbf+", "rbf+rbf"])
def test_another_name_is_refused(name):
    with pytest.raises(InputError, match="a sum of"):
        with_model(Config(), name)


def test_a_file_says_which_plant_is_known(tmp_path):
    path = write_correction(tmp_path / "plant.json", Correction("robot", {"mass": 2.0}, ()))
    model = with_model(Config(), "physics+rbf", path, 2).model
    assert model.plant == {
        "format": 1,
        "plant": "robot",
        "parameters": {"mass": 2.0},
        "effects": [],
    }
    assert model.memory == 2
    assert with_model(Config(), delay=0.15).model.delay == 0.15
    path.write_text("{}")
    with pytest.raises(InputError, match="no correction"):
        with_model(Config(), "physics+rbf", path)


def test_a_spread_is_a_recipe_or_what_a_correction_tells(tmp_path):
    recipe = with_model(Config(), "physics+rbf", spread={"mass": 0.1, "f_c": 0.3}).model
    assert recipe.spread == {"mass": 0.1, "f_c": 0.3}
    correction = Correction("robot", {"mass": 2.0}, ())
    path = write_correction(tmp_path / "plant.json", correction)
    with pytest.raises(InputError, match=r"plant.json tells no spread.*recipe"):
        with_model(Config(), "physics+rbf", spread=path)
    member = Member(1.0, {"mass": 2.0}, {"mass": 0.1}, ((1.0,),))
    write_correction(path, dataclasses.replace(correction, spread=(member,)))
    model = with_model(Config(), "physics+rbf", spread=path).model
    assert members_of(model.spread) == (member,)
    assert model.plant["parameters"] == {"mass": 2.0}  # the file's plant is the prior too
    with pytest.raises(InputError, match="choose the mean physics"):
        with_model(Config(), "rbf", spread={"mass": 0.1})


@pytest.mark.parametrize(
    ("given", "algo", "model", "limited", "preset"),
    [
        (None, "mcpilco", None, False, "default"),
        (None, "mcpilco", "features+rbf", False, "default"),
        (None, "mcpilco", "physics+gip+rbf", False, "thorough"),
        (None, "pilco", "physics+rbf", False, "default"),
        ("thesis", "mcpilco", "physics+rbf", False, "thesis"),
        (None, "mcpilco", "rbf", True, "limited"),
        (None, "mcpilco", "physics+rbf", True, "thorough"),
        ("default", "mcpilco", None, True, "default"),
    ],
)
def test_equations_and_limits_are_searched_thoroughly_unless_told(
    given, algo, model, limited, preset
):
    assert suitable_preset(given, algo, model, limited) == preset


def test_algorithms_without_such_a_model_have_no_such_option():
    config = PilcoConfig()
    assert with_model(config) is config
    with pytest.raises(InputError, match="of the algorithm mcpilco"):
        with_model(config, "rbf")
