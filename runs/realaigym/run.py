"""Our rows in the RealAIGym boards of the double pendulum, by the boards' own scripts.

git clone https://github.com/dfki-ric-underactuated-lab/double_pendulum PATH
python runs/realaigym/run.py --checkout PATH                   # pendubot, seed 0: ten CPU minutes
python runs/realaigym/run.py --checkout PATH --robots pendubot acrobot --seeds 0:3
python runs/realaigym/run.py --checkout PATH --learn-only      # the policies alone

A policy is learned on the nominal plant, and put into the checkout's
`calculate_leaderboard_score.py` and `benchmark_controller.py` as one of their controllers; these
run unchanged, in a folder of their own under runs/out/realaigym, and nothing is written into the
checkout. Their plant's equations are compiled (`fast.py`), for 722 motions of 10 s are simulated.
Results are kept in results/, a file for a robot, a variant and a seed; the same command goes on
where it was stopped and rewrites README.md between its marked lines.

The checkout's scripts need sympy, pandas, pyyaml, tabulate and ffmpeg beside what we need.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any, Literal, get_args

import gymnasium
import imageio_ffmpeg
import numpy as np
import torch
import tyro
from jaxtyping import Float
from torch import Tensor

sys.path.append(str(Path(__file__).parents[1]))

from harness import fill, folder, keep, kept, parse_seeds, places, use_one_thread
from realaigym.equations import DT as BOARD_DT
from realaigym.equations import JOINT, nominal_row
from realaigym.motion import Gaussians, upright
from realaigym.polish import Loop, polished
from realaigym.recipes import RECIPES, STEPS, Stage
from realaigym.regulator import Regulator
from realaigym.swing_cost import Replaceable, SwingCost

import envs  # noqa: F401  registers the envs
from envs.plants import BOARD, PLANTS
from mcpilco import MCPILCO
from mcpilco.agent import write_policy
from mcpilco.config import Config, ModelConfig, Phase, PolicyConfig, SearchConfig
from mcpilco.logbook import read_json, write_json
from mcpilco.search import Problem
from mcpilco.sensing import Perception
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
WORK = ROOT / "runs" / "out" / "realaigym"
DT = 0.02
"""for which a policy's input is held while it is learned [s]"""
LIMIT = 6.0
"""largest torque of policy and regulator [N m]: all that there is"""
STARTS = (1.5, 4.0, 1.5, 6.0)
"""std of the starts about hanging, of episodes and particles [rad, rad/s]: pushes may leave the
links anywhere"""
HANGING = (1e-3,) * 4
"""the same where all start as the boards do"""
NEAR = 0.05
"""std of particles that start near hanging, to that of the others [-]"""
SEEN = 4.0
"""room of the regulator's region in the cost [-]"""
ROOMS = 1.0, 1.5, 2.0
"""of the regulator behind the thrifty policy, the best of which is taken [-]: it enters late"""
CONFIG = Config(
    policy=PolicyConfig(bases=200, span=10.0, lengthscale=8.0, squash=1.0, weight=0.3),
    search=SearchConfig(
        particles=200,
        evaluation_particles=200,
        steps=(400,),
        restarts=(0,),
        phases=(Phase(0.03, until=0.5), Phase(0.015, until=0.75), Phase(0.006)),
        widening=2.0,
        correlations=(0.0,),
        failing=0.02,
    ),
    horizon=STEPS,
    precision="float32",
)
"""what differs from the preset `default`, chosen on seed 0"""
Robot = Literal["pendubot", "acrobot"]
PLAIN: Mapping[str, Any] = {
    "starts": STARTS,
    "regulated": True,
    "observed": True,
    "thrifty": True,
}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "full": PLAIN,
    "without spread": {**PLAIN, "starts": HANGING},
    "without observer": {**PLAIN, "observed": False},
    "without thrift": {**PLAIN, "thrifty": False},
    "without regulator": {**PLAIN, "regulated": False},
}
PUBLISHED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "pendubot": {
        "History SAC": (0.682, 0.770),
        "AR-EAPO": (0.659, 0.913),
        "evolSAC": (0.596, 0.786),
        "TVLQR": (0.526, 0.767),
        "MC-PILCO (its authors)": (0.480, 0.614),
    },
    "acrobot": {
        "History SAC": (0.655, 0.751),
        "AR-EAPO": (0.633, 0.727),
        "evolSAC": (0.524, 0.687),
        "TVLQR": (0.504, 0.607),
        "MC-PILCO (its authors)": (0.316, 0.241),
    },
}
"""RealAI score and robustness, of dfki-ric-underactuated-lab/real_ai_gym_leaderboard @81ea5bc"""
NEEDED = ("sympy", "pandas", "yaml", "tabulate")
"""what the checkout's scripts import beside what we need"""
SHARES = ("model", "measurement_noise", "u_noise", "u_responsiveness", "delay", "perturbation")
"""of the robustness, as the boards call them"""


