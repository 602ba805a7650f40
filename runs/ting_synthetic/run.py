"""A hundred noisy inputs of which ten matter: the errors of all methods on clean and noisy tests.

python runs/ting_synthetic/run.py --quick       # does it run at all?
python runs/ting_synthetic/run.py               # all cells, seeds 0:10: about 3 CPU minutes
python runs/ting_synthetic/run.py --seeds 10:20

Results are kept in results/<cell>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.

Reference: Ting et al., section IV-A, figure 2.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, kept, once, parse_seeds, places, write_picture

from mcpilco import identification
from mcpilco.identification import middle_reliability
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
RELEVANT, INPUTS, SAMPLES = 10, 100, 1000
OUTPUT_SNR = 5.0
B = np.arange(1.0, RELEVANT + 1.0)
CELLS = {
    f"snr{snr}-redundant{redundant}": (snr, redundant)
    for snr in (2, 5)
    for redundant in (90, 60, 30, 0)
}
"""signal-to-noise ratio of the inputs, and how many of 90 are redundant; the rest is irrelevant"""
OURS = "VB b_true"
BASELINES = ("OLS", "ridge", "stepwise", "PLS", "LASSO", "JFA b_true")
SCALED = "OLS / r"


def scaled_least_squares(X: np.ndarray, y: np.ndarray, seed: int) -> identification.Solution:
    """Least squares, over the reliability by which b_true differs from b_noise."""
    moments = identification.Moments.of(X, y)
    b = moments.least_squares()
    return identification.Solution(b / middle_reliability(moments, b))


METHODS = {**identification.METHODS, SCALED: scaled_least_squares}
"""the last, no baseline of the seed's, tells what the reliability alone is worth"""


@dataclass(frozen=True)
class Arguments:
    """Fit all methods in all cells, and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    quick: bool = False
    """one seed of few samples; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    seeds = parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]
    for seed in seeds:
        for cell, numbers in CELLS.items():
            path = out / "results" / cell / f"{seed:04d}.json"
            samples = 200 if arguments.quick else SAMPLES
            if found := once(path, HERE.name, trial, *numbers, seed, samples):
                clean = found["clean"]
                print(f"{cell}, seed {seed}: {OURS} {clean[OURS]:.3f}, OLS {clean['OLS']:.3f}")
        write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return 0


def trial(snr: float, redundant: int, seed: int, samples: int) -> dict[str, Any]:
    """Errors of all methods on one draw of data."""
    rng = np.random.default_rng([seed, int(snr), redundant])
    A = rng.normal(size=(RELEVANT, RELEVANT))
    mixing = rng.dirichlet(np.ones(RELEVANT), redundant)

    def draw(noise: float) -> tuple[np.ndarray, np.ndarray]:
        """Inputs (samples, INPUTS) and outputs, with noise or without."""
        t = rng.normal(size=(samples, RELEVANT)) @ A.T
        y = t @ B
        x = t + noise * rng.normal(size=t.shape) * np.sqrt((A**2).sum(axis=1) / snr)
        y = y + noise * rng.normal(size=samples) * np.sqrt(((B @ A) ** 2).sum() / OUTPUT_SNR)
        others = rng.normal(size=(samples, INPUTS - RELEVANT - redundant))
        return np.column_stack([x, x @ mixing.T, others]), y

    (X, y), clean, noisy = draw(1.0), draw(0.0), draw(1.0)
    errors: dict[str, dict[str, float]] = {"clean": {}, "noisy": {}, "cpu_s": {}}
    with threadpool_limits(1):
        for name, method in METHODS.items():
            begun = time.process_time()
            b = method(X, y, seed).b
            errors["cpu_s"][name] = time.process_time() - begun
            errors["clean"][name] = nmse(b, *clean)
            errors["noisy"][name] = nmse(b, *noisy)
    return {"seed": seed, "samples": samples, **errors, "machine": machine()}


