"""How often `mcpilco gap` names an effect that a seed has hidden in recordings.

python runs/hidden_effects/run.py                            # all tiers, 40 cases each
python runs/hidden_effects/run.py --tiers one --seeds 0:100

Each case is simulated by other means than ours (truth.py), written as CSV files, and investigated
with the nominal plant alone. Results are kept in results/<tier>/, a file a seed; the same command
goes on where it was stopped, and rewrites README.md between its marked lines.
"""

from __future__ import annotations

import csv
import json
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro
from cases import TIERS, Case, draw
from confusion import write_picture
from identified import identified, missing
from peers import peers

from mcpilco.archive import write_bytes
from mcpilco.cli.sweep import parse_seeds
from mcpilco.sweep import job
from mcpilco.sweep.page import fill
from mcpilco.sweep.summary import markdown, rate, rate_cell

if TYPE_CHECKING:
    from mcpilco.plant import Plant

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Arguments:
    """Hide effects, look for them, and write the tables."""

    seeds: str = "0:40"
    """`0:40` are 0 to 39"""
    tiers: tuple[Literal[*TIERS], ...] = tuple(TIERS)
    """kinds of cases"""
    workers: int = 2
    """processes at a time"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    if missing():
        print(missing())
    results = arguments.out / "results"
    todo = [
        (tier, seed, results / tier / f"{seed:04d}.json")
        for seed in parse_seeds(arguments.seeds)
        for tier in arguments.tiers
        if not (results / tier / f"{seed:04d}.json").exists()
    ]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.workers, context) as pool:
        waiting = {pool.submit(solve, tier, seed): path for tier, seed, path in todo}
        for done in as_completed(waiting):
            found, path = done.result(), waiting[done]
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, json.dumps(found, indent=1).encode())
            told = [(e["name"], e["target"]) for e in found["found"]]
            truth = [(e["name"], e["target"]) for e in found["truth"]]
            mark = "right" if right(found) else "wrong"
            print(f"{path.parent.name} {found['seed']}: {mark}, {truth}: {found['verdict']} {told}")
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return 0


def solve(tier: str, seed: int) -> dict[str, Any]:
    """What was hidden, and what was found in its recordings."""
    job.one_thread()
    from mcpilco.gap.investigate import investigate
    from mcpilco.gap.report import to_json
    from mcpilco.recordings import read_recordings

    case = draw(seed, TIERS[tier])
    plant = nominal(case.plant)
    layout = plant.layout
    with tempfile.TemporaryDirectory() as folder:
        paths = write(case, Path(folder))
        good, bad = read_recordings(
            paths,
            layout.states,
            layout.inputs,
            angles=plant.angles,
            velocities=tuple((k, k + 1) for k in range(0, len(layout.states), 2)),
            dt=0.02,
        )
    assert not bad, bad
    spent = time.process_time()
    uncertainty = 0.03 if TIERS[tier].laboratory else 0.01
    told = to_json(investigate(plant, good, uncertainty=uncertainty))
    spent = time.process_time() - spent
    others = peers(plant, good)
    theirs = time.process_time()
    toolbox = None if missing() else identified(plant, good)
    theirs = time.process_time() - theirs
    others |= toolbox.terms if toolbox else {}
    return {
        "seed": seed,
        "plant": case.plant,
        "velocities": case.velocities,
        "truth": list(case.effects),
        "verdict": told["verdict"],
        "found": told["effects"],
        "where": told["where"],
        "peers": {name: list(map(list, terms)) for name, terms in others.items()},
        "identified": {"remarks": toolbox.remarks, "cpu_s": theirs} if toolbox else None,
        "error": told["error"],
        "events": told["events"],
        "cpu_s": spent,
        "machine": job.machine(),
    }


def nominal(name: str) -> Plant:
    """The plant of an env, or of an MJCF file beside this one."""
    if name.endswith(".xml"):
        from mcpilco.mjcf import plant_of

        return plant_of(HERE / name)
    from envs.plants import PLANTS

    return PLANTS[name]()


def write(case: Case, folder: Path) -> list[Path]:
    """The recordings of a case as CSV files."""
    paths = []
    for number, columns in enumerate(case.recordings):
        paths.append(folder / f"recording_{number}.csv")
        with paths[-1].open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(columns)
            rows.writerows(zip(*columns.values(), strict=True))
    return paths


# Verdicts -----------------------------------------------------------------------------------------


def right(found: Mapping[str, Any]) -> bool:
    """Whether name and target of all effects, or the verdict none or unknown, are right."""
    if any(effect["name"] == "outside" for effect in found["truth"]):
        return found["verdict"] == "unknown"
    if not found["truth"]:
        return found["verdict"] == "none"
    truth = {(effect["name"], effect["target"]) for effect in found["truth"]}
    told = {(effect["name"], effect["target"]) for effect in found["found"]}
    return found["verdict"] == "named" and truth == told


def in_family(found: Mapping[str, Any]) -> bool:
    """Whether each hidden effect is in the family of one that was named."""
    if right(found):
        return True
    families = [set(effect["family"]) for effect in found["found"]]
    names = [effect["name"] for effect in found["truth"]]
    fits = all(any(name in family for family in families) for name in names)
    return found["verdict"] == "named" and len(names) == len(families) > 0 and fits


def misnamed(found: Mapping[str, Any]) -> bool:
    """Whether a wrong effect was named, and confidently."""
    names = {effect["name"] for effect in found["truth"]}
    wrong = [e for e in found["found"] if not names & set(e["family"]) and e["probability"] > 0.9]
    return found["verdict"] == "named" and bool(wrong)


# The page -----------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {
        tier: [json.loads(p.read_text()) for p in sorted((out / "results" / tier).glob("*.json"))]
        for tier in TIERS
    }
    found = {tier: cases for tier, cases in found.items() if cases}
    parts = [naming(found), numbers(found), places(found), pictures(found, out), missed(found)]
    parts = parts if found else ["Not measured yet."]
    fill(out / "README.md", parts, template=HERE / "README.md")


def naming(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """How often the verdict is right."""
    rows = []
    for tier, cases in found.items():
        names = dict.fromkeys(name for case in cases for name in case["peers"])
        by_method = {tier: cases}
        by_method |= {
            f"{tier}: {name}": [as_told_by(name, case) for case in cases if name in case["peers"]]
            for name in names
        }
        rows += [
            (
                method,
                str(len(told)),
                rate_cell(rate([right(case) for case in told])),
                rate_cell(rate([in_family(case) for case in told])),
                rate_cell(rate([misnamed(case) for case in told])),
            )
            for method, told in by_method.items()
        ]
    header = ("tier", "cases", "right [%]", "right, or in a family [%]", "wrong and sure [%]")
    return "\n\n".join(part for part in (markdown(header, rows), fits(found)) if part)


def fits(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """What is to be said of the fits of mujoco.sysid: which failed, and what they cost."""
    told = [fit for cases in found.values() for case in cases if (fit := case.get("identified"))]
    if not told:
        return ""
    remarks = Counter(remark for fit in told for remark in fit["remarks"])
    counted = "; ".join(f"{remark}: {count}" for remark, count in remarks.most_common())
    seconds = [fit["cpu_s"] for fit in told]
    return (
        f"mujoco.sysid, {len(told)} cases: {np.median(seconds):.0f} CPU s in the median, "
        f"{max(seconds):.0f} in the worst. {counted or 'All fits converged'}."
    )


def as_told_by(peer: str, case: Mapping[str, Any]) -> dict[str, Any]:
    """The case with what another method names; that is sure, and has no families."""
    named = [
        {"name": name, "target": target, "family": [name], "probability": 1.0}
        for name, target in case["peers"][peer]
    ]
    return {**case, "found": named, "verdict": "named" if named else "none"}


def numbers(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Errors and intervals of the parameters, the gap closed, and the time it takes."""
    rows = []
    for tier, cases in found.items():
        errors, covered = accuracy([case for case in cases if right(case)])
        closed = [c["error"]["closed"]["value"] for c in cases if c["error"] and mended(c)]
        seconds = [case["cpu_s"] for case in cases]
        rows.append(
            (
                tier,
                f"{100 * np.median(errors):.2f}" if errors else "-",
                f"{100 * np.mean(covered):.0f} (of {len(covered)})" if covered else "-",
                f"{100 * np.median(closed):.1f}, {100 * np.percentile(closed, 10):.1f}"
                if closed
                else "-",
                f"{np.median(seconds):.0f}, {max(seconds):.0f}",
            )
        )
    header = ("tier", "median error of parameters [%]", "95 % intervals that hold the truth [%]")
    header += ("gap closed: median, tenth percentile [%]", "CPU: median, worst [s]")
    return markdown(header, rows)