@dataclass(frozen=True)
class Arguments:
    """Learn, judge by the boards' scripts, and write the tables."""

    checkout: Path | None = None
    """of dfki-ric-underactuated-lab/double_pendulum; by default the one that MCPILCO_BOARD names"""
    robots: tuple[Robot, ...] = ("pendubot",)
    """whose boards"""
    variants: tuple[Literal[*VARIANTS], ...] = ("full",)
    """what is learned and put beside it"""
    seeds: str = "0:1"
    """`0:3` are 0 to 2"""
    only: str = ""
    """name of one result, such as `pendubot-full-0140`, in place of robots, variants and seeds"""
    learn_only: bool = False
    """judge nothing"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    if not arguments.learn_only and (missing := [name for name in NEEDED if not find_spec(name)]):
        raise SystemExit(f"The checkout's scripts need {', '.join(missing)}: install them first.")
    checkout = arguments.checkout or Path(os.environ.get("MCPILCO_BOARD", "."))
    if not arguments.learn_only and not (checkout / "leaderboard").is_dir():
        raise SystemExit(
            f"--checkout, or MCPILCO_BOARD, must be a clone of double_pendulum, got {checkout}: "
            "it has no folder `leaderboard`."
        )
    use_one_thread()
    out = folder(HERE, arguments.out, False)
    for robot, variant, seed in asked(arguments):
        name = named(robot, variant, seed)
        path = out / "results" / f"{name}.json"
        if path.exists():
            found = read_json(path)
        else:
            found = learned(robot, variant, seed, name)
            keep(path, found, HERE.name)
        if not arguments.learn_only and "robustness" not in found:
            found = found | judged(robot, name, checkout.resolve())
            keep(path, found, HERE.name, continued=True)
        print(f"{name}: {read_json(path)}", flush=True)
        write_readme(out)
    return 0


def asked(arguments: Arguments) -> list[tuple[Robot, str, int]]:
    """The robots, variants and seeds of the command."""
    if not arguments.only:
        return [*product(arguments.robots, arguments.variants, parse_seeds(arguments.seeds))]
    number = arguments.only.rpartition("-")[2]
    seeds = (int(number),) if number.isdecimal() else ()
    every = product(get_args(Robot), VARIANTS, seeds)
    if one := [each for each in every if named(*each) == arguments.only]:
        return one
    raise SystemExit(
        f"--only must be such as {named('pendubot', 'full', 140)}, got {arguments.only}."
    )


def named(robot: Robot, variant: str, seed: int) -> str:
    """The name of a result's file."""
    return f"{robot}-{variant.replace(' ', '-')}-{seed:04d}"


@dataclass(frozen=True)
class MixedStarts(Problem):
    """Particles of which a share starts near hanging."""

    near: float = 0.0

    def normals(
        self, count: int, generator: torch.Generator
    ) -> tuple[Float[Tensor, "P X"], Float[Tensor, "T P E"]]:
        start, noise = super().normals(count, generator)
        start[: round(self.near * count)] *= NEAR
        return start, noise


class Agent(MCPILCO):
    """MC-PILCO whose search follows a recipe's stages, one a trial."""

    stage = Stage({})

    def _problem(self, trial: int, perception: Perception | None) -> Problem:
        plain = super()._problem(trial, perception)
        found = MixedStarts(**{f.name: getattr(plain, f.name) for f in fields(plain)})
        return replace(found, horizon=self.stage.horizon, near=self.stage.near)


