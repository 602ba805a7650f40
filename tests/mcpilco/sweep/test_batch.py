"""Seeds in a batch end as each ends alone, and lose no other."""

from __future__ import annotations

import dataclasses
import json

import pytest
import torch

import mcpilco.agent.lockstep
from mcpilco.sweep import BatchEngine, Failure, Settings, SweepFolder, sweep
from mcpilco.sweep.batch import usable_device
from mcpilco.sweep.job import SeedJob, run_seed
from mcpilco.typing import InputError
from tests.mcpilco.sweep.strange import HERE, TINY

RESTARTING = dataclasses.replace(
    TINY, search=dataclasses.replace(TINY.search, restarts=(1,), failing=0.6)
)
CART_POLE = Settings(
    "envs:mcpilco/CartPoleSwingUp-v0",
    {"max_episode_steps": 8},
    config=RESTARTING,
    trials=2,
    fresh=3,
)
POINT = Settings(f"{HERE}:Sweep/Point-v0", config=TINY, trials=2, fresh=2)
UNLUCKY = dataclasses.replace(POINT, env=f"{HERE}:Sweep/Unlucky-v0", fresh=0)
CHANGING = ("cpu_s", "wall_s")


def run(settings, seeds, size=64):
    outcomes = {}

    def on_result(seed, outcome):
        assert seed not in outcomes
        outcomes[seed] = outcome

    jobs = {seed: SeedJob(settings, seed) for seed in seeds}
    BatchEngine("cpu", size).run(jobs, on_result)
    assert outcomes.keys() == set(seeds)
    return outcomes


@pytest.mark.parametrize("size", [2, 64])
def test_a_seed_in_a_batch_ends_as_it_ends_alone(size):
    for seed, outcome in run(CART_POLE, range(3), size).items():
        alone = run_seed(CART_POLE, seed)
        assert outcome["seed"] == seed
        for mine, its in zip(outcome["trials"], alone["trials"], strict=True):
            assert mine.pop("noise_std") == pytest.approx(its.pop("noise_std"), rel=1e-6)
            assert {k: v for k, v in mine.items() if k not in CHANGING} == pytest.approx(
                {k: v for k, v in its.items() if k not in CHANGING}, rel=1e-6
            )
            assert mine["cpu_s"] >= 0


def test_a_result_is_json_and_names_the_device():
    (outcome,) = run(POINT, [3]).values()
    assert json.loads(json.dumps(outcome, allow_nan=False)) == outcome
    assert outcome["machine"]["device"] == "cpu"


def test_a_seed_that_fails_loses_no_other():
    outcomes = run(UNLUCKY, range(3))
    assert isinstance(outcomes[1], Failure)
    assert outcomes[1].reason.startswith("EnvError: The env raised ValueError at step 1: no luck")
    assert "in step" in outcomes[1].details
    assert [len(outcomes[seed]["trials"]) for seed in (0, 2)] == [2, 2]


def test_a_search_that_fails_loses_its_batch_and_the_next_one_goes_on(monkeypatch):
    search = mcpilco.agent.lockstep.search_together

    def weak(requests, device):
        if len(requests) == 2:
            raise MemoryError("too much")
        return search(requests, device)

    monkeypatch.setattr(mcpilco.agent.lockstep, "search_together", weak)
    outcomes = run(POINT, range(3), size=2)
    assert [outcomes[seed].reason for seed in (0, 1)] == ["MemoryError: too much"] * 2
    assert len(outcomes[2]["trials"]) == 2


def test_a_sweep_in_batches_goes_on_where_it_was_stopped(tmp_path):
    told = []

    def interrupt(seed, outcome):
        told.append(seed)
        if len(told) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(POINT, range(4), tmp_path, BatchEngine("cpu", 2), interrupt)
    assert list(SweepFolder(tmp_path, POINT).results()) == [0, 1]
    rest = []
    summary = sweep(
        POINT, range(4), tmp_path, BatchEngine("cpu", 3), lambda seed, _: rest.append(seed)
    )
    assert rest == [2, 3]
    assert summary["seeds"] == [0, 1, 2, 3]


def test_no_jobs_are_no_work():
    assert run(POINT, []) == {}


def test_a_batch_holds_a_seed_at_least():
    with pytest.raises(InputError, match="at least 1 seed, got 0"):
        BatchEngine("cpu", 0)


@pytest.mark.parametrize("name", ["abacus", "", "cpu:x", "meta"])
def test_a_device_that_computes_nothing_is_refused(name):
    with pytest.raises(InputError, match="expected a device that torch can use here.*got"):
        usable_device(name)


def test_missing_cuda_is_explained(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="expected .* got 'cuda', .* no CUDA; install"):
        BatchEngine()
