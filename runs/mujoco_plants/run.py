"""Any MuJoCo model is a plant: which of the shipped ones load, how fast they are, what is found.

python runs/mujoco_plants/run.py models        # every MJCF of three packages, equal to mj_step?
python runs/mujoco_plants/run.py throughput    # beside a plain loop of mj_step, mujoco.rollout
python runs/mujoco_plants/run.py cases         # hidden effects in models that others made
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from harness import fill, folder, keep, kept, places, use_one_thread

from mcpilco.gap import investigate
from mcpilco.mjcf import MujocoPlant, load_mjcf, mujoco_plant, read_plant
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.recordings import Recording
from mcpilco.sweep import machine, markdown
from mcpilco.typing import InputError

HERE = Path(__file__).parent
SHIPPED = {
    "gymnasium": "envs/mujoco/assets",
    "dm_control": "suite",
    "gymnasium_robotics": "envs/assets",
}
"""packages with models, and where they are in them"""
HELD_S = 0.02
"""for which a command is held [s]"""
NOISE = (2e-3, 2e-2)
"""std of the measurement noise of positions and velocities [m or rad, m/s or rad/s]"""


def shipped() -> Iterator[tuple[str, str, Path]]:
    """Every XML file of the packages that are there: package, name and path."""
    for package, inside in SHIPPED.items():
        found = importlib.util.find_spec(package)
        if found is not None and found.origin is not None:
            root = Path(found.origin).parent / inside
            for path in sorted(root.rglob("*.xml")):
                yield package, str(path.relative_to(root)), path


# Models -------------------------------------------------------------------------------------------


def looked_at(path: Path) -> dict[str, Any] | None:
    """Whether a model loads and moves as mj_step moves it; None where MuJoCo compiles none."""
    try:
        mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        return None  # a part of a model, as it is included by others
    try:
        plant = mujoco_plant(load_mjcf(path), path.stem)
    except InputError as error:
        return {"loads": False, "why": str(error)}
    kind = "equations" if not isinstance(read_plant(path), MujocoPlant) else "MuJoCo"
    count, step = (plant.model.nv, plant.model.nu), plant.model.opt.timestep
    hold = max(1, round(HELD_S / step))
    u = commands(plant, np.random.default_rng(0), -(-round(1.0 / step) // hold), 1)
    y = plant.simulate(plant.rest[None], u[None], hold * step)[0]
    equal = np.array_equal(y[1:], stepped(plant, u, hold))
    return {"loads": True, "kind": kind, "dofs": count[0], "inputs": count[1], "equal": equal}


def commands(
    plant: MujocoPlant, rng: np.random.Generator, count: int, hold: int, part: float = 1.0
) -> np.ndarray:
    """Random commands within a part of their ranges, each for `hold` steps."""
    model = plant.model
    limited = model.actuator_ctrllimited.astype(bool)[:, None]
    low, high = np.where(limited, model.actuator_ctrlrange, [-1.0, 1.0]).T
    levels = rng.uniform(-part, part, (-(-count // hold), model.nu))
    return np.repeat(0.5 * (low + high) + 0.5 * (high - low) * levels, hold, axis=0)[:count]


def stepped(plant: MujocoPlant, u: np.ndarray, hold: int) -> np.ndarray:
    """The states after each command, by a plain loop of mj_step."""
    data = mujoco.MjData(plant.model)
    data.qpos[:], data.qvel[:] = plant.coordinates.qpos(plant.rest[0::2]), plant.rest[1::2]
    found = []
    for command in u:
        data.ctrl[:] = command
        for _ in range(hold):
            mujoco.mj_step(plant.model, data)
        q = plant.coordinates.positions(data.qpos.copy())
        found.append(np.stack([q, data.qvel], axis=1).ravel())
    return np.array(found)


# Throughput ---------------------------------------------------------------------------------------


def throughput(path: Path, motions: int = 200, seconds: float = 1.0) -> dict[str, float]:
    """CPU and wall time of the plant's batch, in those of a plain loop and of mujoco.rollout."""
    from mujoco import rollout

    plant = read_plant(path, "mujoco")
    assert isinstance(plant, MujocoPlant)
    model, n = plant.model, round(seconds / plant.model.opt.timestep)
    rng = np.random.default_rng(0)
    u = np.stack([commands(plant, rng, n, 5) for _ in range(motions)])
    start = np.tile(plant.rest, (motions, 1))
    qpos = plant.coordinates.qpos(start[:, 0::2])
    state = np.concatenate([np.zeros((motions, 1)), qpos, start[:, 1::2]], axis=1)
    every_data = [mujoco.MjData(model) for _ in range(2)]
    tasks = {
        "plant": lambda: plant.simulate(start, u, model.opt.timestep),
        "loop": lambda: [stepped(plant, each, 1) for each in u],
        "rollout": lambda: rollout.rollout(model, every_data, state, u),
    }
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for _ in range(3):
        for name, run in tasks.items():
            begun = time.perf_counter(), time.process_time()
            run()
            taken[name].append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    wall, cpu = ({name: min(t[k] for t in taken[name]) for name in tasks} for k in (0, 1))
    return {
        "steps": motions * n,
        "loop_wall": wall["loop"] / wall["plant"],
        "loop_cpu": cpu["loop"] / cpu["plant"],
        "rollout_wall": wall["rollout"] / wall["plant"],
        "rollout_cpu": cpu["rollout"] / cpu["plant"],
        "us_a_step": 1e6 * cpu["plant"] / (motions * n),
    }


