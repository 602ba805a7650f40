from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from mcpilco.sweep import Failure, LocalEngine, RayEngine
from mcpilco.sweep.engines import available_cores
from mcpilco.typing import InputError
from tests.mcpilco.sweep import work


def run(jobs, workers=2):
    outcomes = {}

    def on_result(number, outcome):
        assert number not in outcomes
        outcomes[number] = outcome

    LocalEngine(workers).run(jobs, on_result)
    return outcomes


def test_every_job_is_done_once_and_a_lost_one_loses_no_other():
    jobs = {
        1: work.die,
        2: work.fail,
        3: work.leave,
        4: work.nothing,
        **{number: partial(work.square, number) for number in (5, 6)},
    }
    outcomes = run(jobs)
    assert (outcomes[4], outcomes[5], outcomes[6]) == (None, 25, 36)
    assert outcomes[1].reason == "its process was killed by SIGKILL"
    assert outcomes[2].reason == "ValueError: no luck"
    assert "in fail" in outcomes[2].details
    assert "exit code 3" in outcomes[3].reason
    assert outcomes.keys() == jobs.keys()


def test_each_job_has_a_process_of_its_own():
    outcomes = run(dict.fromkeys(range(3), work.process), workers=1)
    assert len({os.getpid(), *outcomes.values()}) == 4


def test_no_process_outlives_an_interrupt():
    def interrupt(number, outcome):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        LocalEngine(2).run({1: work.wait_for_ever, 2: work.nothing}, interrupt)
    assert not multiprocessing.active_children()


def announcing(path):
    """A sweep of one job, which says its process and never ends."""
    LocalEngine(1).run({1: partial(work.announce, path)}, lambda number, outcome: None)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_its_sweep_that_is_killed(tmp_path, number):
    path = tmp_path / "pid"
    sweep = multiprocessing.get_context("spawn").Process(target=announcing, args=(path,))
    sweep.start()
    assert eventually(path.exists)
    worker = int(path.read_text())
    os.kill(sweep.pid, number)
    sweep.join()
    assert eventually(lambda: not alive(worker))


def alive(pid):
    """Whether a process runs; one that has ended and that nobody asked about does not."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def eventually(true, seconds=30.0):
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.05)
    return true()


def test_no_jobs_are_no_work():
    assert run({}) == {}


def test_workers_are_the_cores_unless_told():
    assert LocalEngine().workers == available_cores() >= 1
    with pytest.raises(InputError, match="workers must be at least 1, got 0"):
        LocalEngine(0)


def test_missing_ray_is_explained(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="pip install"):
        RayEngine()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "head:port", "no such"])
def test_an_address_without_a_cluster_is_refused(monkeypatch, address):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", address)
    with pytest.raises(InputError, match="There is no Ray cluster at RAY_ADDRESS="):
        RayEngine().run({1: work.nothing}, lambda *_: None)


@pytest.fixture
def cluster(monkeypatch):
    """Two Ray nodes of one core each, under RAY_ADDRESS; the second may be taken away."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    options = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    made = Cluster(initialize_head=True, head_node_args={**options, "include_dashboard": False})
    second = made.add_node(**options)
    monkeypatch.setenv("RAY_ADDRESS", made.address)
    yield ray, partial(made.remove_node, second, allow_graceful=False)
    ray.shutdown()
    made.shutdown()


@pytest.mark.slow
def test_a_lost_node_loses_no_seed(cluster, tmp_path):
    from mcpilco.sweep import Settings, SweepFolder, sweep
    from tests.mcpilco.sweep.strange import HERE, TINY

    ray, lose_node = cluster
    alive = []

    def on_result(seed, outcome):
        assert not isinstance(outcome, Failure), outcome
        if not alive:  # the first result: the other node is at work
            alive.append(sum(node["Alive"] for node in ray.nodes()))
            lose_node()
        alive.append(sum(node["Alive"] for node in ray.nodes()))

    settings = Settings(f"{HERE}:Sweep/Point-v0", config=TINY, trials=1, fresh=2)
    summary = sweep(settings, range(6), tmp_path / "sweep", RayEngine(), on_result)
    assert (alive[0], alive[-1]) == (2, 1)
    assert summary["seeds"] == list(range(6))
    assert SweepFolder(tmp_path / "sweep", settings).results().keys() == set(range(6))


@pytest.mark.slow
def test_ray_reports_a_job_that_raises_or_dies_and_does_the_others(cluster):
    outcomes = {}
    jobs = {1: work.fail, 2: work.die, 3: partial(work.square, 3)}
    RayEngine(retries=1).run(jobs, outcomes.__setitem__)
    assert outcomes[1].reason == "ValueError: no luck"
    assert "lost it 2 times" in outcomes[2].reason
    assert outcomes[3] == 9