def learned(robot: Robot, variant: str, seed: int, name: str) -> dict[str, Any]:
    """The policies of a seed, and what they took."""
    recipe, how, env = RECIPES[robot], VARIANTS[variant], f"mcpilco/{robot.capitalize()}-v0"
    nominal, joint = PLANTS[env]().where(**BOARD), JOINT[robot]
    row, seen = nominal_row(nominal), Regulator(nominal, BOARD_DT, LIMIT, SEEN)
    plain = SwingCost(row, seen, joint, recipe.lengthscales)
    cost = Replaceable(plain)
    plant = {"format": 1, "plant": env, "parameters": BOARD, "effects": []}
    model = ModelConfig(kernel="rbf", mean="physics", plant=plant, uncertainty=0.01)
    made = gymnasium.make(
        f"mcpilco/Board{robot.capitalize()}-v0",
        dt=DT,
        torque_limit=LIMIT,
        max_episode_steps=STEPS,
        start_std=how["starts"],
        cost=cost,
    )
    stages = recipe.robust + (recipe.thrifty if how["thrifty"] else ())
    search = replace(CONFIG.search, rates=tuple(stage.rate for stage in stages))
    policy = replace(CONFIG.policy, weight=recipe.weight)
    config = replace(CONFIG, model=model, search=search, policy=policy)
    agent = Agent("SumOfGaussians", made, config=config, seed=seed)
    WORK.mkdir(parents=True, exist_ok=True)
    cpu_s, files = 0.0, []
    for agent.stage in stages:
        cost.now = replace(plain, **agent.stage.cost)
        agent.learn(agent.timesteps_of(1))
        result = agent.results[-1]
        cpu_s += result.cpu_s
        print(f"  {name}, trial {result.trial}: cost {result.real_cost:.3f}", flush=True)
        files.append(WORK / f"{name}-{result.trial}.npz")
        write_policy(files[-1], agent.policy, agent.task, agent.estimator)
    last, wide = len(recipe.robust), Regulator(nominal, BOARD_DT, LIMIT, recipe.room)
    robust = max(reversed(files[:last]), key=lambda file: upright(file, wide, row, joint))
    told = {"name": name, "robot": robot, "policy": robust.name, "limit": LIMIT}
    told |= {"room": recipe.room} | {part: how[part] for part in ("regulated", "observed")}
    if how["thrifty"]:
        began = process_time()
        loops = [Loop(Regulator(nominal, BOARD_DT, LIMIT, room), row, joint) for room in ROOMS]
        told |= thriftiest(name, files[1:], loops, seed)
        cpu_s += process_time() - began
    write_json(WORK / f"{name}.json", told)
    about = {"robot": robot, "variant": variant, "seed": seed, "machine": machine()}
    return about | {"experience_s": result.experience_s, "cpu_s": cpu_s}


def thriftiest(name: str, files: list[Path], loops: list[Loop], seed: int) -> dict[str, Any]:
    """The policy whose motion from hanging scores best in the model, as `board.made` is told it."""
    generator = np.random.default_rng(seed)
    found = polished([Gaussians.read(file) for file in files], loops, generator)
    print(f"  {name}: RealAI score in the model {1.0 - found.cost:.3f}", flush=True)
    found.policy.write(WORK / f"{name}-thrifty.npz", files[-1])
    return {"thrifty": f"{name}-thrifty.npz", "gentle": found.loop.regulator.room}


