"""The tables of many seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from mcpilco.sweep import bootstrapped, markdown, mean, mean_cell, spread, spread_cell

TIMES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""instants that have a column [s]"""
SHOWN = {"pilco": "PILCO's Gaussian", "rbf": "RBF", "mpk": "MPK", "rbf+mpk": "RBF + MPK"}

Gathered = Mapping[tuple[str, str], Mapping[str, np.ndarray]]
"""by kind of rollout and model: each column, (seeds, instants), but `time_s`, (instants)"""


def gather(seeds: Sequence[Mapping[tuple[str, str], Mapping[str, np.ndarray]]]) -> Gathered:
    """The files of many seeds as arrays."""
    found = {}
    for key, columns in seeds[0].items():
        found[key] = {name: np.stack([seed[key][name] for seed in seeds]) for name in columns}
        found[key]["time_s"] = found[key]["time_s"][0]
    return found


def tables(found: Gathered, kinds: Iterable[str], models: Sequence[str]) -> list[str]:
    """Headings and tables for each kind of rollout."""
    parts = []
    for kind in kinds:
        of_it = {model: found[kind, model] for model in models}
        parts += [
            f"#### Rollouts: {kind}",
            "RMSE of the pole's angle [rad], median (quartiles) over seeds:",
            over_time(of_it, "rmse_angle", lambda v: spread_cell(spread(v), 2)),
            "RMSE of RBF particles over that of RBF + MPK particles, seed by seed, median (95 % "
            "bootstrap interval):",
            _table([("ratio", *ratios(of_it))]),
            "Truth within the central 95 % of the predicted angles [%], mean (95 % bootstrap "
            "interval):",
            over_time(of_it, "covered_angle", lambda v: mean_cell(mean(v))),
            "Negative log-likelihood of the measured state [nats], median (quartiles):",
            over_time(of_it, "nll", lambda v: spread_cell(spread(v), 1)),
            "Averages over the horizon, median (quartiles) over seeds; followed: how long the "
            "longest-lived of 400 particles stays within 0.3 rad of the true angle; stopped: "
            "particles that left all that is plausible, and stand still:",
            averages(of_it),
        ]
    return parts


def over_time(
    of_it: Mapping[str, Mapping[str, np.ndarray]], column: str, cell: Callable[[np.ndarray], str]
) -> str:
    """A row a model, a column an instant."""
    return _table(
        [
            (SHOWN[model], *(cell(columns[column][:, at(columns, t)]) for t in TIMES))
            for model, columns in of_it.items()
        ]
    )


def ratios(of_it: Mapping[str, Mapping[str, np.ndarray]]) -> Iterable[str]:
    """How many times the error of RBF is that of RBF + MPK."""
    for time in TIMES:
        rbf, both = (
            of_it[model]["rmse_angle"][:, at(of_it[model], time)] for model in ("rbf", "rbf+mpk")
        )
        ratio = rbf / both
        low, high = bootstrapped(ratio, np.median)
        interval = "" if low is None else f" ({low:.1f}–{high:.1f})"
        yield f"{np.median(ratio):.1f}{interval}"


def averages(of_it: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """A row a model."""
    rows = []
    for model, columns in of_it.items():
        times = columns["time_s"]
        rmse = np.sqrt(np.square(columns["rmse_angle"]).mean(1))
        followed = (times[1] - times[0]) * columns["follow"][:, 1:].sum(1)
        told = "" if np.isnan(followed).any() else spread_cell(spread(followed), 2)
        rows.append(
            (
                SHOWN[model],
                spread_cell(spread(rmse), 2),
                spread_cell(spread(np.sqrt(np.square(columns["rmse_cart"]).mean(1))), 2),
                mean_cell(mean(columns["covered_angle"][:, 1:].mean(1))),
                mean_cell(mean(columns["covered_cart"][:, 1:].mean(1))),
                spread_cell(spread(columns["nll"][:, 1:].mean(1)), 1),
                told,
                ""
                if np.isnan(stopped := columns["stopped"][:, -1]).any()
                else mean_cell(mean(stopped)),
            )
        )
    header = ("model", "RMSE angle [rad]", "RMSE cart [m]", "angle covered [%]")
    return markdown(
        (*header, "cart covered [%]", "NLL [nats]", "followed [s]", "stopped at the end [%]"), rows
    )


def at(columns: Mapping[str, np.ndarray], time: float) -> int:
    """The instant at a time [s]."""
    return int(np.argmin(np.abs(columns["time_s"] - time)))


def _table(rows: Sequence[Sequence[str]]) -> str:
    return markdown(("after", *(f"{time:g} s" for time in TIMES)), rows)
