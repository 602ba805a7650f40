"""MC-PILCO learns to swing a pendubot and an acrobot up, with equations whose masses are wrong.

python runs/pendubot_swingup/run.py --quick                          # does it run at all?
python runs/pendubot_swingup/run.py --seeds 100:130                  # the pendubot
python runs/pendubot_swingup/run.py --seeds 100:130 --robots acrobot
python runs/pendubot_swingup/run.py --seeds 100:105 --variants "without regulator"
python runs/pendubot_swingup/run.py --seeds 200:210 --variants "without equations"

Results are kept in results/, a file for a robot, a variant and a seed, rewritten after each trial.
The same command goes on where it was stopped, and rewrites README.md between its marked lines from
all results. A seed ends with the first policy that succeeds in its test rollout and in 9 of 10
fresh ones, or after 60 s of experience.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, hasty, keep, kept, parse_seeds, places, use_one_thread
from pendubot_swingup.regulated_agent import ENVS, Agent, KnowingAgent
from realaigym.recipes import RECIPES

import envs
from mcpilco.config import (
    REGULATOR_ROOM,
    Config,
    ModelConfig,
    Phase,
    PolicyConfig,
    SearchConfig,
)
from mcpilco.logbook import read_json, versions
from mcpilco.sweep import FreshEpisodes, machine, markdown, rate, rate_cell, spread, spread_cell

HERE = Path(__file__).parent
EPISODE = 2.5
"""length of an episode [s]"""
TRIALS = 24
"""of 2.5 s each; the last policy is learned from 60 s, 2.5 s of random inputs among them"""
FRESH, SOLVED = 50, 0.9
"""episodes that a policy is judged by, and the share of them that ends a seed"""
WRONG = 0.2
"""a nominal mass is wrong by up to this part of it, in either direction"""
MASSES = ("upper_mass", "lower_mass")


@dataclass(frozen=True)
class Setting:
    """In what a robot's numbers differ from the other's; README.md tells why."""

    dt: float
    """for which a torque is held [s]"""
    sight: float
    """how far particles go [s]"""
    room: float
    """torque that the regulator may ask for in its region, to the limit [-]; 0: there is none"""
    units: tuple[float, ...]
    """errors of angle and velocity that cost a regulator as much as the largest torque [rad,
    rad/s]; none: 1, but 6 in the cost's"""
    near: float
    """weight in the cost of the way to the region of a regulator [-]"""
    energy: float
    """weight in the cost of the energy [-]"""
    equations: bool = True
    """whether the model's mean is physics; else the cost is the env's, without near and energy"""
    trust: float = 0.9
    """share of the model's draws that the regulator must hold [-]"""
    model: Mapping[str, Any] = field(default_factory=dict)
    """of the `ModelConfig`"""

    @property
    def steps(self) -> int:
        """Of an episode."""
        return round(EPISODE / self.dt)


SETTINGS: Mapping[str, Setting] = {
    "pendubot": Setting(
        dt=0.025,
        sight=EPISODE,
        room=REGULATOR_ROOM,
        units=(),
        near=0.3,
        energy=0.4,
    ),
    "acrobot": Setting(
        dt=0.01,
        sight=1.7,
        room=6.0,
        units=(0.3, 3.0),
        near=0.4,
        energy=0.3,
        model={"noise_floor": 0.1, "inducing": 100},
    ),
}
VELOCITY = 0.0005
"""weight in the cost of squared velocities [s^2/rad^2]"""
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "full": {},
    "without regulator": {"room": 0.0},
    "without energy": {"energy": 0.0},
    "without equations": {
        "equations": False,
        "sight": 2.0,
        "room": 6.0,
        "units": (0.3, 3.0),
        "trust": 0.5,
        "model": {"noise_floor": 0.03, "inducing": 200},
    },
}
"""in what a robot's setting differs"""

