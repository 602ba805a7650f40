"""The time of a step of an exported policy: C, an ONNX graph, and numpy, beside one another.

    python runs/exported_policy/run.py              # two minutes; needs gcc, jinja2 and onnxruntime

For every kind of policy that can be exported: CPU time a step, and the largest difference of an
input from numpy's over the golden vectors, in double and in float.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
PAGE = HERE / "README.md"
sys.path.insert(0, str(HERE.parent))

from harness import fill, folder, hasty, keep, places, use_one_thread  # noqa: E402

import envs  # noqa: E402, F401
from mcpilco.agent import (  # noqa: E402
    MCPILCO,
    NumpyPolicy,
    with_limits,
    write_c,
    write_onnx,
    write_policy,
)
from mcpilco.config import Config, Limit, ModelConfig  # noqa: E402
from mcpilco.sweep import machine, markdown  # noqa: E402

ALL, POSITIONS = "mcpilco/CartPoleSwingUp-v0", "mcpilco/CartPoleSwingUpPositions-v0"
KINDS = {
    "states": (ALL, ModelConfig()),
    "states, limits": (ALL, ModelConfig()),
    "past inputs": (ALL, ModelConfig(memory=2)),
    "positions, Kalman filter": (POSITIONS, ModelConfig()),
    "late by 2 steps": (ALL, ModelConfig(delay=0.2)),
    "late by 1.3 steps": (ALL, ModelConfig(delay=0.13)),
    "positions, late by 1 step": (POSITIONS, ModelConfig(delay=0.1)),
}
LIMITS = (Limit("cart_position", -0.5, 0.5),)
"""of the kind that has some"""
FLAGS = ["-std=c99", "-O2"]
MAIN = """#include <stdio.h>
#include <time.h>
#include "policy.h"
static policy_state s;
int main(void)
{
    policy_real y[POLICY_MEASURED] = {0}, u[POLICY_INPUTS], sum = 0;
    const clock_t begun = clock();
    long i, steps = STEPS;
    for (i = 0; i < steps; i++) {
        if (i % 30 == 0)
            policy_reset(&s);
        y[0] = (policy_real)0.001 * (policy_real)(i % 30);
        policy_step(&s, y, u);
        sum += u[0];
    }
    printf("%.9g %g\\n", (double)(clock() - begun) / CLOCKS_PER_SEC / (double)steps, (double)sum);
    return 0;
}
"""


def compiled(folder: Path, source: str, *flags: str) -> list[str]:
    """The output of a compiled program."""
    program = folder / "program"
    command = ["gcc", *FLAGS, *flags, "-x", "c", folder / source, "-o", program, "-lm"]
    subprocess.run(command, check=True)
    with (folder / "policy.h.golden.csv").open() as golden:
        ran = subprocess.run([program], stdin=golden, capture_output=True, text=True, check=True)
    return re.findall(r"-?[\d.]+(?:e[-+]?\d+)?", ran.stdout)


def cpu_of_steps(act, reset, width: int, steps: int) -> float:
    """CPU time of a step [s], of the measurements that the C program acts on."""
    begun = time.process_time()
    for i in range(steps):
        if i % 30 == 0:
            reset()
        y = np.zeros(width)
        y[0] = 0.001 * (i % 30)
        act(y)
    return (time.process_time() - begun) / steps


class OnnxPolicy:
    def __init__(self, path: Path) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(str(path), options)
        about = json.loads(path.with_name(f"{path.name}.json").read_text())
        self.begins = {k: np.array([v["begins"]]) for k, v in about["state"].items()}
        self.names = [f"next_{name}" for name in self.begins]

    def reset(self) -> None:
        self.state = self.begins

    def __call__(self, y: np.ndarray) -> np.ndarray:
        found = self.session.run(["inputs", *self.names], {"measured": y[None], **self.state})
        self.state = dict(zip(self.begins, found[1:], strict=True))
        return found[0][0]


def measured(kind: str, config: Config, vectors: int) -> dict:
    env, model = KINDS[kind]
    config = replace(config, model=model)
    config = with_limits(config, LIMITS) if "limits" in kind else config
    agent = MCPILCO("SumOfGaussians", env, config=config, seed=0)
    agent.learn(2 * agent.horizon)
    parts = agent.policy, agent.task, agent.estimator
    found: dict = {"kind": kind}
    with tempfile.TemporaryDirectory() as place:
        here = Path(place)
        write_c(here / "policy.h", *parts, vectors)
        (here / "main.c").write_text(MAIN)
        steps = 2_000 if model.delay else 200_000
        for real, flags in (("double", ()), ("float", ("-DPOLICY_FLOAT",))):
            said = compiled(here, "policy.h", "-DPOLICY_CHECK", *flags)
            found[real] = {"difference": float(said[1]), "state_bytes": int(said[2])}
            times = [compiled(here, "main.c", f"-DSTEPS={steps}", *flags)[0] for _ in range(5)]
            found[real]["us"] = 1e6 * float(np.median([float(t) for t in times]))
        numpy_policy = NumpyPolicy(write_policy(here / "policy.npz", *parts))
        width = len(agent.task.measured_states)
        turns = [cpu_of_steps(numpy_policy, numpy_policy.reset, width, 600) for _ in range(3)]
        found["numpy_us"] = 1e6 * float(np.median(turns))
        if not model.delay:
            onnx = OnnxPolicy(write_onnx(here / "policy.onnx", *parts, 0)[0])
            turns = [cpu_of_steps(onnx, onnx.reset, width, 2_000) for _ in range(3)]
            found["onnx_us"] = 1e6 * float(np.median(turns))
        found["header_kB"] = (here / "policy.h").stat().st_size / 1e3
    return found


def table(results: list[dict]) -> str:
    header = ["policy", "C, double: µs a step", "C, float", "numpy", "ONNX", "numpy / C"]
    header += ["differs, double", "differs, float", "memory, double", "header"]
    rows = []
    for r in results:
        d, f = r["double"], r["float"]
        row = [r["kind"], f"{d['us']:.3g}", f"{f['us']:.3g}", f"{r['numpy_us']:.0f}"]
        row += [f"{r['onnx_us']:.0f}" if "onnx_us" in r else "none"]
        row += [f"{r['numpy_us'] / d['us']:.0f}", f"{d['difference']:.1e}"]
        row += [f"{f['difference']:.1e}", f"{d['state_bytes']:,} B", f"{r['header_kB']:.0f} kB"]
        rows.append(row)
    return markdown(header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="show that it works")
    parser.add_argument("--out", type=Path, help="folder of results.json and README.md")
    arguments = parser.parse_args()
    use_one_thread()
    place = folder(HERE, arguments.out, arguments.quick)
    config = Config()
    kinds = list(KINDS)[:1] if arguments.quick else KINDS
    short = replace(config, search=replace(config.search, steps=(60,), restarts=(0,)))
    chosen = hasty(config) if arguments.quick else short
    results = [measured(kind, chosen, 200 if arguments.quick else 10_000) for kind in kinds]
    keep(place / "results.json", {"results": results}, HERE.name)
    fill(place / "README.md", [table(results), places([{"machine": machine()}])], PAGE)


if __name__ == "__main__":
    main()
