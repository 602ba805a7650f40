"""Four priors of one agent: an arm's parameters from a drawing, and from noisy recordings.

python runs/identified_prior/run.py --quick               # does it run at all?
python runs/identified_prior/run.py                       # all priors, seeds 3000:3010: CPU hours
python runs/identified_prior/run.py --priors eiv --seeds 3000:3002

Results are kept in results/<prior>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, hasty, kept, once, parse_seeds, places, use_one_thread

import envs
from envs import SwingUp
from envs.arms import record_sinusoids
from envs.double_pendulum import DoublePendulumEnv
from envs.plants import register_env
from mcpilco import MCPILCO
from mcpilco.config import Config, ModelConfig, Phase, PolicyConfig, SearchConfig
from mcpilco.identification import (
    Identified,
    Recipe,
    correction_of_identified,
    identify,
    random_motions,
    theta_of,
)
from mcpilco.logbook import versions
from mcpilco.mjcf import mjcf_of_plant
from mcpilco.plant import ChainPlant, correction_json, correction_of
from mcpilco.policies import SaturatingCost
from mcpilco.recordings import Recording, load_robot, read_robot, write_recording
from mcpilco.sweep import (
    FreshEpisodes,
    machine,
    markdown,
    mean,
    mean_cell,
    spread,
    spread_cell,
)

HERE = Path(__file__).parent
ENV, PLANT = "runs/Arm-v0", "mcpilco/DoublePendulum-v0"
TRIALS = 3
"""policies to learn, the last one from 6 s"""
FRESH = 50
"""episodes that each is judged by"""
WRONG = 0.2
"""a mass of the drawing is wrong by up to this part of it, in either direction"""
CONFIG = Config(
    policy=PolicyConfig(lengthscale=8.0, squash=1.0, weight=0.3, span="data"),
    search=SearchConfig(
        particles=48,
        evaluation_particles=96,
        steps=(500,),
        restarts=(1,),
        screening=1.0,
        rates=(1.0, 1.0, 0.7, 0.5, 0.3),
        failing=0.02,
        phases=(Phase(0.04, until=0.5), Phase(0.02, until=0.75), Phase(0.008)),
        widening=2.0,
        correlations=(0.0,),
    ),
    excitation="random",
)
"""that with which this page was planned; the preset `default` has other numbers since then"""
MASSES = ("upper_mass", "lower_mass")
NOISE = 0.01
"""of the encoders in the recordings [rad]"""
CUTOFF = 12.0
"""of the filter of the recordings [Hz]"""
SECONDS, FILES = 15.0, 3
"""of a recording [s], and how many there are"""


class ArmEnv(DoublePendulumEnv):
    """Two links with a motor in each joint, too weak to lift the arm without a swing."""

    nominal = SwingUp(
        plant=envs.PLANTS[PLANT](),
        input_limit=1.5,
        dt=0.05,
        start_std=0.01,
        noise_std=(0.001, 0.02, 0.001, 0.02),
        cost=SaturatingCost((0, 2), (math.pi, 0.0), (1.5, 0.75), (True, True)),
        links=(0, 2),
    )


register_env(ENV, ArmEnv, steps=50)

PRIORS: Mapping[str, Recipe | None] = {
    "drawing": None,
    "least-squares": Recipe("OLS", "none"),
    "ting": Recipe("VB b_true", "virtual"),
    "eiv": Recipe("EIV", "pseudo-inertia"),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "3000:3010"
    """`3000:3010` are 3000 to 3009"""
    priors: tuple[Literal[*PRIORS], ...] = tuple(PRIORS)
    """which of them"""
    quick: bool = False
    """one seed, one trial, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    seeds, trials = parse_seeds(arguments.seeds), TRIALS
    if arguments.quick:
        seeds, trials = seeds[:1], 1
    for seed in seeds:
        for name in arguments.priors:
            path = out / "results" / name / f"{seed:04d}.json"
            config = hasty(CONFIG) if arguments.quick else CONFIG
            if result := once(path, HERE.name, learned, name, config, seed, trials):
                write_readme(out)
                shares = ", ".join(f"{row['p']:.2f}" for row in result["trials"])
                print(f"{name}, seed {seed}: p {shares}", flush=True)
    write_readme(out)
    return 0


