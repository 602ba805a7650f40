"""Volterra series by four priors: does the more flexible one, and the smooth one, predict better?

python runs/volterra/run.py --quick       # does it run at all? (about 12 CPU seconds)
python runs/volterra/run.py               # all cells; CPU time: see README.md
python runs/volterra/run.py --cells third-order-1 third-order-2

Results are kept in results/<cell>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.

Reference: thesis section 6.5, figures 6.1 to 6.4.
"""

from __future__ import annotations

import copy
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from matplotlib import pyplot
from matplotlib.axes import Axes
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, keep, kept, places
from volterra.systems import MEMORY, third_order, third_order_h2, wiener

from mcpilco.files import replacing
from mcpilco.gp import GP, WeightSpaceGP
from mcpilco.identification import (
    VolterraConfig,
    VolterraModel,
    fit_percent,
    fit_volterra,
)
from mcpilco.kernels import IPK
from mcpilco.recordings import Series
from mcpilco.show.plots import MODEL, SYSTEM, new_axes, plot_lags
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
LAGS = 70
"""of the Wiener system"""
BURN_IN = 300
"""after which its filter has forgotten the start [samples]"""
EARLY = 1e-5
"""part of the evidence that a step must win to go on, where more would take long [-]"""
MOST = 60
"""iterations of a fit of the Wiener system"""
SHOWN = {
    "ipk-1": "IPK, offset 1",
    "ipk": "IPK",
    "pk": "PK",
    "mpk": "MPK",
    "pk-early": "PK, stopped early",
    "mpk-early": "MPK, stopped early",
    "sed-mpk": "SED-MPK",
}


@dataclass(frozen=True)
class ThirdOrder:
    """System (6.36): noise of 4, inputs to test of standard deviation 4."""

    train_std: float
    """of the inputs to fit"""
    seeds: int = 20
    samples: int = 1000
    kernels: tuple[str, ...] = ("ipk-1", "ipk", "pk", "mpk", "pk-early", "mpk-early")


@dataclass(frozen=True)
class Wiener:
    """System (6.38) under white inputs of standard deviation 1."""

    degree: int
    snr: float
    """of the outputs that are fitted [dB]"""
    kernels: tuple[str, ...]
    seeds: int = 40
    samples: int = 3500


CELLS: Mapping[str, ThirdOrder | Wiener] = {
    "third-order-1": ThirdOrder(4.0),
    "third-order-2": ThirdOrder(1.0),
    **{
        f"wiener-{degree}-{snr}dB": Wiener(
            degree, snr, ("sed-mpk", "mpk") if degree <= 3 else ("sed-mpk",)
        )
        for degree in (2, 3, 4, 5)
        for snr in (20, 5)
    },
}


