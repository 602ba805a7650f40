"""Our rows in the RealAIGym boards of the double pendulum, by the boards' own scripts.

git clone https://github.com/dfki-ric-underactuated-lab/double_pendulum PATH
python runs/realaigym/run.py --checkout PATH                   # pendubot, seed 0: some CPU minutes
python runs/realaigym/run.py --checkout PATH --robots pendubot acrobot --seeds 0:3
python runs/realaigym/run.py --checkout PATH --learn-only      # the policies alone

A policy is learned on the nominal plant, and put into the checkout's
`calculate_leaderboard_score.py` and `benchmark_controller.py` as one of their controllers; these
run unchanged, in a folder of their own under runs/out/realaigym, and nothing is written into the
checkout. Results are kept in results/, a file for a robot, a variant and a seed; the same command
goes on where it was stopped and rewrites README.md between its marked lines.

The checkout's scripts need sympy, pandas, pyyaml, tabulate and ffmpeg beside what we need.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import gymnasium
import imageio_ffmpeg
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))

from harness import fill, folder, keep, kept, parse_seeds, places, use_one_thread
from pendubot_swingup.run import CONFIG
from realaigym.regulator import Regulator

import envs  # noqa: F401  registers the envs
from envs.plants import BOARD, PLANTS
from mcpilco import MCPILCO
from mcpilco.agent import write_policy
from mcpilco.config import ModelConfig
from mcpilco.logbook import read_json, write_json
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
WORK = ROOT / "runs" / "out" / "realaigym"
DT, STEPS = 0.05, 50
"""of a policy's input [s], and of an episode: 2.5 s, in which it must reach the regulator"""
LIMIT = 6.0
"""largest torque of policy and regulator [N m]: all that there is"""
MOST_S = 60.0
"""of experience of the nominal plant [s]"""
SPREAD = {"mass": 0.1, "length": 0.05, "torque_gain": 0.1}
"""relative std of the plants that particles draw from [-]"""
Robot = Literal["pendubot", "acrobot"]
VARIANTS: Mapping[str, dict[str, Any]] = {
    "spread, regulator": {"spread": SPREAD, "regulated": True},
    "regulator": {"spread": None, "regulated": True},
    "spread": {"spread": SPREAD, "regulated": False},
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
SHARES = ("model", "measurement_noise", "u_noise", "u_responsiveness", "delay", "perturbation")
"""of the robustness, as the boards call them"""


@dataclass(frozen=True)
class Arguments:
    """Learn, judge by the boards' scripts, and write the tables."""

    checkout: Path
    """of dfki-ric-underactuated-lab/double_pendulum"""
    robots: tuple[Robot, ...] = ("pendubot",)
    """whose boards"""
    variants: tuple[Literal[*VARIANTS], ...] = ("spread, regulator",)
    """what is learned and put beside it"""
    seeds: str = "0:1"
    """`0:3` are 0 to 2"""
    learn_only: bool = False
    """judge nothing"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, False)
    for robot in arguments.robots:
        for variant in arguments.variants:
            for seed in parse_seeds(arguments.seeds):
                name = f"{robot}-{variant.replace(', ', '-')}-{seed:04d}"
                path = out / "results" / f"{name}.json"
                found = read_json(path) if path.exists() else learned(robot, variant, seed, name)
                keep(path, found, HERE.name, continued=path.exists())
                if not arguments.learn_only and "robustness" not in found:
                    found = found | judged(robot, name, arguments.checkout.resolve())
                    keep(path, found, HERE.name, continued=True)
                print(f"{name}: {read_json(path)}", flush=True)
                write_readme(out)
    return 0


def learned(robot: Robot, variant: str, seed: int, name: str) -> dict[str, Any]:
    """The first policy whose own test rollout reaches the regulator's region, or the last one."""
    env, how = f"mcpilco/{robot.capitalize()}-v0", VARIANTS[variant]
    plant = {"format": 1, "plant": env, "parameters": BOARD, "effects": []}
    model = ModelConfig(kernel="rbf", mean="physics", plant=plant, spread=how["spread"])
    config = replace(CONFIG, model=model, horizon=STEPS)
    made = gymnasium.make(
        f"mcpilco/Board{robot.capitalize()}-v0", dt=DT, torque_limit=LIMIT, max_episode_steps=STEPS
    )
    agent = MCPILCO("SumOfGaussians", made, config=config, seed=seed)
    regulator = Regulator(PLANTS[env]().where(**BOARD), 0.002, LIMIT)
    cpu_s, reached = 0.0, False
    while not reached and agent.num_timesteps * DT + STEPS * DT <= MOST_S:
        agent.learn(agent.timesteps_of(1))
        result = agent.results[-1]
        cpu_s += result.cpu_s
        reached = any(map(regulator.trusted, np.array(result.rollout.states)))
        print(f"  {name}, trial {result.trial}: cost {result.real_cost:.3f}, {reached}", flush=True)
    WORK.mkdir(parents=True, exist_ok=True)
    write_policy(WORK / f"{name}.npz", agent.policy, agent.task, agent.estimator)
    told = {"name": name, "robot": robot, "policy": f"{name}.npz", "dt": DT, "limit": LIMIT}
    write_json(WORK / f"{name}.json", told | {"regulated": how["regulated"]})
    about = {"robot": robot, "variant": variant, "seed": seed, "machine": machine()}
    return about | {"experience_s": result.experience_s, "reached": reached, "cpu_s": cpu_s}


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
    command = [sys.executable, str(checkout / "leaderboard" / robot / board / script), con]
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
    parts = ["Not measured yet."]
    if found:
        parts = []
        for robot in PUBLISHED:
            parts += [f"### {robot}", board(robot, [r for r in found if r["robot"] == robot])]
        parts += ["### Parts of the robustness", shares(found), places(found)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def board(robot: str, found: list[dict[str, Any]]) -> str:
    """Published rows and ours, the best robustness first."""
    rows: list[tuple[float, tuple[str, ...]]] = [
        (robust, (name, f"{score:.3f}", f"{robust:.3f}", "", ""))
        for name, (score, robust) in PUBLISHED[robot].items()
    ]
    for one in found:
        name = f"**ours: {one['variant']}, seed {one['seed']}**"
        seconds, cpu = f"{one['experience_s']:g}", f"{one['cpu_s']:.0f}"
        score, robust = one.get("score", {}).get("RealAI Score"), one.get("robustness")
        cells = ["" if x is None else f"{x:.3f}" for x in (score, robust)]
        rows.append((robust or -1.0, (name, *cells, seconds, cpu)))
    rows.sort(key=lambda row: -row[0])
    header = ("controller", "RealAI score", "robustness", "experience [s]", "CPU to learn [s]")
    return markdown(header, [cells for _, cells in rows])


def shares(found: list[dict[str, Any]]) -> str:
    """Each share of the robustness [%], of ours."""
    header = ("robot", "variant", "seed", *(name.replace("_", " ") for name in SHARES))
    rows = [
        (r["robot"], r["variant"], str(r["seed"]), *(f"{100 * r['shares'][s]:.1f}" for s in SHARES))
        for r in found
        if "shares" in r
    ]
    return markdown(header, rows)


if __name__ == "__main__":
    sys.exit(main())
