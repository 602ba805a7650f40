"""The engine that a configuration names, on a machine with and without numba."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mcpilco.config import Config
from mcpilco.search import batched, engine, fused
from mcpilco.search.engine import rollout_of
from mcpilco.search.particles import rollout
from mcpilco.sensing import LinearObserver
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
config = dataclasses.replace(TINY, engine="fused")
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


def test_without_numba_the_same_is_learned_and_the_log_says_how() -> None:
    without, said = trained('sys.modules["numba"] = None')
    usual, nothing = trained("")
    for mine, its in zip(without, usual, strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-6)
    (line,) = said.splitlines()
    assert line.startswith("mcpilco.search.engine: The compiled loops need numba")
    assert nothing == ""


def same(chosen, expected, single: bool) -> bool:
    return (chosen.func, chosen.keywords) == (expected, {"single": single})


def test_the_compiled_loops_are_the_first_choice(task: TaskSpec) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    assert same(rollout_of(Config(), dynamics, policy), fused.rollout, single=False)
    single = Config(precision="float32")
    assert same(rollout_of(single, dynamics, policy), fused.rollout, single=True)
    assert rollout_of(Config(engine="eager"), dynamics, policy) is rollout


@pytest.mark.parametrize("fast", [fused, batched])
def test_what_the_fast_ones_do_not_know_is_left_to_the_plain_one(
    task: TaskSpec, monkeypatch: pytest.MonkeyPatch, caplog, fast
) -> None:
    monkeypatch.setattr(engine, "_fastest", lambda: fast)
    dynamics = make_dynamics(task)
    assert same(rollout_of(Config(), dynamics, make_policy(task)), fast.rollout, single=False)
    strange = lambda states, dropout=None, step=0: states  # noqa: E731
    assert rollout_of(Config(), dynamics, strange) is rollout
    assert not caplog.messages
    assert rollout_of(Config(precision="float32"), dynamics, strange) is rollout
    assert "in float64" in caplog.text


def test_linear_observers_are_known_to_the_compiled_loops_alone(
    task: TaskSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    estimator = differences(dataclasses.replace(task, measured=(0, 2)))
    observer = LinearObserver(estimator, torch.tensor([0.01, 0.01]).double())
    assert same(rollout_of(Config(), dynamics, policy, observer), fused.rollout, single=False)
    assert rollout_of(Config(), dynamics, policy, SimpleNamespace()) is rollout
    monkeypatch.setattr(engine, "_fastest", lambda: batched)
    assert rollout_of(Config(), dynamics, policy, observer) is rollout