CONFIG = Config(
    policy=PolicyConfig(bases=200, span=10.0, lengthscale=8.0, squash=1.0, weight=5.0),
    search=SearchConfig(
        particles=50,
        evaluation_particles=100,
        steps=(400,),
        restarts=(3,),
        screening=1.0,
        failing=0.02,
        phases=(Phase(0.04, until=0.5), Phase(0.02, until=0.75), Phase(0.008)),
        widening=2.0,
        correlations=(0.0,),
    ),
    precision="float32",
)
"""what differs from the preset `default`, and why, is told in README.md"""
Robot = Literal["pendubot", "acrobot"]


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    robots: tuple[Robot, ...] = ("pendubot",)
    """with the motor in the shoulder or in the elbow"""
    variants: tuple[Literal[*VARIANTS], ...] = ("full",)
    """what is learned"""
    quick: bool = False
    """one seed, two trials, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    seeds, trials = parse_seeds(arguments.seeds), TRIALS
    if arguments.quick:
        seeds, trials = seeds[:1], 2
    for robot in arguments.robots:
        for variant in arguments.variants:
            for seed in seeds:
                name = f"{robot}-{variant.replace(' ', '-')}-{seed:04d}"
                path = out / "results" / f"{name}.json"
                if path.exists() and read_json(path)["over"]:
                    continue
                setting = replace(SETTINGS[robot], **VARIANTS[variant])
                config = config_of(robot, seed, setting)
                config = hasty(config) if arguments.quick else config
                about = {"robot": robot, "variant": variant, "seed": seed}
                for result in learned(about, setting, config, trials):
                    keep(path, result, HERE.name)
                    write_readme(out)
                print(f"{name}: {verdict(result)}", flush=True)
    write_readme(out)
    return 0


def config_of(robot: Robot, seed: int, setting: Setting) -> Config:
    """The numbers of a seed; its nominal masses are wrong."""
    model = ModelConfig(kernel="rbf", **setting.model)
    if setting.equations:
        plant = {"format": 1, "plant": ENVS[robot], "parameters": wrong_masses(robot, seed)}
        model = replace(model, mean="physics", plant={**plant, "effects": []})
    policy = replace(
        CONFIG.policy,
        weight=RECIPES[robot].weight,
        regulator=setting.room,
        regulator_units=2 * setting.units,
        regulator_trust=setting.trust,
    )
    return replace(CONFIG, model=model, policy=policy, horizon=setting.steps)


def wrong_masses(robot: Robot, seed: int) -> dict[str, float]:
    """Nominal masses of a seed [kg]."""
    rng, true = np.random.default_rng([seed, 7]), envs.PLANTS[ENVS[robot]]().values
    return {m: true[m] * (1.0 + float(rng.uniform(-WRONG, WRONG))) for m in MASSES}


def agent_of(robot: Robot, seed: int, setting: Setting, config: Config) -> Agent:
    """An agent that has learned nothing yet."""
    sight, keywords = round(setting.sight / setting.dt), env_of(setting)
    keywords |= {"config": config, "seed": seed}
    if not setting.equations:
        return Agent(robot, sight, **keywords)
    weights = {"near": setting.near, "energy": setting.energy, "velocity": VELOCITY}
    return KnowingAgent(robot, sight, weights=weights, **keywords)


def env_of(setting: Setting) -> dict[str, Any]:
    """Keywords of the env."""
    return {"dt": setting.dt, "max_episode_steps": setting.steps}


def learned(
    about: Mapping[str, Any], setting: Setting, config: Config, trials: int
) -> Iterator[dict[str, Any]]:
    """Yields the results of a seed after each trial, as JSON; the last one is over.

    `about` says robot, variant and seed.
    """
    robot, seed = about["robot"], about["seed"]
    agent = agent_of(robot, seed, setting, config)
    about = {**about, "machine": machine(), "versions": versions()}
    rows: list[dict[str, Any]] = []
    with FreshEpisodes(ENVS[robot], env_of(setting), FRESH, agent.horizon) as judge:
        for trial in range(1, trials + 1):
            agent.learn(agent.timesteps_of(1))
            fresh = judge.outcomes(agent.controller, seed, trial)
            rows.append(_row(agent.results[-1], float(fresh["is_success"].mean())))
            over = trial == trials or solved(rows[-1])
            yield {**about, "over": over, "trials": rows}
            if over:
                return


def _row(result: Any, p: float) -> dict[str, Any]:
    numbers = ("experience_s", "predicted_cost", "real_cost", "starts", "cpu_s")
    told = {name: getattr(result, name) for name in numbers}
    return {
        "trial": result.trial,
        "success": bool(result.success),
        "p": p,
        **told,
        **result.outcome,
    }


def solved(row: Mapping[str, Any]) -> bool:
    """Whether a policy swings it up and holds it, again and again."""
    return row["success"] and row["p"] >= SOLVED


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = kept(out / "results")
    parts = [table(found), "### Each seed", seeds_table(found), places(found, ", one thread")]
    template = HERE / "README.md"
    fill(out / "README.md", parts if found else ["Not measured yet."], template=template)


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """Success within 60 s by robot and variant; a seed that goes on is not solved yet."""
    header = ("robot", "variant", "seeds", "one test rollout succeeded [%]", "solved [%]")
    header += ("experience until solved [s]", "largest p [%]", "CPU a seed [s]")
    lines = []
    for robot, variant in [(robot, variant) for robot in ENVS for variant in VARIANTS]:
        seeds = [r for r in found if (r["robot"], r["variant"]) == (robot, variant)]
        if not seeds:
            continue
        until = [first(result, solved) for result in seeds]
        lines.append(
            (
                robot,
                variant,
                str(len(seeds)),
                rate_cell(rate(first(result, _succeeded) is not None for result in seeds)),
                rate_cell(rate(seconds is not None for seconds in until)),
                spread_cell(spread(s for s in until if s is not None), 1),
                spread_cell(spread(100 * best(result) for result in seeds), 0),
                spread_cell(spread(sum(row["cpu_s"] for row in r["trials"]) for r in seeds), 0),
            )
        )
    legend = (
        f"Solved: a policy succeeded in its test rollout and in at least {SOLVED:.0%} of {FRESH} "
        "fresh ones; p: success over fresh rollouts. In brackets: 95 % intervals of Wilson for "
        "shares, else quartiles beside the median. A seed that goes on counts as not solved."
    )
    return f"{markdown(header, lines)}\n{legend}"


def seeds_table(found: Sequence[Mapping[str, Any]]) -> str:
    """A line a seed."""
    header = ("robot", "variant", "seed", "trials", "first success after [s]")
    header += ("solved after [s]", "largest p [%]", "longest upright [s]")
    lines = [
        (
            result["robot"],
            result["variant"],
            f"{result['seed']}{'' if result['over'] else ' (goes on)'}",
            str(len(result["trials"])),
            *(_seconds(first(result, rule)) for rule in (_succeeded, solved)),
            f"{100 * best(result):.0f}",
            f"{max(row['time_up_s'] for row in result['trials']):.2f}",
        )
        for result in found
    ]
    return markdown(header, lines)


def first(result: Mapping[str, Any], rule: Callable[[Mapping[str, Any]], bool]) -> float | None:
    """Experience that the first policy of a kind was learned from [s]; None: there is none."""
    return next((row["experience_s"] for row in result["trials"] if rule(row)), None)


def best(result: Mapping[str, Any]) -> float:
    """Share of fresh rollouts in which a seed's best policy succeeded [-]."""
    return max(row["p"] for row in result["trials"])


def verdict(result: Mapping[str, Any]) -> str:
    """How a seed ended."""
    seconds = first(result, solved)
    ending = "never solved" if seconds is None else f"solved after {seconds:.1f} s"
    return f"best p {best(result):.2f}, {ending}"


def _succeeded(row: Mapping[str, Any]) -> bool:
    return bool(row["success"])


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    sys.exit(main())