# Cases --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An effect that is hidden in a model, or none."""

    package: str
    model: str
    effect: str = ""
    target: str = ""
    values: tuple[float, ...] = ()
    seed: int = 0
    part: float = 0.3
    """of the ranges of commands"""

    @property
    def name(self) -> str:
        """As its file is called."""
        what = f"{self.effect}-{self.target}" if self.effect else "nothing"
        return f"{self.package}-{Path(self.model).stem}-{what}-{self.seed}"


CHEETAH, HOPPER, WALKER = (
    ("gymnasium", "half_cheetah.xml"),
    ("dm_control", "hopper.xml"),
    ("dm_control", "walker.xml"),
)
CASES = (
    Case(*CHEETAH, "contact_friction", "ground", (0.5,), 101),
    Case(*CHEETAH, seed=102),
    Case(*CHEETAH, "coulomb_friction", "bthigh", (4.0, 0.01), 103),
    Case(*CHEETAH, "actuator_delay", "fthigh", (0.03,), 104),
    Case(*CHEETAH, "body_mass", "fshin", (0.5,), 105),
    Case(*CHEETAH, "viscous_friction", "bshin", (3.0,), 106),
    Case(*CHEETAH, "actuator_gain", "bfoot", (0.75,), 107),
    Case(*HOPPER, "actuator_gain", "knee", (0.75,), 108, 0.5),
    Case(*HOPPER, "viscous_friction", "hip", (1.0,), 109, 0.5),
    Case(*HOPPER, "contact_friction", "ground", (0.5,), 110, 0.5),
    Case(*HOPPER, seed=111, part=0.5),
    Case(*WALKER, "body_mass", "right_leg", (0.6,), 112),
    Case(*WALKER, "actuator_delay", "left_hip", (0.03,), 113),
)


def recorded(
    plant: MujocoPlant, case: Case, count: int = 5, seconds: float = 5.0
) -> list[Recording]:
    """Noisy recordings of the model with the effect, simulated with a quarter of its timestep."""
    rng, model = np.random.default_rng(case.seed), mujoco.MjModel.from_xml_path(str(path_of(case)))
    model.opt.timestep = plant.model.opt.timestep / 4.0
    truth = replace(plant, model=model)
    if case.effect:
        hidden = EffectInstance(CATALOGUE[case.effect], case.target)
        truth = truth.having([(hidden, case.values)])
    layout, T = plant.layout, round(seconds / HELD_S)
    found = []
    for n in range(count):
        u = commands(plant, rng, T, 5, case.part)
        y = truth.simulate(plant.rest[None], u[None], HELD_S)[0]
        y += rng.normal(0.0, 1.0, y.shape) * np.tile(NOISE, len(layout.joints))
        found.append(
            Recording(
                f"run{n}",
                HELD_S * np.arange(T + 1),
                y,
                np.concatenate([u, u[-1:]]),
                layout.states,
                layout.inputs,
                angles=plant.angles,
                velocities=tuple((k, k + 1) for k in range(0, y.shape[1], 2)),
            )
        )
    return found


def path_of(case: Case) -> Path:
    """The file of its model."""
    return next(p for pack, name, p in shipped() if (pack, name) == (case.package, case.model))


def tried(case: Case) -> dict[str, Any]:
    """What an investigation finds in a case."""
    plant = read_plant(path_of(case))
    assert isinstance(plant, MujocoPlant)
    recordings = recorded(plant, case)
    begun = time.perf_counter(), time.process_time()
    gap = investigate(plant, recordings)
    found = [
        {"name": e.name, "target": e.target, "family": list(e.family), "probability": e.probability}
        | {"values": {k: v.value for k, v in e.parameters.items()}}
        for e in gap.named
    ]
    return {
        "case": case.name,
        "truth": [case.effect, case.target, list(case.values)],
        "verdict": gap.verdict,
        "found": found,
        "closest": [str(e.name) + f" ({e.target})" for e in gap.closest.effects]
        if gap.closest
        else [],
        "closed": gap.comparison.closed.value if gap.comparison else None,
        "wall_s": time.perf_counter() - begun[0],
        "cpu_s": time.process_time() - begun[1],
        "machine": machine(),
    }


