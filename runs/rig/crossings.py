"""Policies that cross over UDP to machines with hidden effects, which a rig simulates by MuJoCo.

    python runs/rig/crossings.py --seeds 5021:5031

A seed chooses what its rig hides. `mcpilco cross --machine` sees a minute of recordings and the
nominal plant alone. No machine has a part in the training in the nominal simulation, so that of the
first crossing is that of all. Results are kept in results/crossings/, a file a seed, and README.md
is rewritten from them; the same command goes on where it was stopped. Other results, such as those
of seeds below 5000, go elsewhere: `--results runs/out/rig/results`.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent)]

import pages  # noqa: E402
from harness import keep  # noqa: E402
from rig import hidden  # noqa: E402

WORK = ROOT / "runs/out/rig"
NOMINAL = WORK / "nominal"
"""the training in the nominal simulation"""
PORT = 20000
TIMES = 3
"""in which the command is given, where a fault of the machine ended it"""


def crossed(seed: int) -> dict:
    """Rollouts of the best policies of both simulations on the rig of a seed."""
    out, port = WORK / str(seed), PORT + seed % 10000
    if NOMINAL.exists() and not (out / "nominal").exists():
        shutil.copytree(NOMINAL, out / "nominal")
    rig = [sys.executable, HERE / "rig.py", "--port", str(port), "--seed", str(seed), "--control"]
    command = [sys.executable, "-m", "mcpilco.cli", "cross", "--machine", f"udp://127.0.0.1:{port}"]
    command += ["--sim", "mcpilco/CartPoleSwingUp-v0", "--dt", "0.02", "--out", str(out)]
    command += ["--uncertainty", "0.05", "--accept", "--seed", str(seed)]
    begun, load, times = time.time(), os.getloadavg()[0], 0
    with subprocess.Popen(rig, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as machine:
        code = 2
        while code == 2 and times < TIMES:  # "give the same command again"
            done = subprocess.run(
                ["nice", "-n", "5", *command], cwd=ROOT, capture_output=True, text=True, check=False
            )
            code, times = done.returncode, times + 1
            out.mkdir(parents=True, exist_ok=True)
            with (out / "told.txt").open("a") as told:
                told.write(done.stdout + done.stderr)
        counts = json.loads(machine.communicate("quit\n")[0].splitlines()[-1])
    found = {"seed": seed, "hidden": hidden(seed), "code": code, "times": times, "rig": counts}
    found |= {"minutes": round((time.time() - begun) / 60, 1)}
    found["load"] = [round(load, 1), round(os.getloadavg()[0], 1)]
    if code == 0:
        gap = json.loads((out / "gap/gap.json").read_text())
        found["verdict"] = gap["verdict"]
        found["named"] = [f"{e['name']} at {e['target']}" for e in gap["effects"]]
        for leg in ("nominal", "corrected"):
            both = json.loads((out / f"{leg}.json").read_text())
            places = ("promised", "happened")
            found[leg] = {p: [both[p]["success"], both[p]["episodes"]] for p in places}
        if not NOMINAL.exists():
            shutil.copytree(out / "nominal", NOMINAL)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", required=True, help="5021:5031 are 5021 to 5030")
    parser.add_argument("--results", type=Path, default=HERE / "results/crossings")
    options = parser.parse_args()
    first, _, last = options.seeds.partition(":")
    options.results.mkdir(parents=True, exist_ok=True)
    for seed in range(int(first), int(last)):
        path = options.results / f"{seed}.json"
        if not path.exists():
            found = crossed(seed)
            print(json.dumps(found), flush=True)
            if found["code"] not in (130, -2):  # stopped by hand: the same command goes on
                keep(path, found, HERE.name)
        pages.write()


if __name__ == "__main__":
    main()
