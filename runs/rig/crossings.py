"""Policies that cross over UDP to machines with hidden effects, which a rig simulates by MuJoCo.

    python runs/rig/crossings.py --seeds 5000:5010

A seed chooses what its rig hides. `mcpilco cross --machine` sees a minute of recordings and the
nominal plant alone. Results are kept in results/crossings/, a file a seed, and README.md is
rewritten from them; the same command goes on where it was stopped.
"""

import json
import os
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
PORT = 20000


def crossed(seed: int, work: Path) -> dict:
    """What the best policies of both simulations did on the rig of a seed."""
    port = PORT + seed % 10000
    rig = subprocess.Popen(
        [sys.executable, HERE / "rig.py", "--port", str(port), "--seed", str(seed), "--control"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    out, begun, load = work / str(seed), time.time(), os.getloadavg()[0]
    command = [sys.executable, "-m", "mcpilco.cli", "cross", "--machine", f"udp://127.0.0.1:{port}"]
    command += ["--sim", "mcpilco/CartPoleSwingUp-v0", "--dt", "0.02", "--out", str(out)]
    command += ["--uncertainty", "0.05", "--quiet", "--accept", "--seed", str(seed)]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    finally:
        told = rig.communicate("quit\n")[0].splitlines()[-1]
    (out / "told.txt").write_text(done.stdout + done.stderr)
    found = {"seed": seed, "hidden": hidden(seed), "code": done.returncode}
    found |= {"minutes": round((time.time() - begun) / 60, 1), "rig": json.loads(told)}
    found["load"] = [round(load, 1), round(os.getloadavg()[0], 1)]
    if done.returncode == 0:
        gap = json.loads((out / "gap/gap.json").read_text())
        found["named"] = [f"{e['name']} at {e['target']}" for e in gap["effects"]]
        for leg in ("nominal", "corrected"):
            both = json.loads((out / f"{leg}.json").read_text())
            places = ("promised", "happened")
            found[leg] = {p: [both[p]["success"], both[p]["episodes"]] for p in places}
    return found


def main() -> None:
    first, _, last = sys.argv[sys.argv.index("--seeds") + 1].partition(":")
    for seed in range(int(first), int(last)):
        path = HERE / "results/crossings" / f"{seed}.json"
        if not path.exists():
            found = crossed(seed, WORK)
            print(json.dumps(found), flush=True)
            if found["code"] == 0:
                keep(path, found, HERE.name)
        pages.write()


if __name__ == "__main__":
    main()
