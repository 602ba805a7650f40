"""The engine that a configuration names, where its loops can be had, and where not."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from mcpilco.config import Config
from mcpilco.dynamics import PathwisePosterior
from mcpilco.search import engine, fused
from mcpilco.search.engine import compiled_before, rollout_of
from mcpilco.search.particles import rollout
from mcpilco.sensing import Observer, PastInputs
from mcpilco.sensing.estimator import differences
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics, make_policy

ROOT = Path(__file__).parents[3]
TRAIN = """
import dataclasses, logging, sys
{before}
logging.basicConfig(format="%(name)s: %(message)s")
from mcpilco.agent.agent import MCPILCO
from tests.mcpilco.point import STEPS, TINY, PointEnv
config = dataclasses.replace(TINY, engine="fused", precision="float64")
agent = MCPILCO("SumOfGaussians", PointEnv(), config=config).learn(3 * STEPS)
print(*(result.predicted_cost for result in agent.results))
print(*agent.policy.weights.flatten().tolist())
"""


def trained(before: str) -> tuple[list[list[float]], str]:
    """What a process of its own learns, and what it logs."""
    done = subprocess.run(
        [sys.executable, "-c", TRAIN.format(before=before)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return [
        [float(word) for word in line.split()] for line in done.stdout.splitlines()
    ], done.stderr


@pytest.mark.slow
def test_without_compiled_loops_the_same_is_learned_and_the_log_says_how() -> None:
    without, said = trained('sys.modules["mcpilco.search.fused.tiles"] = None')
    usual, nothing = trained("")
    for mine, its in zip(without, usual, strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-6)
    (line,) = said.splitlines()
    assert line.startswith("mcpilco.search.engine: The compiled loops cannot be had")
    assert nothing == ""


def same(chosen, expected, single: bool) -> bool:
    return (chosen.func, chosen.keywords) == (expected, {"single": single})


def test_the_compiled_loops_are_the_first_choice(task: TaskSpec) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    assert same(rollout_of(Config(), dynamics, policy), fused.rollout, single=True)
    double = Config(precision="float64")
    assert same(rollout_of(double, dynamics, policy), fused.rollout, single=False)
    assert rollout_of(Config(engine="eager"), dynamics, policy) is rollout


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    """The log, of a process that has not warned of anything yet."""
    engine._warn_once.cache_clear()
    return caplog


def test_a_fall_back_to_plain_torch_is_warned_of_once_by_name(task: TaskSpec, said) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    zeros = torch.zeros(4, dtype=torch.float64)
    strange = lambda states, dropout=None, step=0: states  # noqa: E731
    assert rollout_of(Config(), dynamics, policy) is not rollout
    assert not said.messages
    for dynamics_, policy_, observer, word in (
        (dynamics, strange, None, "the policy function"),
        (PathwisePosterior(dynamics), policy, None, "the model PathwisePosterior"),
        (dynamics, policy, Observer(PastInputs(1, 2), zeros), "the estimator PastInputs"),
    ):
        for _ in range(2):
            assert rollout_of(Config(), dynamics_, policy_, observer) is rollout
        (sentence,) = said.messages
        assert word in sentence
        assert "plain torch, in float64, several times slower" in sentence
        said.clear()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_plain_rollout_takes_any_precision_without_a_word(
    task: TaskSpec, said, precision: Literal["float32", "float64"]
) -> None:
    config = Config(engine="eager", precision=precision)
    assert rollout_of(config, make_dynamics(task), make_policy(task)) is rollout
    assert not said.messages


def test_without_compiled_loops_all_is_rolled_out_in_torch(
    task: TaskSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_compiled_loops", lambda: None)
    assert rollout_of(Config(), make_dynamics(task), make_policy(task)) is rollout


def test_linear_observers_are_known_to_the_compiled_loops(task: TaskSpec) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    estimator = differences(dataclasses.replace(task, measured=(0, 2)))
    observer = Observer(estimator, torch.tensor([0.01, 0.01]).double(), estimator.C)
    assert same(rollout_of(Config(), dynamics, policy, observer), fused.rollout, single=True)


def test_compiled_code_that_is_newer_than_its_source_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mcpilco.search.fused.forward import forward

    monkeypatch.setattr(forward._cache, "_cache_path", str(tmp_path))
    assert not compiled_before()
    (tmp_path / "forward.nbi").touch()
    assert compiled_before()
