"""How good a forecast is, at each instant."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from model_learning.forecasts import Forecast

from mcpilco.data import Rollout
from mcpilco.files import read_text, write_bytes

FOLLOWS = 0.3
"""a particle follows as long as its angle is no farther from the true one [rad]"""
COLUMNS = (
    "rmse_angle",
    "rmse_cart",
    "covered_angle",
    "covered_cart",
    "nll",
    "std_angle",
    "follow",
    "stopped",
)
"""of `measure`, in the order of the files"""
_DIGITS = 5

Measured = Mapping[str, Float[np.ndarray, " T_plus_1"]]


def measure(
    forecast: Forecast, truth: Rollout, noise_std: Float[np.ndarray, " X"], cart: int, angle: int
) -> Measured:
    """What is told of a forecast, over its instants.

    Args:
        forecast: of the rollout.
        truth: what came.
        noise_std: of a measurement, in the states' units.
        cart: index of the cart's position.
        angle: index of the pole's angle.

    Returns:
        rmse_angle [rad], rmse_cart [m]: root mean square, over the predicted distribution, of its
        distance from the truth; covered_angle, covered_cart: 1 where the truth is within the
        central 95 %; nll: negative log-likelihood of the measured state under a Gaussian of the
        predicted moments, with the noise of the measurement [nats]; std_angle: predicted spread
        [rad]; follow: 1 while a particle has followed the true angle so far; stopped: share of the
        particles that left all that is plausible, and stand still. Both NaN without particles.
    """
    states = truth.shown_states
    low, high = forecast.interval()
    inside = (low <= states) & (states <= high)
    variance = np.diagonal(forecast.cov, axis1=1, axis2=2)
    rmse = np.sqrt(np.square(forecast.mean - states) + variance)
    follow = stopped = np.full(len(states), np.nan)
    if (particles := forecast.particles) is not None:
        near = np.abs(particles[..., angle] - states[:, None, angle]) <= FOLLOWS
        follow, stopped = _following(particles, near)
    return {
        "rmse_angle": rmse[:, angle],
        "rmse_cart": rmse[:, cart],
        "covered_angle": inside[:, angle].astype(float),
        "covered_cart": inside[:, cart].astype(float),
        "nll": _nll(forecast, truth.observations, noise_std),
        "std_angle": np.sqrt(variance[:, angle]),
        "follow": follow,
        "stopped": stopped,
    }


def _nll(
    forecast: Forecast, seen: Float[np.ndarray, "T_plus_1 X"], noise_std: Float[np.ndarray, " X"]
) -> Float[np.ndarray, " T_plus_1"]:
    """-log N(y; m, S + noise), with the Cholesky factor L of the covariance."""
    L = np.linalg.cholesky(forecast.cov + np.diag(np.square(noise_std)))
    white = np.linalg.solve(L, (seen - forecast.mean)[..., None])[..., 0]
    logs = np.log(np.diagonal(L, axis1=1, axis2=2))
    return (logs + 0.5 * np.square(white) + 0.5 * np.log(2 * np.pi)).sum(-1)


def _following(
    particles: Float[np.ndarray, "T_plus_1 P X"], near: Float[np.ndarray, "T_plus_1 P"]
) -> tuple[Float[np.ndarray, " T_plus_1"], Float[np.ndarray, " T_plus_1"]]:
    """Whether any particle has been near so far, and the share of those that stand still."""
    still = np.zeros(near.shape, dtype=bool)
    still[1:] = (particles[1:] == particles[:-1]).all(-1)
    followed = np.logical_and.accumulate(near & ~still, axis=0).any(1)
    return followed.astype(float), still.mean(1)


def averaged(found: Sequence[Measured]) -> Measured:
    """Over rollouts: means, of the errors the root mean square."""
    together = {name: np.stack([one[name] for one in found]) for name in COLUMNS}
    return {
        name: np.sqrt(np.square(rows).mean(0)) if name.startswith("rmse") else rows.mean(0)
        for name, rows in together.items()
    }


def write_measured(path: Path, found: Mapping[tuple[str, str], Measured], dt: float) -> None:
    """One seed as CSV: a row a kind of rollout, model and instant."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("rollouts", "model", "time_s", *COLUMNS))
    for (kind, model), measured in found.items():
        for step, values in enumerate(zip(*(measured[n] for n in COLUMNS), strict=True)):
            cells = ("" if np.isnan(value) else f"{value:.{_DIGITS}g}" for value in values)
            writer.writerow((kind, model, f"{dt * step:g}", *cells))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, text.getvalue().encode())


def read_measured(path: Path) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """What `write_measured` wrote, and `time_s`."""
    found: dict[tuple[str, str], dict[str, list[float]]] = {}
    for row in csv.DictReader(read_text(path).splitlines()):
        columns = found.setdefault((row["rollouts"], row["model"]), {})
        for name in ("time_s", *COLUMNS):
            columns.setdefault(name, []).append(float(row[name] or "nan"))
    return {key: {n: np.array(v) for n, v in columns.items()} for key, columns in found.items()}