def learned(name: str, config: Config, seed: int, trials: int) -> dict[str, Any]:
    """The trials of a seed with a prior, as JSON."""
    drawing = drawn(seed)
    model, error = ModelConfig(kernel="rbf", mean="physics"), None
    described = correction_json(correction_of(drawing))
    if (recipe := PRIORS[name]) is not None:
        found = identified(drawing, recipe, seed)
        described = correction_json(correction_of_identified(drawing, found))
        model, error = replace(model, uncertainty="told", plant=described), wrong_by(found)
    config = replace(config, model=replace(model, plant=described))
    agent = MCPILCO("SumOfGaussians", ENV, config=config, seed=seed)
    rows: list[dict[str, Any]] = []
    with FreshEpisodes(ENV, {}, FRESH, agent.horizon) as judge:
        for trial in range(1, trials + 1):
            agent.learn(agent.timesteps_of(1))
            fresh, result = judge.outcomes(agent.controller, seed, trial), agent.results[-1]
            told = {k: getattr(result, k) for k in ("experience_s", "predicted_cost", "real_cost")}
            told |= {"cpu_s": result.cpu_s, "success": bool(result.success)}
            rows.append({"trial": trial, "p": float(fresh["is_success"].mean()), **told})
    about = {"seed": seed, "machine": machine(), "versions": versions()}
    prior = described.get("spread") or described["parameters"]
    return {**about, "prior": prior, "error": error, "trials": rows}


def drawn(seed: int) -> ChainPlant:
    """The plant as its drawing has it: its masses are wrong."""
    rng, plant = np.random.default_rng([seed, 7]), envs.PLANTS[PLANT]()
    wrong = {m: plant.values[m] * (1.0 + float(rng.uniform(-WRONG, WRONG))) for m in MASSES}
    return plant.where(**wrong)


def identified(drawing: ChainPlant, recipe: Recipe, seed: int) -> Identified:
    """The parameters found in recordings of the true arm, by a model of the right kinematics."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place)
        (path / "arm.xml").write_text(mjcf_of_plant(drawing))
        robot, files = load_robot(path / "arm.xml"), [path / f"{k}.csv" for k in range(FILES)]
        for k, file in enumerate(files):
            write_recording(file, recorded(np.random.default_rng([seed, 8, k])))
        segments, _, _ = read_robot(files, robot)
        return identify(robot, segments, recipe, terms=("viscous",), cutoff=CUTOFF, seed=seed)


def recorded(rng: np.random.Generator) -> Recording:
    """Sinusoids of the true arm under feedback, as its sensors tell them."""
    plant = envs.PLANTS[PLANT]()
    model = mujoco.MjModel.from_xml_string(mjcf_of_plant(plant))
    frictions = ("shoulder_friction", "elbow_friction")
    model.dof_damping[:] = [plant.values[name] for name in frictions]
    model.jnt_range[:], model.actuator_ctrlrange[:] = (-2.0, 2.0), (-10.0, 10.0)
    return record_sinusoids(model, rng, seconds=SECONDS, encoder_std=NOISE)


def wrong_by(found: Identified) -> list[float]:
    """Error of the forces of random motions, relative to them, joint by joint [-]."""
    body = found.body
    true = theta_of(envs.PLANTS[PLANT](), body)
    Y = body.regressor(*random_motions(body, 300, np.random.default_rng(0)))
    error, force = Y @ (found.theta - true), Y @ true
    return np.sqrt((error**2).mean(0) / (force**2).mean(0)).tolist()


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {name: kept(out / "results" / name) for name in PRIORS}
    found = {name: results for name, results in found.items() if results}
    everyone = [result for results in found.values() for result in results]
    told = [table(found), "`eiv` less each of the others, seed by seed:", against(found)]
    parts = [*told, places(everyone, ", one thread")] if everyone else ["Not measured yet."]
    fill(out / "README.md", parts, template=HERE / "README.md")


def table(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Success over fresh rollouts by experience: a row a prior."""
    longest = max((results[0]["trials"] for results in found.values()), key=len)
    header = ["prior", "seeds", "forces wrong by [%]"]
    header += [f"p after {row['experience_s']:g} s [%]" for row in longest]
    lines = []
    for name, results in found.items():
        wrong = [100 * max(r["error"]) for r in results if r["error"] is not None]
        lines.append(
            [
                f"`{name}`",
                str(len(results)),
                spread_cell(spread(wrong), 0) if wrong else "",
                *(cell([r["trials"][k]["p"] for r in results]) for k in range(len(longest))),
            ]
        )
    return markdown(header, lines)


def against(found: Mapping[str, Sequence[Mapping[str, Any]]], best: str = "eiv") -> str:
    """Differences of success, of the seeds that both have, with their bootstrap intervals."""
    ours = {result["seed"]: result["trials"] for result in found.get(best, ())}
    longest = max((results[0]["trials"] for results in found.values()), key=len)
    header = ["prior", "seeds", *(f"after {row['experience_s']:g} s [%]" for row in longest)]
    lines = []
    for name, results in found.items():
        theirs = {r["seed"]: r["trials"] for r in results if r["seed"] in ours}
        if name != best and theirs:
            cells = [
                cell([ours[s][k]["p"] - of[k]["p"] for s, of in theirs.items()])
                for k in range(len(longest))
            ]
            lines.append([f"`{name}`", str(len(theirs)), *cells])
    return markdown(header, lines)


def cell(shares: Sequence[float]) -> str:
    """The mean of shares, or of their differences, and its 95 % bootstrap interval [%]."""
    return mean_cell(mean(shares))


if __name__ == "__main__":
    sys.exit(main())
