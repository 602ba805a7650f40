"""All that is measured, each in a fresh process, and the page that shows it."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from harness import fill, keep
from speed.step import ENGINES, Size

from mcpilco.sweep import machine as processor
from mcpilco.sweep import markdown

HERE = Path(__file__).parent
COMMAND = HERE.parent / "speed_policy_step.py"
SIZES = (Size(400, 60, 60, 200), Size(400, 180, 60, 200), Size(400, 300, 60, 200))
SMALL = Size(100, 60, 30, 100)
QUICK = Size(4, 8, 3, 5)
TARGETS = {
    "fused": dict(zip((*SIZES, SMALL), (7.0, 4.0, 3.3, 11.0), strict=True)),
    "float32": dict(zip(SIZES, (10.0, 7.0, 5.5), strict=True)),
}
"""ratios to be reached"""
MEMORY_TARGET = 150.0
"""[MB]"""
CALL_TARGETS = {"first": 15.0, "later": 1.0}
"""[s]"""
COMPILED = ("fused", "float32")
PRECISION = {"fused": "float64", "float32": "float32", "eager": "float64, plain torch"}


def survey(yardstick: Path, repeats: int, quick: bool, out: Path | None) -> None:
    """Measure everything, keep it in results.json and write the tables into README.md."""
    out = out or HERE
    sizes, largest = ((QUICK,), QUICK) if quick else ((*SIZES, SMALL), SIZES[-1])
    engines = ("fused",) if quick else tuple(ENGINES)
    told = ("--yardstick", str(yardstick))
    found: dict[str, Any] = {"machine": machine(), "repeats": repeats}
    found["ratios"] = [
        fresh("ratio", size, engine, repeats, *told) for size in sizes for engine in engines
    ]
    found["memory"] = [fresh("memory", largest, engine) for engine in engines]
    if not quick:
        found["calls"] = [calls(SIZES[0], engine) for engine in COMPILED]
        found["parts"] = [
            fresh("parts", size, engine, repeats)
            for engine in COMPILED
            for size in (SIZES[0], SIZES[-1])
        ]
    keep(out / "results.json", found, HERE.name)
    write_readme(out)
    print(f"Tables: {out / 'README.md'}")


def fresh(
    measure: str, size: Size, engine: str, repeats: int = 1, *more: str, cache: str = ""
) -> dict[str, Any]:
    """What a process of its own finds."""
    flags = {**asdict(size), "engine": engine, "measure": measure, "repeats": repeats}
    words = [word for name, value in flags.items() for word in (f"--{name}", str(value))]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    if cache:
        env["NUMBA_CACHE_DIR"] = cache
    done = subprocess.run(
        [sys.executable, str(COMMAND), *words, *more, "--json"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env=env,
    )
    line = done.stdout.splitlines()[-1]
    print(line, flush=True)
    return json.loads(line)


def calls(size: Size, engine: str) -> dict[str, Any]:
    """The first call without compiled code on disk, and that of the process after it."""
    with tempfile.TemporaryDirectory() as cache:
        first, later = (fresh("first-call", size, engine, cache=cache) for _ in CALL_TARGETS)
    return {"engine": engine, "first": first, "later": later}


def machine() -> dict[str, Any]:
    """Where it was measured."""
    versions = {name: version(name) for name in ("torch", "numba", "numpy")}
    return {**processor(), "python": platform.python_version(), **versions}


# The page -----------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of results.json into README.md."""
    page = out / "README.md"
    if not page.exists():
        page.write_bytes((HERE / "README.md").read_bytes())
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    tables = (ratio_table, memory_table, call_table, part_table, rate_table, machine_line)
    fill(page, [table(found) for table in tables])


def ratio_table(found: Mapping[str, Any]) -> str:
    """A row for each setting and engine."""
    rows = [
        (
            sized(row, "particles", "steps", "bases", "samples"),
            f"`{row['engine']}`",
            spread_ms(row, "yardstick"),
            spread_ms(row, "ours"),
            "**{ratio:.1f}** ({0:.1f}–{1:.1f})".format(*row["ratio_quartiles"], **row),
            f"{target:g}" if (target := target_of(row)) else "",
        )
        for row in found["ratios"]
    ]
    missed = [
        f"`{row['engine']}`, N = {row['samples']}, P = {row['particles']}"
        for row in found["ratios"]
        if row["ratio"] < (target_of(row) or 0.0)
    ]
    header = ("P, T, B, N", "engine", "yardstick [ms]", "step [ms]", "ratio", "at least")
    return (
        "### A policy step against the yardstick: median CPU time (quartiles)\n\n"
        f"{markdown(header, rows)}\n"
        f"{found['repeats']} turns of each, of three steps. The ratio is that of the medians; its "
        f"quartiles are those of the turns' ratios. Missed: {'; '.join(missed) or 'none'}."
    )


