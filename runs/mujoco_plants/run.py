"""Any MuJoCo model is a plant: which of the shipped ones load, how fast they are, what is found.

python runs/mujoco_plants/run.py models        # every MJCF of three packages, equal to mj_step?
python runs/mujoco_plants/run.py throughput    # beside a plain loop of mj_step, mujoco.rollout
python runs/mujoco_plants/run.py study --seeds 1000:1060   # hidden effects in others' models
python runs/mujoco_plants/run.py study --seeds 5048:5088   # in arms for which nothing was developed
python runs/mujoco_plants/run.py sysid --seeds 100:120     # beside mujoco.sysid, on its tutorial
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import beside_sysid
from harness import fill, folder, keep, kept, once, parse_seeds, places, use_one_thread
from study import judged, summary, tried
from truth import HELD_S, MACHINES, OTHERS_FROM

from mcpilco.mjcf import MujocoPlant, load_mjcf, mujoco_plant, read_plant
from mcpilco.sweep import markdown
from mcpilco.typing import InputError

HERE = Path(__file__).parent
SHIPPED = {
    "gymnasium": "envs/mujoco/assets",
    "dm_control": "suite",
    "gymnasium_robotics": "envs/assets",
}
"""packages with models, and where they are in them"""
PARTS = ("models", "throughput", "study", "sysid")
MEASURED = ("half_cheetah", "walker", "quadruped", "panda on motors", "ur5e on motors")
"""machines whose throughput is measured"""


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


def throughput(path: Path, motions: int = 100, seconds: float = 1.0) -> dict[str, float]:
    """CPU and wall time of the plant's batch, in those of a plain loop and of mujoco.rollout."""
    from mujoco import rollout

    plant = read_plant(path, "mujoco")
    assert isinstance(plant, MujocoPlant)
    model, n = plant.model, round(seconds / plant.model.opt.timestep)
    rng = np.random.default_rng(0)
    u = np.stack([commands(plant, rng, n, 5) for _ in range(motions)])
    start = np.tile(plant.rest, (motions, 1))
    qpos = plant.coordinates.qpos(start[:, 0::2])
    clock, act = np.zeros((motions, 1)), np.zeros((motions, model.na))
    state = np.concatenate([clock, qpos, start[:, 1::2], act], axis=1)
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


# The page -----------------------------------------------------------------------------------------


def write_page(out: Path) -> None:
    """The tables of all results that are there."""
    parts = {
        "models": _models,
        "speed": _speeds,
        "study": _study,
        "sysid": _beside_sysid,
    }
    written = [
        text for part, write in parts.items() for text in write(kept(out / "results" / part))
    ]
    fill(out / "README.md", written, HERE / "README.md")


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


def _study(results: Sequence[dict[str, Any]]) -> list[str]:
    kinds = "### Hidden effects", "### Hidden effects in arms for which nothing was developed"
    own: tuple[list[dict[str, Any]], ...] = [], []
    for each in results:
        own[each["seed"] >= OTHERS_FROM].append(each)
    parts = [
        part for kind, some in zip(kinds, own, strict=True) if some for part in _hidden(kind, some)
    ]
    return [*parts, places([{"machine": each["place"]} for each in results])] if results else []


def _hidden(title: str, results: Sequence[dict[str, Any]]) -> list[str]:
    head = (
        *("machine", "cases", "right or in the family", "nothing hidden: nothing named"),
        *("wrong and sure", "CPU minutes a case: median (most)"),
    )
    rows = [
        (
            str(each["seed"]),
            each["machine"],
            " ".join(each["truth"][:2]) or "nothing",
            f"{each['truth'][2]:.3g}" if each["truth"][0] else "",
            each["verdict"],
            ", ".join(_named(e) for e in each["found"] or each["closest"]),
            judged(each),
            f"{each['cpu_s'] / 60.0:.1f}",
        )
        for each in sorted(results, key=lambda each: each["seed"])
    ]
    told = ("seed", "machine", "hidden", "size", "verdict", "named, or what comes closest")
    return [
        f"{title}\n\n{markdown(head, summary(results))}",
        markdown((*told, "judged", "CPU [min]"), rows),
    ]


def _beside_sysid(results: Sequence[dict[str, Any]]) -> list[str]:
    if not results:
        return []
    tools = {"sysid": "mujoco.sysid", "equations": "mcpilco's equations, scipy's least squares"}
    errors = {
        t: [np.array(r[t]["armatures"]) / beside_sysid.TRUTH - 1.0 for r in results] for t in tools
    }
    cpu = {t: np.array([r[t]["cpu_s"] for r in results]) for t in tools}
    rows = [
        (
            told,
            *(f"{100.0 * e:.1f}" for e in np.sqrt(np.square(errors[t]).mean(axis=0))),
            f"{100.0 * np.sqrt(np.square(errors[t]).mean()):.1f}",
            f"{np.median(cpu[t]):.2f} ({cpu[t].max():.2f})",
        )
        for t, told in tools.items()
    ]
    head = ("tool", *beside_sysid.JOINTS, "all", "CPU [s]: median (most)")
    ratio = np.median(cpu["equations"] / cpu["sysid"])
    squares = {t: np.square(error).mean(axis=1) for t, error in errors.items()}
    closer = int((squares["equations"] < squares["sysid"]).sum())
    return [
        f"### Beside mujoco.sysid\n\nErrors of the armatures, rms over {len(results)} noises [%].",
        f"{markdown(head, rows)}\nThe equations take {ratio:.2f} times as long (median of the "
        f"ratios), and are the closer ones in {closer} of {len(results)}.",
    ]


def _named(effect: dict[str, Any]) -> str:
    values = ", ".join(f"{value:.3g}" for value in effect["values"].values())
    return f"{effect['name']} ({effect['target']}) {values}, p {effect['probability']:.2f}"


def main() -> None:
    """Run what is asked for, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=(*PARTS, "page"))
    parser.add_argument("--seeds", default="1000:1060", help="of the study, as 1000:1060")
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
        speeds = {name: throughput(MACHINES[name].path) for name in MEASURED}
        keep(out / "results" / "speed" / "speed.json", {"models": speeds}, HERE.name)
    if options.what == "study":
        for seed in parse_seeds(options.seeds):
            if result := once(out / "results" / "study" / f"{seed}.json", HERE.name, tried, seed):
                print(seed, result["machine"], *result["truth"], judged(result), flush=True)
    if options.what == "sysid":
        for seed in parse_seeds(options.seeds):
            once(out / "results" / "sysid" / f"{seed}.json", HERE.name, beside_sysid.fitted, seed)
    write_page(out)


if __name__ == "__main__":
    main()
