"""How often `mcpilco gap` names an effect that a seed has hidden in recordings.

python runs/hidden_effects/run.py                            # all tiers, 38 cases each
python runs/hidden_effects/run.py --quick                    # one case of each tier, no peers
python runs/hidden_effects/run.py --only-tables              # of the results that are there
python runs/hidden_effects/run.py --tiers one --seeds 0:100 --no-peers

Each case is simulated by other means than ours (truth.py), written as CSV files, and investigated
with the nominal plant alone. Results are kept in results/<tier>/, a file a seed; the same command
goes on where it was stopped, adds the peers where they were left out, and rewrites README.md
between its marked lines.
"""

from __future__ import annotations

import csv
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from cases import TIERS, Case, Tier, draw
from harness import keep, parse_seeds, use_one_thread
from identified import identified, missing
from page import write_readme
from peers import peers
from verdicts import right

from mcpilco.logbook import read_json
from mcpilco.sweep import machine
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.plant import Plant
    from mcpilco.recordings import Recording

HERE = Path(__file__).parent
REFUSED: dict[str, Any] = {
    "verdict": "refused",
    "effects": [],
    "where": [],
    "error": None,
    "left": [],
    "events": [],
    "closest": None,
}
"""of a case whose recordings the workflow does not take"""


@dataclass(frozen=True)
class Arguments:
    """Hide effects, look for them, and write the tables."""

    seeds: str = "1280:1318"
    """`1280:1318` are 1280 to 1317"""
    tiers: tuple[Literal[*TIERS], ...] = tuple(TIERS)
    """kinds of cases"""
    peers: bool = True
    """whether the peers are tried too; mujoco.sysid takes longer than all else"""
    quick: bool = False
    """the first seed alone, without the peers"""
    only_tables: bool = False
    """run nothing: write the tables and pictures of the results that are there"""
    workers: int = 2
    """processes at a time"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    if not arguments.only_tables:
        run(arguments)
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return 0


def run(arguments: Arguments) -> None:
    """Solves the cases that have no result yet, and stores each as soon as it is there."""
    with_peers = arguments.peers and not arguments.quick
    if with_peers and missing():
        print(missing())
    seeds = parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]
    todo = [
        (tier, seed, arguments.out / "results" / tier / f"{seed:04d}.json")
        for seed in seeds
        for tier in arguments.tiers
    ]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.workers, context) as pool:
        waiting = {
            pool.submit(solve, tier, seed, known, with_peers): path
            for tier, seed, path in todo
            if not finished(known := read_json(path) if path.exists() else {}, with_peers)
        }
        for done in as_completed(waiting):
            found, path = done.result(), waiting[done]
            keep(path, found, HERE.name, continued=path.exists())
            told = [(e["name"], e["target"]) for e in found["found"]]
            truth = [(e.get("kind", e["name"]), e["target"]) for e in found["truth"]]
            mark = "right" if right(found) else "wrong"
            print(f"{path.parent.name} {found['seed']}: {mark}, {truth}: {found['verdict']} {told}")


def finished(known: dict[str, Any], with_peers: bool) -> bool:
    """Whether a result has all that is asked for."""
    return bool(known) and ("peers" in known or not with_peers)


def solve(tier: str, seed: int, known: dict[str, Any], with_peers: bool) -> dict[str, Any]:
    """The effects that were hidden, and those that were found in the recordings.

    Args:
        tier: kind of case.
        seed: of everything random.
        known: a result that lacks the peers, or nothing.
        with_peers: whether they are tried.
    """
    use_one_thread()
    case = draw(seed, TIERS[tier])
    plant = nominal(case.plant)
    recordings = read(case, plant, TIERS[tier].dt)
    found = known or ours(case, TIERS[tier], plant, recordings)
    return found | theirs(plant, recordings) if with_peers else found


def ours(case: Case, tier: Tier, plant: Plant, recordings: Sequence[Recording]) -> dict[str, Any]:
    """The verdict of the workflow on a case."""
    from mcpilco.gap import investigate, to_json

    spent = time.process_time()
    try:
        told = to_json(investigate(plant, recordings, uncertainty=tier.uncertainty))
    except InputError:  # the recordings look wrong to it, which they are not
        told = REFUSED
    spent = time.process_time() - spent
    return {
        "seed": case.seed,
        "plant": case.plant,
        "velocities": case.velocities,
        "truth": list(case.effects),
        "besides": list(case.besides),
        "beyond": case.beyond(tier.uncertainty),
        "verdict": told["verdict"],
        "found": told["effects"],
        "where": told["where"],
        "error": told["error"],
        "left": told["left"],
        "events": told["events"],
        "closest": told["closest"],
        "cpu_s": spent,
        "machine": machine(),
    }


def theirs(plant: Plant, recordings: Sequence[Recording]) -> dict[str, Any]:
    """The effects that the peers name."""
    told = peers(plant, recordings)
    if missing():
        return {"peers": _lists(told), "identified": None}
    spent = time.process_time()
    toolbox = identified(plant, recordings)
    spent = time.process_time() - spent
    remarks = {"remarks": toolbox.remarks, "cpu_s": spent}
    return {"peers": _lists(told | toolbox.terms), "identified": remarks}


def _lists(terms: dict[str, list[tuple[str, str]]]) -> dict[str, list[list[str]]]:
    return {name: list(map(list, pairs)) for name, pairs in terms.items()}


def read(case: Case, plant: Plant, dt: float) -> Sequence[Recording]:
    """The recordings of a case, as the workflow reads them from its files every dt [s]."""
    from mcpilco.recordings import read_recordings

    layout = plant.layout
    with tempfile.TemporaryDirectory() as folder:
        good, bad = read_recordings(
            write(case, Path(folder)),
            layout.states,
            layout.inputs,
            angles=plant.angles,
            velocities=tuple((k, k + 1) for k in range(0, len(layout.states), 2)),
            dt=dt,
        )
    assert not bad, bad
    return good


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


if __name__ == "__main__":
    sys.exit(main())