def target_of(row: Mapping[str, Any]) -> float | None:
    size = Size(*(row[name] for name in ("particles", "samples", "steps", "bases")))
    return TARGETS.get(row["engine"], {}).get(size)


def sized(row: Mapping[str, Any], *names: str) -> str:
    return ", ".join(str(row[name]) for name in names)


def spread_ms(row: Mapping[str, Any], whose: str) -> str:
    median, (low, high) = row[f"{whose}_s"], row[f"{whose}_quartiles_s"]
    return f"{1e3 * median:.1f} ({1e3 * low:.1f}–{1e3 * high:.1f})"


def memory_table(found: Mapping[str, Any]) -> str:
    rows = [
        (f"`{row['engine']}`", f"{row['step_MB']:.0f}", f"{row['before_MB']:.0f}")
        for row in found["memory"]
    ]
    header = ("engine", "steps [MB]", "packages and model [MB]")
    size = sized(found["memory"][0], "particles", "steps", "bases", "samples")
    return (
        f"### Memory, P, T, B, N = {size}\n\n{markdown(header, rows)}\n"
        "Peak resident set of ten steps, above what was resident before the first; loading the "
        f"compiled code from disk included. To be below {MEMORY_TARGET:g} MB for `fused`."
    )


def call_table(found: Mapping[str, Any]) -> str:
    if not found.get("calls"):
        return ""
    rows = [
        (
            f"`{row['engine']}`",
            *(f"{row[which][key]:.2f}" for which in CALL_TARGETS for key in ("wall_s", "cpu_s")),
        )
        for row in found["calls"]
    ]
    header = (
        "engine",
        "compiling: wall [s]",
        "CPU [s]",
        "from disk: wall [s]",
        "CPU [s]",
    )
    missed = [
        f"`{row['engine']}`, {which} call ({row[which]['cpu_s']:.1f} s)"
        for row in found["calls"]
        for which, target in CALL_TARGETS.items()
        if row[which]["cpu_s"] > target
    ]
    return (
        "### The first step of a process, imports excluded\n\n"
        f"{markdown(header, rows)}\n"
        f"To take at most {CALL_TARGETS['first']:g} s of CPU time when it compiles (first call), "
        f"{CALL_TARGETS['later']:g} s when an earlier process has (later call). "
        f"Missed: {'; '.join(missed) or 'none'}."
    )


def part_table(found: Mapping[str, Any]) -> str:
    """A column for each engine and N."""
    columns = found.get("parts")
    if not columns:
        return ""
    totals = [sum(column["parts_ms"].values()) for column in columns]
    rows = [
        (
            name,
            *(
                f"{column['parts_ms'][name]:.1f} ({100 * column['parts_ms'][name] / total:.0f} %)"
                for column, total in zip(columns, totals, strict=True)
            ),
        )
        for name in columns[0]["parts_ms"]
    ]
    rows.append(("step", *(f"{total:.1f}" for total in totals)))
    header = ("part [ms]", *map(label, columns))
    return f"### Where the rest goes: CPU time of each part\n\n{markdown(header, rows)}"


def rate_table(found: Mapping[str, Any]) -> str:
    columns = found.get("parts")
    if not columns:
        return ""
    rows = [
        ("L^-1 and L^-T [GFLOP/s]", *(f"{c['triangular_gflops']:.0f}" for c in columns)),
        ("best tile product [GFLOP/s]", *(f"{c['peak_gflops']:.0f}" for c in columns)),
        ("share [%]", *(f"{100 * c['triangular_gflops'] / c['peak_gflops']:.0f}" for c in columns)),
    ]
    return (
        "### The products with L^-1 and L^-T against the processor\n\n"
        f"{markdown(('', *map(label, columns)), rows)}\n"
        "Zeros do not count as operations: neither those beside the triangles, nor those that pad "
        "tiles and particles."
    )


def label(column: Mapping[str, Any]) -> str:
    return f"{PRECISION[column['engine']]}, N = {column['samples']}"


def machine_line(found: Mapping[str, Any]) -> str:
    told = dict(found["machine"])
    versions = ", ".join(f"{name} {told[name]}" for name in told if name not in ("cpu", "cores"))
    return f"### Machine\n\n{told['cpu']}, {told['cores']} cores; {versions}. One thread."