def nmse(b: np.ndarray, X: np.ndarray, y: np.ndarray) -> float:
    return float(((y - X @ b) ** 2).mean() / y.var())


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {cell: kept(out / "results" / cell) for cell in CELLS}
    found = {cell: trials for cell, trials in found.items() if trials}
    write_picture(out / "figure2.png", picture(found))
    parts = [
        "![Figure 2: errors of all methods, on the clean and the noisy test](figure2.png)",
        "### nMSE on the clean test: mean, in brackets median (least to greatest)",
        errors_table(found, "clean"),
        "### nMSE on the noisy test: mean, in brackets median (least to greatest)",
        errors_table(found, "noisy"),
        "### `VB b_true` beside the best of the baselines, clean test",
        ratios(found),
        "### CPU seconds of a fit, median of all",
        times(found),
        places(t for trials in found.values() for t in trials),
    ]
    fill(out / "README.md", parts, template=HERE / "README.md")


def picture(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Mean errors by cell and method; lines go from the least to the greatest trial: figure 2."""
    levels = sorted({CELLS[cell][0] for cell in found})
    figure = Figure(figsize=(11.0, 1.2 + 2.4 * len(levels)), layout="constrained")
    panels = figure.subplots(len(levels), 2, squeeze=False)
    width = 0.8 / len(METHODS)
    for snr, row in zip(levels, panels, strict=True):
        cells = [cell for cell in found if CELLS[cell][0] == snr]
        labels = [f"{CELLS[c][1]} redundant,\n{90 - CELLS[c][1]} irrelevant" for c in cells]
        for test, ax in zip(("clean", "noisy"), row, strict=True):
            for m, name in enumerate(METHODS):
                errors = [[trial[test][name] for trial in found[cell]] for cell in cells]
                mean, low, high = (np.array([f(e) for e in errors]) for f in (np.mean, min, max))
                colour = "black" if name == OURS else f"C{m}"
                at = np.arange(len(cells)) + width * (m - (len(METHODS) - 1) / 2)
                lines = {"elinewidth": 0.8, "ecolor": "0.5"}
                ax.bar(
                    at,
                    mean,
                    width,
                    yerr=[mean - low, high - mean],
                    color=colour,
                    label=name,
                    error_kw=lines,
                )
            ax.set(title=f"SNR {snr}, {test} test", ylabel="nMSE [-]")
            ax.set_xticks(range(len(cells)), labels, fontsize="small")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=9)
    return figure


def row_name(cell: str) -> str:
    snr, redundant = CELLS[cell]
    return f"SNR {snr}, {redundant} redundant, {INPUTS - RELEVANT - redundant} irrelevant"


def errors_table(found: Mapping[str, Sequence[Mapping[str, Any]]], test: str) -> str:
    rows = [
        (
            row_name(cell),
            str(len(trials)),
            *(spread([trial[test][name] for trial in trials]) for name in METHODS),
        )
        for cell, trials in found.items()
    ]
    return markdown(("cell", "trials", *METHODS), rows)


def spread(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{np.mean(values):.4f} ({np.median(values):.3f}, {low:.3f} to {high:.3f})"


def ratios(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Of means over trials; the best baseline is that of the least mean, chosen afterwards."""
    rows = []
    for cell, trials in found.items():
        mean = {name: np.mean([trial["clean"][name] for trial in trials]) for name in METHODS}
        best = min(BASELINES, key=mean.__getitem__)
        better = sum(trial["clean"][OURS] < trial["clean"][best] for trial in trials)
        ratio = mean[OURS] / mean[best]
        scaled = f"{mean[OURS] / mean[SCALED]:.2f}"
        rows.append((row_name(cell), best, f"{ratio:.2f}", f"{better} of {len(trials)}", scaled))
    header = ("cell", "best baseline", "ratio of means", "trials in which it is better")
    return markdown((*header, f"ratio of means to `{SCALED}`"), rows)


def times(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    trials = [trial for some in found.values() for trial in some]
    cells = [f"{np.median([trial['cpu_s'][name] for trial in trials]):.3f}" for name in METHODS]
    return markdown(tuple(METHODS), [tuple(cells)])


if __name__ == "__main__":
    sys.exit(main())
