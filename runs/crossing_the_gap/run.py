"""Policies that cross from a simulation to a system that has what the simulation lacks.

python runs/crossing_the_gap/run.py --quick          # does it run at all?
python runs/crossing_the_gap/run.py                  # seeds 0:20, legs a to d: CPU hours
python runs/crossing_the_gap/run.py --seeds 0:5 --legs a b c d e
python runs/crossing_the_gap/run.py --seeds 100:120 --legs f g

A seed chooses what is hidden, and how large it is. Results are kept in results/seeds/, a file a
seed; the same command goes on where it was stopped, and rewrites README.md between its marked lines
from all results that are there. What a seed has recorded and trained lies in runs/out/crossing.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from crossing_the_gap import pages
from harness import folder, hasty, keep, parse_seeds, use_one_thread

import envs
from mcpilco.config import (
    CART_POLE,
    PRESETS,
    Config,
    ModelConfig,
    PolicyConfig,
    SearchConfig,
)
from mcpilco.crossing import LEGS as LEGS_OF_A_CROSSING
from mcpilco.crossing import (
    CrossingSettings,
    Place,
    Workflow,
    read_crossing,
    remembered_inputs,
)
from mcpilco.data import Stopwatch
from mcpilco.logbook import read_json
from mcpilco.plant import read_correction
from mcpilco.show import run_callbacks
from mcpilco.sweep import Settings, machine, run_seed

HERE = Path(__file__).parent
WORK = Path("runs/out/crossing")
DT = 0.02
"""sampling time of the recordings [s]"""
STEP = 0.1
"""of a policy [s]"""
UNCERTAINTY = 0.05
"""prior std of what the recordings have told [-]"""
FROM_NOTHING = replace(
    PRESETS["default"].config,
    model=ModelConfig(prior_std=None, mirror=60),
    policy=PolicyConfig(span="data", weight=5.0),
    search=SearchConfig(
        particles=96,
        steps=(500,),
        failing=0.05,
        screening=1.0,
        correlations=(0.0, 0.0, 0.0, 0.8),
    ),
    excitation="random",
    precision="float64",
)
"""the preset default as it was when leg c was run first"""
TRIALS = {"from nothing": 5, "with a prior": 3}
"""policies to learn on the system, in legs c and d"""
SAC_TRIALS = 34
"""of 600 steps each: 34 min of experience in each simulation"""
KINDS = ("friction and lag", "stiction and delay", "tilt, drag and a wrong mass")
SHORT_S, SHORT_TRIALS = 20.0, 2
"""of recordings in legs f and g [s], and policies that are learned there"""
LEGS = ("a", "b", "c", "d", "e", "f", "g")
Leg = Literal["a", "b", "c", "d", "e", "f", "g"]


@dataclass(frozen=True)
class Arguments:
    """Cross from many seeds, and write the tables."""

    seeds: str = "0:20"
    """`0:20` are 0 to 19"""
    legs: tuple[Leg, ...] = ("a", "b", "c", "d")
    """a, b: trained in the nominal and in the corrected simulation; c: on the system alone; d: on
    the system, with the corrected simulation as the model's mean; e: as a and b, by SAC; f, g: in
    the simulation that 20 s of recordings correct, over its posterior and at its mean"""
    quick: bool = False
    """one seed that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    seeds = parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]
    for seed in seeds:
        path = out / "results" / "seeds" / f"{seed:04d}.json"
        found = read_json(path) if path.exists() else begun(seed)
        for leg in arguments.legs:
            if leg not in found["legs"]:
                found["legs"][leg] = LEARN[leg](seed, found, work(seed, arguments.quick))
                keep(path, found, HERE.name, continued=path.exists())
                print(
                    f"seed {seed}, {found['kind']}, {leg}: {told(found['legs'][leg])}", flush=True
                )
        pages.write(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return 0


# What is hidden -----------------------------------------------------------------------------------


def begun(seed: int) -> dict[str, Any]:
    """What a seed hides, and nothing learned yet."""
    kind = KINDS[seed % len(KINDS)]
    return {
        "seed": seed,
        "kind": kind,
        "hidden": hidden(kind, np.random.default_rng([seed, 77])),
        "machine": machine(),
        "legs": {},
    }


def hidden(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """The correction that makes the system of the nominal cart-pole."""

    def drawn(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    def effect(name: str, target: str, **parameters: float) -> dict[str, Any]:
        return {"name": name, "target": target, "parameters": parameters}

    if kind == "friction and lag":
        effects = [
            effect("coulomb_friction", "cart", f_c=drawn(0.8, 2.0)),
            effect("actuator_lag", "actuator", T=drawn(0.03, 0.08)),
        ]
    elif kind == "stiction and delay":
        effects = [
            effect("stribeck_friction", "cart", f_c=drawn(0.6, 1.2), f_d=drawn(0.4, 1.0), v_s=0.1),
            effect("actuator_delay", "actuator", d=drawn(0.03, 0.09)),
        ]
    else:
        effects = [
            effect("constant_force", "cart", f_0=float(rng.choice([-1.0, 1.0])) * drawn(1.0, 2.5)),
            effect("quadratic_drag", "cart", c=drawn(0.3, 1.0)),
            effect("body_mass", "pole", m_d=drawn(0.1, 0.25)),
        ]
    return {"format": 1, "plant": CART_POLE, "parameters": {}, "effects": effects}


# The legs -----------------------------------------------------------------------------------------


def work(seed: int, quick: bool) -> Path:
    """Where the recordings and trainings of a seed lie."""
    return (WORK / "quick" if quick else WORK) / f"{seed:04d}"


def crossed(algo: str, leg: str) -> Callable[[int, Mapping[str, Any], Path], dict[str, Any]]:
    """What came of the policy of one simulation; the command trains in both."""

    def learn(seed: int, found: Mapping[str, Any], path: Path) -> dict[str, Any]:
        watch = Stopwatch()
        place = path if algo == "mcpilco" else path.with_name(f"{path.name}-{algo}")
        trials = {"trials": SAC_TRIALS} if algo == "sac" else {}
        few = {"trials": 1, "episodes": 3} if "quick" in path.parts else trials
        settings = CrossingSettings(
            system=Place(CART_POLE, {"effects": found["hidden"]}),
            simulation=Place(CART_POLE, {}),
            dt=DT,
            algo=algo,
            spread=False,
            seed=seed,
            **few,
        )
        work = Workflow(place / "crossing", settings, envs.PLANTS[CART_POLE]())
        work.begin()
        work.record()
        work.correct()
        work.require_corrected()
        for name in LEGS_OF_A_CROSSING:
            work.train(name, run_callbacks)
            work.attempt(name)
        outcome = read_crossing(place / "crossing" / f"{leg}.json")
        gap = read_json(place / "crossing" / "gap" / "gap.json")
        return {
            "promised": outcome.promised.success,
            "happened": outcome.happened.success,
            "return": outcome.happened.returns,
            "experience_s": settings.seconds if leg == "corrected" else 0.0,
            "verdict": gap["verdict"],
            "named": [f"{effect['name']} at {effect['target']}" for effect in gap["effects"]],
            "cpu_s": watch.read().cpu_s,
        }

    return learn


def by_sac(seed: int, found: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Both simulations, by SAC."""
    return {leg: crossed("sac", leg)(seed, found, path) for leg in ("nominal", "corrected")}


def from_few(spread: bool) -> Callable[[int, Mapping[str, Any], Path], dict[str, Any]]:
    """The outcome of a policy of a simulation that 20 s of recordings have corrected."""

    def learn(seed: int, found: Mapping[str, Any], path: Path) -> dict[str, Any]:
        watch = Stopwatch()
        settings = CrossingSettings(
            system=Place(CART_POLE, {"effects": found["hidden"]}),
            simulation=Place(CART_POLE, {}),
            seconds=SHORT_S,
            rollouts=4,
            dt=DT,
            spread=spread,
            seed=seed,
            **({"trials": 1, "episodes": 3} if "quick" in path.parts else {"trials": SHORT_TRIALS}),
        )
        folders = [path / f"short-{name}" for name in ("posterior", "mean")]
        ours, other = folders if spread else folders[::-1]
        work = Workflow(ours, settings, envs.PLANTS[CART_POLE]())
        work.begin()
        for name in ("recordings", "gap"):  # alike for both, which are searched once
            if (other / name).exists() and not (ours / name).exists():
                shutil.copytree(other / name, ours / name)
        work.record()
        work.correct()
        work.require_corrected()
        work.train("corrected", run_callbacks)
        outcome = work.attempt("corrected")
        gap = read_json(ours / "gap" / "gap.json")
        return {
            "promised": outcome.promised.success,
            "happened": outcome.happened.success,
            "return": outcome.happened.returns,
            "experience_s": SHORT_S,
            "verdict": gap["verdict"],
            "named": [f"{effect['name']} at {effect['target']}" for effect in gap["effects"]],
            "cpu_s": watch.read().cpu_s,
        }

    return learn


def on_the_system(seed: int, found: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """MC-PILCO on the system, from nothing."""
    return learned(FROM_NOTHING, TRIALS["from nothing"], seed, found, path)


def with_prior(seed: int, found: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """MC-PILCO on the system, with the corrected simulation as its model's mean."""
    folder = path / "crossing"
    model = ModelConfig(
        kernel="rbf",
        mean="physics",
        plant=read_json(folder / "prior.json"),
        uncertainty=UNCERTAINTY,
        memory=remembered_inputs(read_correction(folder / "gap" / "corrected.json"), STEP),
    )
    config = replace(PRESETS["thorough"].config, model=model)
    return learned(config, TRIALS["with a prior"], seed, found, path)


def learned(
    config: Config, trials: int, seed: int, found: Mapping[str, Any], path: Path
) -> dict[str, Any]:
    """Success of each trial's policy, by the experience behind it."""
    few = "quick" in path.parts
    settings = Settings(
        env=f"envs:{CART_POLE}",
        env_kwargs={"effects": found["hidden"]},
        config=hasty(config) if few else config,
        trials=1 if few else trials,
        fresh=3 if few else 100,
    )
    result = run_seed(settings, seed)
    return {
        "experience_s": [trial["experience_s"] for trial in result["trials"]],
        "p": [trial["p"] for trial in result["trials"]],
        "cpu_s": sum(trial["cpu_s"] for trial in result["trials"]),
    }


LEARN: Mapping[str, Callable[[int, Mapping[str, Any], Path], dict[str, Any]]] = {
    "a": crossed("mcpilco", "nominal"),
    "b": crossed("mcpilco", "corrected"),
    "c": on_the_system,
    "d": with_prior,
    "e": by_sac,
    "f": from_few(True),
    "g": from_few(False),
}


def told(outcome: Mapping[str, Any]) -> str:
    if "p" in outcome:
        return "success " + ", ".join(f"{100 * p:.0f} %" for p in outcome["p"])
    if "happened" in outcome:
        return f"promised {100 * outcome['promised']:.0f} %, was {100 * outcome['happened']:.0f} %"
    return "; ".join(f"{leg}: {told(found)}" for leg, found in outcome.items())


if __name__ == "__main__":
    sys.exit(main())
