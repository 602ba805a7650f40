"""How long one policy step takes, against a plain implementation of the same work.

    python runs/speed_policy_step.py --particles 400 --samples 60 --steps 60
    python runs/speed_policy_step.py --all      # minutes: runs/speed/README.md

The plain implementation is runs/speed/plain.py; `--yardstick PATH` takes another file with the same
`make(samples, bases=)` and `policy_step(gps, policy, optimiser, particles, steps)`. Both run on one
thread of one process, in turn; the medians of the CPU times are compared. `--json` prints one JSON
object as the last line.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import torch
import tyro
from speed.step import Size


@dataclass(frozen=True)
class Arguments:
    """A setting that is timed."""

    yardstick: Path = Path(__file__).parent / "speed" / "plain.py"
    """file with the plain implementation"""
    particles: int = 400
    samples: int = 60
    """N, training samples of each GP"""
    steps: int = 60
    """T, horizon"""
    bases: int = 200
    repeats: int = 15
    """turns of each"""
    engine: Literal["fused", "float32", "eager"] = "fused"
    measure: Literal["ratio", "memory", "first-call", "parts"] = "ratio"
    """the time beside the yardstick's, or something else of the step alone"""
    all: bool = False
    """measure everything at all sizes, each in a fresh process, and write the tables"""
    quick: bool = False
    """with --all: a size that tells nothing, without what takes long; needs --out"""
    out: Path | None = None
    """with --all: folder of results.json and README.md, by default runs/speed"""
    json: bool = False
    """print one JSON object as the last line"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    if arguments.all:
        from speed.survey import survey

        if arguments.quick and arguments.out is None:
            raise SystemExit("--quick would overwrite the tables of runs/speed; pass --out.")
        survey(arguments.yardstick, arguments.repeats, arguments.quick, arguments.out)
        return
    size = Size(arguments.particles, arguments.samples, arguments.steps, arguments.bases)
    found = measure(arguments, size)
    show(found, arguments.engine)
    if arguments.json:
        print(json.dumps({**asdict(size), "engine": arguments.engine, **found}))


def measure(arguments: Arguments, size: Size) -> dict[str, Any]:
    """The options of the command line."""
    from speed import measures

    if arguments.measure == "memory":
        return measures.memory(size, arguments.engine)
    if arguments.measure == "first-call":
        return measures.first_call(size, arguments.engine)
    if arguments.measure == "parts":
        from speed.parts import shares

        if arguments.engine == "eager":
            raise SystemExit("--measure parts looks into compiled loops; --engine eager has none.")
        return shares(size, arguments.engine, arguments.repeats)
    return measures.ratio(size, arguments.engine, arguments.yardstick, arguments.repeats)


def show(found: dict[str, Any], engine: str) -> None:
    """Print it for the eye."""
    if "ratio" not in found:
        print("\n".join(f"{name}: {value}" for name, value in found.items()))
        return
    for name, seconds in (("yardstick", found["yardstick_s"]), (engine, found["ours_s"])):
        print(f"{name:>10} {1e3 * seconds:9.2f} ms")
    print(f"{'ratio':>10} {found['ratio']:9.2f}")


if __name__ == "__main__":
    main()
