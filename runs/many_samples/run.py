"""Thousands of samples: time and memory with exact GPs and through inducing points, and success.

python runs/many_samples/run.py --cost               # minutes
python runs/many_samples/run.py --seeds 8030:8040    # about a minute of a core a seed
python runs/many_samples/run.py --beside 8040:8048   # as long: exact GPs and inducing points
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from harness import (  # noqa: E402
    fill,
    folder,
    hasty,
    keep,
    kept,
    once,
    parse_seeds,
    places,
    use_one_thread,
)

import envs  # noqa: E402, F401
from mcpilco.agent import MCPILCO  # noqa: E402
from mcpilco.config import Config  # noqa: E402
from mcpilco.search import Adam, PolicySearch  # noqa: E402
from mcpilco.sweep import machine, markdown  # noqa: E402

SAMPLES = 2850
BESIDE = 1000
"""samples of which exact GPs still learn a policy in minutes"""
TRIALS = 3
SIZES = (150, 600, 1000, 3000)
SEED = 20
STEPS = 3


def agent_of(seed: int, samples: int, config: Config) -> MCPILCO:
    config = replace(config, exploration=samples)
    return MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", config=config, seed=seed)


def resident_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def cost(samples: int, inducing: int) -> dict[str, Any]:
    """Time and memory of an agent's fit and of a policy step."""
    agent = agent_of(SEED, samples, through(Config(), inducing))
    agent._explore()
    before, began = resident_mb(), time.process_time()
    values = agent.model.fit(agent.transitions)
    fitted = time.process_time()
    problem = agent._problem(1, None)
    conditioned = time.process_time()
    search = PolicySearch(agent.config.search, torch.Generator().manual_seed(0))
    policy = agent._random_policy(search.generator)
    adam, times = Adam(policy), []
    for _ in range(STEPS + 1):
        start = time.process_time()
        search.step(problem, policy, adam, 0.01, 0.25)
        times.append(time.process_time() - start)
    return {
        "samples": samples,
        "through": values.get("model/inducing_points"),
        "fit_s": fitted - began,
        "condition_s": conditioned - fitted,
        "step_s": float(np.median(times[1:])),
        "memory_mb": resident_mb() - before,
        "machine": machine(),
    }


def in_a_process(samples: int, inducing: int) -> dict[str, Any]:
    """The cost of one size, measured in a process of its own."""
    command = [sys.executable, __file__, "--one", str(samples), str(inducing)]
    line = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(line.splitlines()[-1])


def through(config: Config, inducing: int) -> Config:
    """The same, with so many inducing points; half as many as the samples or more are exact GPs."""
    return replace(config, model=replace(config.model, inducing=inducing))


def trained(seed: int, config: Config, samples: int, trials: int) -> dict[str, Any]:
    """Whether the policies swing up that are learned from so many samples."""
    agent = agent_of(seed, samples, config)
    agent.learn(agent.timesteps_of(trials))
    return {
        "seed": seed,
        "samples": samples,
        "success": [bool(result.success) for result in agent.results],
        "cpu_s": [result.cpu_s for result in agent.results],
        "predicted_cost": [result.predicted_cost for result in agent.results],
        "real_cost": [result.real_cost for result in agent.results],
        "machine": machine(),
    }


def beside(seed: int, config: Config, samples: int) -> dict[str, Any]:
    """The first policy of exact GPs, and that of the same samples through inducing points."""
    ways = {"exact": samples, "through": config.model.inducing}
    found = {way: trained(seed, through(config, few), samples, 1) for way, few in ways.items()}
    same = found["exact"]
    told = {name: same[name] for name in ("seed", "samples", "machine")}
    return told | {
        name: {way: result[name][0] for way, result in found.items()}
        for name in same
        if name not in told
    }


def cost_table(found: list[dict[str, Any]]) -> str:
    header = ["samples", "GPs", "fit [CPU s]", "condition [CPU s]", "a policy step [ms]"]
    rows = []
    for result in sorted(found, key=lambda r: (r["samples"], r["through"] or 0)):
        way = "exact" if result["through"] is None else f"through {result['through']:.0f}"
        times = f"{result['fit_s']:.1f}", f"{result['condition_s']:.2f}"
        row = [f"{result['samples']:,}", way, *times, f"{1000 * result['step_s']:.0f}"]
        rows.append([*row, f"{result['memory_mb']:.0f}"])
    return markdown([*header, "memory [MB]"], rows)


def success_table(found: list[dict[str, Any]]) -> str:
    rows = []
    for trial in range(max((len(r["success"]) for r in found), default=0)):
        done = [r for r in found if len(r["success"]) > trial]
        swung = sum(r["success"][trial] for r in done)
        cpu = np.median([r["cpu_s"][trial] for r in done])
        rows.append([str(trial + 1), f"{swung} of {len(done)}", f"{cpu:.0f}"])
    return markdown(["policy", "swung up", "CPU s"], rows)


def beside_table(found: list[dict[str, Any]]) -> str:
    rows = []
    for way, name in {"exact": "exact", "through": "through 300"}.items():
        swung = sum(r["success"][way] for r in found)
        numbers = [np.median([r[key][way] for r in found]) for key in ("real_cost", "cpu_s")]
        rows.append([name, f"{swung} of {len(found)}", f"{numbers[0]:.1f}", f"{numbers[1]:.0f}"])
    return markdown(["GPs", "swung up", "cost of the rollout", "CPU s"], rows if found else [])


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    costs = kept(out / "results" / "cost")
    successes = kept(out / "results" / "success")
    both = kept(out / "results" / "beside")
    parts = ["### Time and memory", cost_table(costs), "### Success", success_table(successes)]
    parts += [f"### The first policy of {BESIDE:,} samples, both ways", beside_table(both)]
    fill(out / "README.md", [*parts, places([*costs, *successes, *both])], HERE / "README.md")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", help="of trainings, such as 8000:8010")
    parser.add_argument("--beside", help="seeds of trainings with exact GPs and through few")
    parser.add_argument("--cost", action="store_true", help="time and memory of all sizes")
    parser.add_argument("--one", nargs=2, type=int, help="samples and inducing points of one size")
    parser.add_argument("--quick", action="store_true", help="show that it works")
    parser.add_argument("--out", type=Path, help="folder of results/ and README.md")
    arguments = parser.parse_args()
    use_one_thread()
    if arguments.one:
        print(json.dumps(cost(*arguments.one)))
        return
    place = folder(HERE, arguments.out, arguments.quick)
    sizes = (60,) if arguments.quick else SIZES
    few = 20 if arguments.quick else Config().model.inducing
    if arguments.cost:
        in_a_process(60, 60)  # compiles, which takes memory too
        for size in sizes:
            for inducing in (size, few) if size > 2 * few else (size,):
                path = place / "results" / "cost" / f"{size}-{inducing}.json"
                keep(path, in_a_process(size, inducing), HERE.name)
    config = through(hasty(Config()), few) if arguments.quick else Config()
    for seed in parse_seeds(arguments.seeds) if arguments.seeds else ():
        path = place / "results" / "success" / f"{seed}.json"
        most = 60 if arguments.quick else SAMPLES
        once(path, HERE.name, trained, seed, config, most, TRIALS)
    for seed in parse_seeds(arguments.beside) if arguments.beside else ():
        path = place / "results" / "beside" / f"{seed}.json"
        once(path, HERE.name, beside, seed, config, 60 if arguments.quick else BESIDE)
    write_readme(place)


if __name__ == "__main__":
    main()
