"""Algorithms by name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mcpilco.agent import algorithms, import_named
from mcpilco.agent.agent import MCPILCO
from mcpilco.sweep import Settings, run_seed
from mcpilco.typing import InputError
from tests.baselines.pilco.models import TINY
from tests.mcpilco.sweep.strange import HERE

ROOT = Path(__file__).parents[3]


def test_the_packages_own_algorithm_is_known():
    assert algorithms.find("mcpilco") is MCPILCO


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