def judged(result: dict[str, Any]) -> str:
    """Right, in the family, wrong (and sure), or unknown."""
    name, target, _ = result["truth"]
    found = [(each["name"], each["target"]) for each in result["found"]]
    if result["verdict"] == "unknown":
        return "unknown"
    if not name:
        return "right" if not found else "wrong, sure" if _sure(result) else "wrong"
    if found == [(name, target)]:
        return "right"
    if len(found) == 1 and name in result["found"][0]["family"]:
        return "in the family"
    if (name, target) in found:
        return "right, and more"
    return "wrong, sure" if _sure(result) else "wrong"


def _sure(result: dict[str, Any]) -> bool:
    return any(each["probability"] > 0.9 for each in result["found"])


# The page -----------------------------------------------------------------------------------------


def write_page(out: Path) -> None:
    """The tables of all results that are there."""
    models, speeds, cases = (kept(out / "results" / part) for part in ("models", "speed", "cases"))
    fill(
        out / "README.md", [*_models(models), *_speeds(speeds), *_cases(cases)], HERE / "README.md"
    )


def _models(results: Sequence[dict[str, Any]]) -> list[str]:
    if not results:
        return []
    rows = [
        (
            each["package"],
            f"`{name}`",
            *(
                (m["kind"], str(m["dofs"]), _yes(m["equal"]))
                if m["loads"]
                else ("nothing: it has no joints", "", "")
            ),
        )
        for each in results
        for name, m in each["models"].items()
    ]
    moving = [m for each in results for m in each["models"].values() if m["loads"]]
    head = ("package", "model", "simulated by", "degrees of freedom", "1 s equals mj_step")
    return [
        "### Models\n\n"
        f"{len(moving)} models load; 1 s of random inputs equals a plain loop of `mj_step` to the "
        f"last bit in {sum(m['equal'] for m in moving)}.\n\n{markdown(head, rows)}",
    ]


def _yes(true: bool) -> str:
    return "yes" if true else "no"


def _speeds(results: Sequence[dict[str, Any]]) -> list[str]:
    if not results:
        return []
    numbers = "loop_wall", "loop_cpu", "rollout_wall", "rollout_cpu"
    rows = [
        (f"`{name}`", f"{s['us_a_step']:.1f}", *(f"{s[k]:.2f}" for k in numbers))
        for each in results
        for name, s in each["models"].items()
    ]
    head = (
        "model",
        "CPU a timestep [us]",
        "loop, wall",
        "loop, CPU",
        "rollout, wall",
        "rollout, CPU",
    )
    told = "Times of a plain loop and of mujoco.rollout, over that of the plant; best of 3."
    return [f"### Throughput\n\n{markdown(head, rows)}\n{told}"]


def _cases(results: Sequence[dict[str, Any]]) -> list[str]:
    if not results:
        return []
    rows = [
        (
            f"`{each['case']}`",
            each["verdict"],
            ", ".join(
                f"{e['name']} ({e['target']}), {e['probability']:.2f}" for e in each["found"]
            ),
            judged(each),
            f"{each['cpu_s']:.0f}",
            f"{each['wall_s']:.0f}",
        )
        for each in results
    ]
    head = ("hidden", "verdict", "named, with its probability", "judged", "CPU [s]", "wall [s]")
    return [f"### Hidden effects\n\n{markdown(head, rows)}", places(results)]


def main() -> None:
    """Run what is asked for, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("models", "throughput", "cases", "page"))
    parser.add_argument("--only", default="", help="cases or models whose name has this part")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    use_one_thread()
    logging.getLogger("mcpilco").setLevel(logging.ERROR)
    out = folder(HERE, options.out, quick=False)
    if options.what == "models":
        for package in SHIPPED:
            looks = {n: looked_at(p) for pack, n, p in shipped() if pack == package}
            models = {name: look for name, look in looks.items() if look is not None}
            if models:
                content = {"package": package, "models": models}
                keep(out / "results" / "models" / f"{package}.json", content, HERE.name)
    if options.what == "throughput":
        speeds = {}
        for case in (Case(*CHEETAH), Case(*HOPPER), Case("gymnasium", "ant.xml")):
            speeds[f"{case.package}/{case.model}"] = throughput(path_of(case))
            print(case.model, speeds[f"{case.package}/{case.model}"], flush=True)
        keep(out / "results" / "speed" / "speed.json", {"models": speeds}, HERE.name)
    if options.what == "cases":
        for case in CASES:
            path = out / "results" / "cases" / f"{case.name}.json"
            if options.only in case.name and not path.exists():
                keep(path, result := tried(case), HERE.name)
                print(case.name, judged(result), f"{result['wall_s']:.0f} s", flush=True)
    write_page(out)


if __name__ == "__main__":
    main()
