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
from pathlib import Path
from time import process_time
from typing import Any, Literal

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
from realaigym.equations import JOINT, Row, nominal_row
from realaigym.polish import ROOM, polished, upright
from realaigym.regulator import Regulator

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
DT, STEPS = 0.02, 100
"""of a policy's input while it is learned [s], and of an episode: 2 s"""
LIMIT = 6.0
"""largest torque of policy and regulator [N m]: all that there is"""
STARTS = (1.5, 4.0, 1.5, 6.0)
"""std of the starts about hanging, of episodes and particles [rad, rad/s]: pushes may leave the
links anywhere"""
HANGING = (1e-3,) * 4
"""the same where all start as the boards do"""
NEAR = 0.05
"""std of particles that start near hanging, to that of the others [-]"""
ROUGH, FINE = 20, 120
"""steps that polish each candidate for the motion from hanging, and then the best"""
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
SHARES = ("model", "measurement_noise", "u_noise", "u_responsiveness", "delay", "perturbation")
"""of the robustness, as the boards call them"""


@dataclass(frozen=True)
class Arguments:
    """Learn, judge by the boards' scripts, and write the tables."""

    checkout: Path
    """of dfki-ric-underactuated-lab/double_pendulum"""
    robots: tuple[Robot, ...] = ("pendubot",)
    """whose boards"""
    variants: tuple[Literal[*VARIANTS], ...] = ("full",)
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
                name = f"{robot}-{variant.replace(' ', '-')}-{seed:04d}"
                path = out / "results" / f"{name}.json"
                found = read_json(path) if path.exists() else learned(robot, variant, seed, name)
                keep(path, found, HERE.name, continued=path.exists())
                if not arguments.learn_only and "robustness" not in found:
                    found = found | judged(robot, name, arguments.checkout.resolve())
                    keep(path, found, HERE.name, continued=True)
                print(f"{name}: {read_json(path)}", flush=True)
                write_readme(out)
    return 0