@dataclass(frozen=True)
class Arguments:
    """Fit all cells, and write the tables."""

    cells: tuple[str, ...] = tuple(CELLS)
    """which of them"""
    seeds: int | None = None
    """how many of each; None: those of the cell"""
    quick: bool = False
    """one seed of few samples; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/, README.md and the pictures; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    torch.set_num_threads(1)
    wanted = {name: CELLS[name] for name in arguments.cells}
    most = 1 if arguments.quick else max(cell.seeds for cell in wanted.values())
    for seed in range(most if arguments.seeds is None else arguments.seeds):
        missing = {
            path: cell
            for name, cell in wanted.items()
            if arguments.seeds is not None or seed < cell.seeds
            if not (path := out / "results" / name / f"{seed:04d}.json").exists()
        }
        for path, cell in missing.items():
            with threadpool_limits(1):
                found = trial(cell, seed, 200 if arguments.quick else cell.samples)
            keep(path, found, HERE.name)
            fits = ", ".join(f"{k} {v['fit']:.1f}" for k, v in found["kernels"].items())
            print(f"{path.parent.name}, seed {seed}: Fit % {fits}", flush=True)
        if missing:
            write_readme(out)  # a stop loses no table
    write_readme(out)
    print(f"Tables: {out / 'README.md'}")
    return 0


# What is measured ---------------------------------------------------------------------------------


def trial(cell: ThirdOrder | Wiener, seed: int, samples: int) -> dict[str, Any]:
    """Fit, noise and evidence of each kernel on one draw of data."""
    draw = draw_third_order if isinstance(cell, ThirdOrder) else draw_wiener
    train, test_inputs, truth = draw(cell, seed, samples)
    found, pictures = {}, {}
    for name in cell.kernels:
        begun = time.process_time()
        model = fitted_thesis_ipk(train) if name == "ipk-1" else fitted(name, train, cell)
        seconds = time.process_time() - begun
        mean, _ = model.predict(test_inputs)
        found[name] = {
            "fit": fit_percent(truth, mean[:, 0]),
            "noise": float(model.noise_std[0]),
            "evidence": model.report.evidence[0],
            "iterations": model.report.iterations,
            "converged": model.report.converged,
            "cpu_s": seconds,
            "against_kernel": against_kernel(model),
        }
        if seed == 0 and isinstance(cell, ThirdOrder):
            pictures[name] = model.penalties(2)[0].tolist()
    return {
        "seed": seed,
        "samples": samples,
        "noise": noise_of(train, cell, seed, samples),
        "kernels": found,
        "penalties": pictures,
        "machine": machine(),
    }


def draw_third_order(
    cell: ThirdOrder, seed: int, samples: int
) -> tuple[Series, np.ndarray, np.ndarray]:
    """What is fitted; inputs of the test, and its outputs without noise."""
    rng = np.random.default_rng([seed, 36])
    u = cell.train_std * rng.normal(size=samples + MEMORY)
    test = 4.0 * rng.normal(size=1000 + MEMORY)
    y = third_order(u) + 4.0 * rng.normal(size=samples)
    pad = np.full(MEMORY, np.nan)
    return Series.of(u, np.r_[pad, y]), test, np.r_[pad, third_order(test)]


def draw_wiener(cell: Wiener, seed: int, samples: int) -> tuple[Series, np.ndarray, np.ndarray]:
    """What is fitted; inputs of the test, and its outputs without noise."""
    rng = np.random.default_rng([seed, 38, cell.degree])
    length = BURN_IN + LAGS + samples
    (u, z), (test, truth) = (
        (inputs[BURN_IN:], wiener(inputs, cell.degree)[BURN_IN:])
        for inputs in rng.normal(size=(2, length))
    )
    noise = z.std() * 10.0 ** (-cell.snr / 20.0)
    return Series.of(u, z + noise * rng.normal(size=len(z))), test, truth


def noise_of(train: Series, cell: ThirdOrder | Wiener, seed: int, samples: int) -> float:
    """The true standard deviation of the noise."""
    if isinstance(cell, ThirdOrder):
        return 4.0
    quiet = Wiener(cell.degree, np.inf, cell.kernels, cell.seeds)
    return float(draw_wiener(quiet, seed, samples)[0].outputs.std() * 10.0 ** (-cell.snr / 20.0))


def fitted(name: str, train: Series, cell: ThirdOrder | Wiener) -> VolterraModel:
    """The model of one row of the table."""
    lags, degree = (MEMORY, 3) if isinstance(cell, ThirdOrder) else (LAGS, cell.degree)
    config = VolterraConfig(lags=lags, degree=degree, kernel=name.removesuffix("-early"))
    if name.endswith("-early"):
        config = replace(config, tolerance=EARLY)
    if isinstance(cell, Wiener):
        config = replace(config, tolerance=EARLY, max_iterations=MOST)
    return fit_volterra(train, config)


def fitted_thesis_ipk(train: Series) -> VolterraModel:
    """IPK whose offset is 1, as in eq. (6.23), of outputs scaled to mean square 1."""
    config = VolterraConfig(lags=MEMORY, degree=3, kernel="ipk")
    kernel = IPK(MEMORY + 1, 3, (1,), offset=1.0)
    return fit_volterra(train, config, WeightSpaceGP(kernel, noise_floor=config.noise_floor))


def against_kernel(model: VolterraModel) -> float | None:
    """How far weight space and kernel are apart: evidence and predictions, relative to their size.

    None where the model has been fitted with the kernel.
    """
    if not isinstance(model.gp, WeightSpaceGP):
        return None
    dense = GP(copy.deepcopy(model.gp.kernel), noise_floor=model.config.noise_floor)
    dense.load_arrays(model.gp.to_arrays())
    with torch.no_grad():
        here, there = (gp.nlml(model.X, model.Y) for gp in (model.gp, dense))
        means = [
            gp.condition(model.X, model.Y).mean_and_variance(model.X)[0] for gp in (model.gp, dense)
        ]
    evidence = ((here - there).abs() / there.abs()).max()
    mean = (means[0] - means[1]).abs().max() / means[1].abs().max()
    return float(torch.maximum(evidence, mean))


# The tables ---------------------------------------------------------------------------------------


Trials = Mapping[str, Sequence[Mapping[str, Any]]]


def write_readme(out: Path) -> None:
    """Put tables and pictures of the results that are there into README.md."""
    found = {name: kept(out / "results" / name) for name in CELLS}
    found = {name: trials for name, trials in found.items() if trials}
    third = {name: trials for name, trials in found.items() if name.startswith("third")}
    parts = [
        fits_table(found),
        claims(found),
        noises(found),
        places(t for trials in found.values() for t in trials),
    ]
    if third:
        write_penalties(out / "penalties.png", third)
        parts.insert(1, PENALTIES)
    write_fits(out / "fits.png", found)
    parts.insert(1, "![Fit of all kernels, a dot a seed](fits.png)")
    fill(out / "README.md", parts, template=HERE / "README.md")


PENALTIES = """### Which products of two lags each prior allows (figure 6.2)

