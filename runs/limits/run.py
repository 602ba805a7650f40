"""Limits while it learns: a cart-pole on a rail of half a metre, with a brake and without limits.

python runs/limits/run.py --seeds 7200:7250              # about 80 s of a core a seed
python runs/limits/run.py --seeds 7200:7210 --free       # beside it: without limits
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from harness import (  # noqa: E402
    fill,
    folder,
    hasty,
    kept,
    once,
    parse_seeds,
    places,
    use_one_thread,
)

import envs  # noqa: E402, F401
from mcpilco.agent import MCPILCO, with_limits  # noqa: E402
from mcpilco.config import PRESETS, Config, Limit  # noqa: E402
from mcpilco.data import Rollout  # noqa: E402
from mcpilco.logbook import Callback  # noqa: E402
from mcpilco.sweep import machine, markdown  # noqa: E402

RAIL = 0.5
TRIALS = 4
EXPERIENCE_S = 6.0, 9.0, 12.0
NAMES = {"limited": "within the limits", "free": "without limits"}


class Explored(Callback):
    def __init__(self) -> None:
        self.rollouts: list[Rollout] = []

    def on_exploration(self, rollout: Rollout) -> None:
        self.rollouts.append(rollout)


def furthest(rollout: Rollout) -> float:
    """The largest distance of the cart from the middle of its rail [m]."""
    return float(np.abs(rollout.shown_states[:, 0]).max())


def crosses(rollout: Rollout) -> bool:
    return furthest(rollout) > RAIL


def trained(seed: int, limited: bool, config: Config, trials: int) -> dict[str, Any]:
    """The outcomes of the rollouts of one training."""
    config = with_limits(config, (Limit("cart_position", -RAIL, RAIL),) if limited else ())
    agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", config=config, seed=seed)
    explored = Explored()
    agent.learn(agent.timesteps_of(trials), callback=explored)
    every = explored.rollouts + [result.rollout for result in agent.results]
    return {
        "seed": seed,
        "explored": [crosses(rollout) for rollout in explored.rollouts],
        "crossed": [crosses(result.rollout) for result in agent.results],
        "furthest_m": [furthest(rollout) for rollout in every],
        "success": [bool(r.success) and not crosses(r.rollout) for r in agent.results],
        "failed": [result.failure for result in agent.results],
        "experience_s": [result.experience_s for result in agent.results],
        "cpu_s": sum(result.cpu_s for result in agent.results),
        "machine": machine(),
    }


def within(result: dict[str, Any], seconds: float) -> bool:
    """Whether the last policy learned from so much experience swung up within the rail."""
    pairs = zip(result["success"], result["experience_s"], strict=True)
    done = [success for success, spent in pairs if spent <= seconds + 1e-6]
    return bool(done) and done[-1]


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    header = ["", "seeds", "rollouts", "crossed", "of them exploring", "furthest [m]"]
    header += ["success after 6 s", "9 s", "12 s", "CPU s a training"]
    rows = []
    for name, found in results.items():
        if not found:
            continue
        exploring = sum(sum(r["explored"]) for r in found)
        crossed = exploring + sum(sum(r["crossed"]) for r in found)
        rollouts = sum(len(r["explored"]) + len(r["crossed"]) for r in found)
        row = [NAMES[name], str(len(found)), str(rollouts)]
        row += [f"{crossed} ({crossed / rollouts:.1%})", str(exploring)]
        row += [f"{max(max(r['furthest_m']) for r in found):.2f}"]
        for seconds in EXPERIENCE_S:
            row.append(f"{sum(within(r, seconds) for r in found)} of {len(found)}")
        row.append(f"{np.median([r['cpu_s'] for r in found]):.0f}")
        rows.append(row)
    return markdown(header, rows)


def write_readme(out: Path) -> None:
    """Put the table of the results that are there into README.md."""
    results = {name: kept(out / "results" / name) for name in NAMES}
    everything = [result for found in results.values() for result in found]
    fill(out / "README.md", [table(results), places(everything)], HERE / "README.md")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="7200:7250")
    parser.add_argument("--free", action="store_true", help="without limits")
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--quick", action="store_true", help="show that it works")
    parser.add_argument("--out", type=Path, help="folder of results/ and README.md")
    arguments = parser.parse_args()
    use_one_thread()
    place = folder(HERE, arguments.out, arguments.quick)
    name = "free" if arguments.free else "limited"
    config = PRESETS["default" if arguments.free else "limited"].config
    config = hasty(config) if arguments.quick else config
    for seed in parse_seeds(arguments.seeds):
        path = place / "results" / name / f"{seed}.json"
        once(path, HERE.name, trained, seed, not arguments.free, config, arguments.trials)
        write_readme(place)  # a stop loses no table


if __name__ == "__main__":
    main()