def judged(robot: Robot, name: str, checkout: Path) -> dict[str, Any]:
    """The scores by the boards' own scripts."""
    found = ours(robot, "simulation_v2", "calculate_leaderboard_score.py", name, checkout)
    with (found / "leaderboard_entry.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    numbers = {key: float(value) for key, value in row.items() if _is_number(value)}
    found = ours(robot, "robustness_v2", "benchmark_controller.py", name, checkout)
    text = (found / "scores.yml").read_text().split()
    shares = {k.rstrip(":"): float(v) for k, v in zip(text[::2], text[1::2], strict=True)}
    robustness = float(np.mean([shares[share] for share in SHARES]))
    return {"score": numbers, "shares": shares, "robustness": robustness}


def ours(robot: Robot, board: str, script: str, name: str, checkout: Path) -> Path:
    """The folder of the results of our controller by a script of the checkout."""
    place = WORK / "boards" / "leaderboard" / robot / board
    place.mkdir(parents=True, exist_ok=True)
    data = WORK / "boards" / "data"
    if not data.exists():
        data.symlink_to(checkout / "data")
    con = f"con_{name.replace('-', '_')}"
    described = (WORK / f"{name}.json").as_posix()
    (place / f"{con}.py").write_text(
        "from pathlib import Path\n\nfrom realaigym.board import made\n\n"
        f"controller, leaderboard_config = made(Path({described!r}))\n"
    )
    paths = [place, checkout / "src" / "python", ROOT, ROOT / "runs"]
    told = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "MPLBACKEND": "agg"}
    if shutil.which("ffmpeg") is None:  # they film each entry; the extra `video` brings one
        (WORK / "bin").mkdir(exist_ok=True)
        (WORK / "bin" / "ffmpeg").unlink(missing_ok=True)
        (WORK / "bin" / "ffmpeg").symlink_to(imageio_ffmpeg.get_ffmpeg_exe())
        told["PATH"] = os.pathsep.join([str(WORK / "bin"), os.environ["PATH"]])
    path = checkout / "leaderboard" / robot / board / script
    command = [sys.executable, str(HERE / "fast.py"), str(path), con]
    done = subprocess.run(command, cwd=place, env=told, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(
            f"{' '.join(command)} failed:\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
        )
    folders = sorted((place / "data").iterdir(), key=lambda path: path.stat().st_mtime)
    return folders[-1]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Our rows among those that are published."""
    found = kept(out / "results")
    judged_ones = [one for one in found if "robustness" in one]
    parts = ["Not measured yet."]
    if judged_ones:
        parts = []
        for robot in PUBLISHED:
            if ours_here := [one for one in judged_ones if one["robot"] == robot]:
                parts += [f"### {robot.capitalize()}", board(robot, ours_here)]
        parts += ["### Each seed", shares(judged_ones), "### The score", scores(judged_ones)]
        parts += [unjudged([one for one in found if "robustness" not in one]), places(found)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def board(robot: str, found: list[dict[str, Any]]) -> str:
    """Published rows and the means of ours, the best robustness first."""
    rows: list[tuple[float, tuple[str, ...]]] = [
        (robust, (name, f"{score:.3f}", f"{robust:.3f}", "", "", ""))
        for name, (score, robust) in PUBLISHED[robot].items()
    ]
    for variant in VARIANTS:
        seeds = [one for one in found if one["variant"] == variant]
        if not seeds:
            continue
        score = np.mean([one["score"]["RealAI Score"] for one in seeds])
        robust, seconds, cpu = (
            float(np.mean([one[key] for one in seeds]))
            for key in ("robustness", "experience_s", "cpu_s")
        )
        cells = f"{score:.3f}", f"{robust:.3f}", f"{seconds:g}", f"{cpu:.0f}", str(len(seeds))
        rows.append((robust, (f"**ours, {variant}**", *cells)))
    rows.sort(key=lambda row: -row[0])
    header = ("controller", "RealAI score", "robustness", *OURS)
    return markdown(header, [cells for _, cells in rows])


OURS = ("experience [s]", "CPU to learn [s]", "seeds")
"""what only our rows have"""


def shares(found: list[dict[str, Any]]) -> str:
    """Each share of the robustness [%], of ours."""
    header = ("robot", "variant", "seed", "robustness", *(s.replace("_", " ") for s in SHARES))
    rows = [
        (*_who(r), f"{r['robustness']:.3f}", *(f"{100 * r['shares'][s]:.1f}" for s in SHARES))
        for r in found
    ]
    return markdown(header, rows)


def unjudged(found: list[dict[str, Any]]) -> str:
    """A sentence on what was learned and is not judged; nothing where all is."""
    names = [f"{robot}, {variant}, seed {seed}" for robot, variant, seed in map(_who, found)]
    return f"Learned, and not judged: {'; '.join(names)}." if names else ""


def scores(found: list[dict[str, Any]]) -> str:
    """The RealAI score of ours, and what it is made of, in the boards' units."""
    names = [name for name in found[0]["score"] if name != "RealAI Score"]
    header = ("robot", "variant", "seed", "RealAI score", *names)
    rows = [
        (*_who(r), f"{r['score']['RealAI Score']:.3f}", *(f"{r['score'][n]:g}" for n in names))
        for r in found
    ]
    return markdown(header, rows)


def _who(one: Mapping[str, Any]) -> tuple[str, str, str]:
    return one["robot"], one["variant"], str(one["seed"])


if __name__ == "__main__":
    sys.exit(main())