![Magnitudes of h_2 beside the penalties of each prior](penalties.png)

Seed 0. Magnitudes of the true h_2, and lambda_h of eq. (6.37) after the fit; dark is large, and
each picture has its own scale."""


def title(name: str) -> str:
    cell = CELLS[name]
    if isinstance(cell, ThirdOrder):
        setup = 1 if cell.train_std == 4.0 else 2
        return f"(6.36), setup {setup}"
    return f"(6.38), r = {cell.degree}, {cell.snr:g} dB, N = {cell.samples}"


def values(trials: Sequence[Mapping[str, Any]], kernel: str, key: str) -> np.ndarray:
    return np.array([trial["kernels"][kernel][key] for trial in trials])


def fits_table(found: Trials) -> str:
    rows = [
        (
            title(name),
            SHOWN[kernel],
            str(len(trials)),
            spread(values(trials, kernel, "fit"), 1),
            f"{np.median(values(trials, kernel, 'evidence')):.1f}",
            f"{np.median(values(trials, kernel, 'iterations')):.0f}",
            str(int(values(trials, kernel, "converged").sum())),
            f"{np.median(values(trials, kernel, 'cpu_s')):.2f}",
        )
        for name, trials in found.items()
        for kernel in trials[0]["kernels"]
    ]
    header = (
        "system",
        "kernel",
        "seeds",
        "Fit [%]",
        "log evidence",
        "iterations",
        "converged",
        "CPU of a fit [s]",
    )
    return (
        "### Fit on new inputs, against outputs without noise\n\n"
        f"{markdown(header, rows)}\n"
        "Fit: median (least to greatest) over seeds; all else medians."
    )


def spread(of: np.ndarray, digits: int) -> str:
    return f"{np.median(of):.{digits}f} ({of.min():.{digits}f} to {of.max():.{digits}f})"


def claims(found: Trials) -> str:
    """What was to be shown, counted."""
    lines = []
    if trials := found.get("third-order-1"):
        least = {k: values(trials, k, "fit").min() for k in trials[0]["kernels"]}
        all_good = sum(min(v["fit"] for v in t["kernels"].values()) >= 99.0 for t in trials)
        lines.append(
            f"setup 1: all kernels at least 99 % in {all_good} of {len(trials)} seeds; "
            f"the least Fit of all is {min(least.values()):.2f} %"
        )
    if trials := found.get("third-order-2"):
        lines += [
            f"setup 2: MPK predicts at least as well as {SHOWN[k]} in "
            f"{share(trials, 'mpk', k, 'fit')} of {len(trials)} seeds, its evidence is at least "
            f"as high in {share(trials, 'mpk', k, 'evidence')}"
            for k in ("ipk-1", "ipk", "pk")
        ]
        lines.append(
            "setup 2, both stopped early: MPK predicts at least as well as PK in "
            f"{share(trials, 'mpk-early', 'pk-early', 'fit')} of {len(trials)} seeds, its "
            "evidence is at least as high in "
            f"{share(trials, 'mpk-early', 'pk-early', 'evidence')}"
        )
    for name, trials in found.items():
        if {"sed-mpk", "mpk"} <= trials[0]["kernels"].keys():
            ahead = values(trials, "sed-mpk", "fit") - values(trials, "mpk", "fit")
            lines.append(
                f"{title(name)}: SED-MPK is {spread(ahead, 1)} points above MPK, median (least to "
                "greatest)"
            )
    apart = [
        found_kernel["against_kernel"]
        for trials in found.values()
        for trial in trials
        for found_kernel in trial["kernels"].values()
        if found_kernel["against_kernel"] is not None
    ]
    if apart:
        lines.append(
            f"weight space and kernel differ by at most {max(apart):.1e} of evidence and "
            f"predictions, over {len(apart)} fits"
        )
    return "### What was to be shown\n\n" + "\n".join(f"- {line}." for line in lines)


def share(trials: Sequence[Mapping[str, Any]], one: str, other: str, key: str) -> int:
    return int((values(trials, one, key) >= values(trials, other, key)).sum())


def noises(found: Trials) -> str:
    """Estimated over true standard deviation of the noise."""
    rows = []
    for name, trials in found.items():
        true = np.array([trial["noise"] for trial in trials])
        rows += [
            (title(name), SHOWN[kernel], spread(values(trials, kernel, "noise") / true, 2))
            for kernel in trials[0]["kernels"]
        ]
    return "### Noise found, in parts of the true one\n\n" + markdown(
        ("system", "kernel", "median (least to greatest)"), rows
    )


# The pictures -------------------------------------------------------------------------------------


def write_fits(path: Path, found: Trials) -> None:
    """A dot a seed, a panel a cell (figures 6.1, 6.3 and 6.4)."""
    axes = new_axes(len(found))
    for ax, (name, trials) in zip(axes, found.items(), strict=True):
        kernels = list(trials[0]["kernels"])
        for place, kernel in enumerate(kernels):
            fits = values(trials, kernel, "fit")
            ax.plot(np.full(len(fits), place), fits, "o", color=MODEL, alpha=0.4, markersize=4)
            ax.plot(place, np.median(fits), "_", color=SYSTEM, markersize=20)
        names = [SHOWN[k].replace("stopped ", "").replace(", ", "\n") for k in kernels]
        ax.set_xticks(range(len(kernels)), names)
        ax.tick_params(axis="x", labelsize="x-small")
        ax.set(title=title(name), ylabel="Fit [%]", xlim=(-0.5, len(kernels) - 0.5))
    _write(path, axes[0])


def write_penalties(path: Path, found: Trials) -> None:
    """The true |h_2| and the penalties of each kernel, a row a setup (figure 6.2)."""
    from matplotlib.figure import Figure

    shown = ("ipk", "pk", "mpk")
    figure = Figure(figsize=(9.0, 2.6 * len(found)), layout="constrained")
    axes = figure.subplots(len(found), 1 + len(shown), squeeze=False)
    for row, (name, trials) in zip(axes, found.items(), strict=True):
        plot_lags(third_order_h2(), f"{title(name)}: |h_2|", row[0])
        for ax, kernel in zip(row[1:], shown, strict=True):
            plot_lags(np.array(trials[0]["penalties"][kernel]), SHOWN[kernel], ax)
    _write(path, axes[0, 0])


def _write(path: Path, ax: Axes) -> None:
    with replacing(path) as temporary:
        ax.figure.savefig(temporary, format="png", dpi=80, metadata={"Software": None})
    pyplot.close(ax.figure)


if __name__ == "__main__":
    sys.exit(main())