@dataclass(frozen=True)
class SwingCost:
    """c = (1 - n - k) (1 - exp(-d)) + n (1 - exp(-V / l)) + k (1 - exp(-2 e^2)) + efforts.

    d grows from upright with the angles, V / l = 1 is the edge of a region of the regulator, and e
    is the energy that upright lacks or exceeds, to that between hanging and upright.
    """

    plant: Row
    """the boards' pendulum"""
    regulator: Regulator
    joint: int
    """which has the motor"""
    lengthscales: tuple[float, float, float]
    """of shoulder, elbow and the lower link's angle to the vertical, in d [rad]"""
    near: float = 0.0
    """n [-]"""
    energy: float = 0.0
    """k [-]"""
    torque: float = 0.0
    """weight of u^2 [1/(N m)^2]"""
    velocity: float = 0.0
    """weight of q1'^2 + q2'^2 [s^2/rad^2]"""
    power: float = 0.0
    """weight of |u q'| of the joint with the motor [1/W]"""
    jumps: float = 0.0
    """weight of the square of u's change in a step [1/(N m)^2]"""
    anneals: bool = True
    """felt from further away in the first half of a search"""
    wide: float = 1.0
    """times the lengthscales [-]"""

    def widened(self, factor: float) -> SwingCost:
        """The same cost, felt from further away."""
        return replace(self, wide=factor) if self.anneals else self

    def __call__(
        self, states: Float[Tensor, "*b 4"], inputs: Float[Tensor, "*b 1"]
    ) -> Float[Tensor, "*b"]:
        """The cost of each state and torque [-]."""
        q1, q2 = states[..., 0], states[..., 2]
        away = (1.0 + q1.cos(), 1.0 - q2.cos(), 1.0 + (q1 + q2).cos())
        scales = (self.wide * scale for scale in self.lengthscales)
        d = torch.stack([2.0 * a / s**2 for a, s in zip(away, scales, strict=True)]).sum(0)
        cost = (1.0 - self.near - self.energy) * (1.0 - torch.exp(-d))
        if self.near:
            cost = cost + self.near * (1.0 - torch.exp(-self._squared(states) / self.wide**2))
        if self.energy:
            cost = cost + self.energy * (1.0 - torch.exp(-2.0 * self._lacking(states) ** 2))
        return cost + self._effort(states, inputs[..., 0])

    def _squared(self, states: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b"]:
        """V / l = x' P x / l of the error from upright."""
        q1, v1, q2, v2 = states.unbind(-1)
        x = torch.stack(
            [torch.atan2(-q1.sin(), -q1.cos()), v1, torch.atan2(q2.sin(), q2.cos()), v2], -1
        )
        return ((x @ torch.from_numpy(self.regulator.P)) * x).sum(-1) / self.regulator.level

    def _lacking(self, states: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b"]:
        """e = (energy - that of upright) / what is between hanging and upright [-]."""
        m1r1, m2r2, m2, l1, I1, I2, gravity = map(float, self.plant[:7])
        q1, v1, q2, v2 = states.unbind(-1)
        h = l1 * m2r2
        M11, M12 = I1 + I2 + m2 * l1**2 + 2.0 * h * q2.cos(), I2 + h * q2.cos()
        kinetic = 0.5 * M11 * v1**2 + M12 * v1 * v2 + 0.5 * I2 * v2**2
        upper, lower = (m1r1 + m2 * l1) * gravity, m2r2 * gravity
        height = -upper * q1.cos() - lower * (q1 + q2).cos()
        return (kinetic + height - upper - lower) / (2.0 * (upper + lower))

    def _effort(
        self, states: Float[Tensor, "*b 4"], torques: Float[Tensor, "*b"]
    ) -> Float[Tensor, "*b"]:
        speeds = states[..., 1::2]
        effort = self.torque * torques**2 + self.velocity * (speeds**2).sum(-1)
        if self.power:
            effort = effort + self.power * torch.sqrt(
                (torques * speeds[..., self.joint]) ** 2 + 0.01
            )
        if self.jumps and torques.dim() == 2:  # steps x particles
            jumps = torch.diff(torques, dim=0, prepend=torques[:1]) ** 2
            effort = effort + self.jumps * jumps
        return effort


@dataclass
class Replaceable:
    """The cost of the present stage: an env keeps the one that it is made with."""

    now: SwingCost

    def widened(self, factor: float) -> SwingCost:
        return self.now.widened(factor)

    def __call__(
        self, states: Float[Tensor, "*b 4"], inputs: Float[Tensor, "*b 1"]
    ) -> Float[Tensor, "*b"]:
        return self.now(states, inputs)


@dataclass(frozen=True)
class Stage:
    """A trial, and the search in it."""

    cost: Mapping[str, Any]
    """numbers of the `SwingCost`"""
    horizon: int = STEPS
    """of the particles [steps]"""
    rate: float = 1.0
    """factor of the learning rates [-]"""
    near: float = 0.0
    """share of the particles that start near hanging [-]"""


def efforts(
    share: float, torque: float, velocity: float, power: float = 0.0, jumps: float = 0.0
) -> dict[str, float]:
    """A share of the weights of torque, velocity, power and jumps."""
    names = ("torque", "velocity", "power", "jumps")
    return {n: share * w for n, w in zip(names, (torque, velocity, power, jumps), strict=True)}


@dataclass(frozen=True)
class Recipe:
    """How the policies of a robot are learned, and where its regulator acts."""

    lengthscales: tuple[float, float, float]
    """of the cost [rad]"""
    robust: tuple[Stage, ...]
    """for the policy that swings up from anywhere"""
    thrifty: tuple[Stage, ...]
    """from there to policies of the motion from hanging"""
    weight: float
    """half range of the weights of the first policy [-]"""
    room: float
    """of the regulator behind the robust policy [-]"""


CAUGHT = {"near": 0.4, "energy": 0.3}
LITTLE = (0.12, 0.006, 0.04, 0.6)
"""efforts' weights, about as the score has them; 0.4 of them are a twentieth of what it says"""
INFINITE = 1e9
RECIPES: Mapping[str, Recipe] = {
    "pendubot": Recipe(
        lengthscales=(1.5, 0.75, INFINITE),
        robust=tuple(Stage(efforts(s, 2.0 / 36.0, 0.01)) for s in (0.05, 0.15, 0.4, 1.0)),
        thrifty=tuple(
            Stage({**CAUGHT, **efforts(s, *LITTLE), "anneals": False}, 90, rate, 0.7)
            for s, rate in ((0.2, 0.4), (0.3, 0.3))
        ),
        weight=0.3,
        room=6.3,
    ),
    "acrobot": Recipe(
        lengthscales=(1.5, INFINITE, 1.5),
        robust=tuple(
            Stage({**CAUGHT, **efforts(s, 0.08, 0.002, 0.0, 0.1)}, horizon, rate)
            for s, horizon, rate in (
                (0.05, 50, 1.0),
                (0.1, 75, 0.6),
                (0.1, 75, 0.4),
                (0.1, 75, 0.4),
            )
        ),
        thrifty=tuple(
            Stage({**CAUGHT, **efforts(s, *LITTLE), "anneals": False}, 80, rate, 0.5)
            for s, rate in ((0.2, 0.4), (0.4, 0.3))
        ),
        weight=0.05,
        room=6.3,
    ),
}
"""chosen on seed 0"""
SEEN = 4.0
"""room of the regulator's region in the cost [-]"""


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
        told["thrifty"] = thriftiest(
            files[last - 1 :], Regulator(nominal, BOARD_DT, LIMIT, ROOM), row, joint
        )
        cpu_s += process_time() - began
    write_json(WORK / f"{name}.json", told)
    about = {"robot": robot, "variant": variant, "seed": seed, "machine": machine()}
    return about | {"experience_s": result.experience_s, "cpu_s": cpu_s}


def thriftiest(files: list[Path], regulator: Regulator, row: Row, joint: int) -> str:
    """The file of the policy whose motion from hanging scores best in the model, polished."""
    rough = [polished(file, regulator, row, joint, ROUGH) for file in files]
    best = max(rough, key=lambda found: found[1])[0]
    file, score = polished(best, regulator, row, joint, FINE)
    print(f"  {file.name}: RealAI score in the model {score:.3f}", flush=True)
    return file.name


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
        parts += [places(found)]
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