def mended(case: Mapping[str, Any]) -> bool:
    """Whether something was added to the nominal plant: an effect, or a learned force."""
    return bool(case["found"]) or any("joint" in part for part in case["where"])


def places(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Of effects that are not in the catalogue, how often the joint is told in which they act."""
    rows = []
    for kind in dict.fromkeys(
        e.get("kind", "") for c in found.get("outside", []) for e in c["truth"]
    ):
        cases = [case for case in found["outside"] if case["truth"][0].get("kind") == kind]
        unknown = [case for case in cases if case["verdict"] == "unknown"]
        told = [part for case in unknown if (part := in_joint(case)) is not None]
        closed = [case["error"]["closed"]["value"] for case in unknown if mended(case)]
        rows.append(
            (
                kind,
                str(len(cases)),
                str(len(unknown)),
                str(len(told)),
                rate_cell(rate(told)) if told else "-",
                f"{100 * np.median(closed):.1f}" if closed else "-",
            )
        )
    header = ("outside", "cases", "unknown", "force learned", "in the right joint [%]")
    table = markdown((*header, "gap closed: median [%]"), rows)
    return f"### What is not in the catalogue\n\n{table}" if rows else ""


def in_joint(case: Mapping[str, Any]) -> bool | None:
    """Whether the largest learned force is in a joint where one was hidden; None without one."""
    told = [part for part in case["where"] if "joint" in part]
    if not told:
        return None
    effect = case["truth"][0]
    return effect["kind"] == "coupling" or told[0]["joint"] == effect["target"]


def pictures(found: Mapping[str, Sequence[Mapping[str, Any]]], out: Path) -> str:
    """What was hidden against what was named, a picture a tier."""
    paths = {
        tier: write_picture(tier, cases, out / f"confusion-{tier}.png")
        for tier, cases in found.items()
    }
    lines = [f"![Hidden against named, {tier}]({path.name})" for tier, path in paths.items()]
    return "### What was hidden, and what was named\n\n" + "\n\n".join(lines)


def accuracy(cases: Sequence[Mapping[str, Any]]) -> tuple[list[float], list[bool]]:
    """Relative errors of the parameters, and whether their intervals hold the truth."""
    errors, covered = [], []
    for case in cases:
        told = {(e["name"], e["target"]): e["parameters"] for e in case["found"]}
        for effect in case["truth"]:
            estimates = told.get((effect["name"], effect["target"]), {})
            for symbol, truth in effect.get("parameters", {}).items():
                if symbol in estimates:
                    estimate = estimates[symbol]
                    errors.append(abs(estimate["value"] - truth) / max(abs(truth), 1e-12))
                    covered.append(estimate["low"] <= truth <= estimate["high"])
    return errors, covered


def missed(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The cases that are not right."""
    lines = []
    for tier, cases in found.items():
        for case in cases:
            if not right(case):
                truth = ", ".join(f"{e['name']} at {e['target']}" for e in case["truth"]) or "none"
                told = ", ".join(f"{e['name']} at {e['target']}" for e in case["found"]) or "-"
                lines.append(
                    f"- {tier}, seed {case['seed']}, {case['plant']}: hidden {truth}; "
                    f"verdict {case['verdict']}, named {told}"
                )
    return "### Cases that are not right\n\n" + "\n".join(lines) if lines else ""


if __name__ == "__main__":
    sys.exit(main())
