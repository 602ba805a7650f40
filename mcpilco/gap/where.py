"""Where a model and recordings disagree: in which channel, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, residual, run
from mcpilco.gap.places import places
from mcpilco.gap.windows import Windows
from mcpilco.plant import Axis

LAGS = 8
"""of the autocorrelation of residuals"""


@dataclass(frozen=True)
class Disagreement:
    """A share of the misfit, or of a force that was learned to explain it."""

    channel: str
    """state whose measurement is missed; of a force, the position of its joint"""
    share: float
    """of the squared misfit beyond the noise, or of the squared force [-]"""
    condition: str
    """when it is largest, in words"""
    joint: str = ""
    """in which a force is missing; empty where only a measurement is told of"""


@dataclass(frozen=True)
class Structure:
    """What a model leaves over."""

    whiteness: float
    """about 1 where the residuals are noise, see `whiteness`"""
    excess: float
    """misfit over noise: chi^2 of a sample, less 1"""
    usual: float
    """likewise, in the median over windows"""
    unevenness: float
    """misfit of a window that is missed much over that of a usual one; about 1.5 for noise"""


def residuals(found: Fit, windows: Windows) -> Float[np.ndarray, "W X T"]:
    """(measured - simulated) / noise std of a fit; 0 where nothing was measured."""
    y = run(found.model, windows, found.theta[None], found.starts[None])[0]
    return residual(windows, y).reshape(windows.y.shape)


def structure(found: Fit, windows: Windows) -> Structure:
    """Whether what a fit leaves over is noise."""
    r = residuals(found, windows)
    excess = float((r**2).sum() / max(windows.measured.sum(), 1)) - 1.0
    by_window = (r**2).sum(axis=(1, 2)) / windows.samples
    usual, much = np.percentile(by_window, [50.0, 95.0])
    uneven = float(much / max(usual, 1e-300))
    return Structure(whiteness(r), excess, float(usual) - 1.0, uneven)


def whiteness(r: Float[np.ndarray, "W X T"]) -> float:
    """Mean over lags of N rho^2, pooled over windows and channels: about 1 for white noise.

    Reference: Box & Pierce, Distribution of residual autocorrelations, JASA 65 (1970).
    """
    size, count = float(np.sum(r**2)) or 1.0, np.count_nonzero(r)
    lagged = [np.sum(r[:, :, lag:] * r[:, :, :-lag]) / size for lag in range(1, LAGS + 1)]
    return float(count * np.mean(np.square(lagged)))


def correlation_time(r: Float[np.ndarray, "W X T"]) -> float:
    """How many successive residuals say the same: 1 + 2 (rho_1 + rho_2 + ...), at least 1.

    The sum ends at the first correlation that is not positive.

    Reference: Geyer, Practical Markov chain Monte Carlo, Statistical Science 7 (1992).
    """
    size, total = float(np.sum(r**2)) or 1.0, 1.0
    for lag in range(1, r.shape[2]):
        rho = float(np.sum(r[:, :, lag:] * r[:, :, :-lag])) / size
        if rho <= 0.0:
            break
        total += 2.0 * rho
    return total


def locate(found: Fit, windows: Windows) -> tuple[Disagreement, ...]:
    """The shares of each measured state in a fit's misfit, largest first."""
    r = residuals(found, windows)
    beyond = np.maximum((r**2).sum(axis=(0, 2)) - windows.measured.sum(axis=(0, 2)), 0.0)
    total = beyond.sum()
    if total == 0.0:
        return ()
    names = found.model.plant.layout.states
    shares = [
        Disagreement(name, float(part / total), _condition(found, windows, r[:, x]))
        for x, (name, part) in enumerate(zip(names, beyond, strict=True))
        if part > 0.0
    ]
    return tuple(sorted(shares, key=lambda share: -share.share))


def located(found: Fit, windows: Windows) -> tuple[Disagreement, ...]:
    """The joints and regions in which a fit's learned force acts, the largest first."""
    layout = found.model.plant.layout
    told = []
    for place in places(found, windows):
        force, joint = place.force, place.force.joint
        regions = [
            f"{axis.of} {low:.2g} to {high:.2g} {_unit(found, axis.of, joint)}{_round(axis)}"
            for axis, (low, high) in zip(force.axes, place.within, strict=True)
        ]
        size = f"{place.largest:.2g} {layout.unit_of(joint)[1]}"
        condition = f"a force of up to {size} at {' and '.join(regions)}"
        channel = layout.states[2 * layout.joints.index(joint)]
        told.append(Disagreement(channel, place.share, condition, joint))
    return tuple(told)


def _round(axis: Axis) -> str:
    return " of each turn" if axis.closed else ""


def _unit(found: Fit, name: str, joint: str) -> str:
    """Of a state, or of the force of an input's actuator."""
    layout = found.model.plant.layout
    if name in layout.states:
        return layout.units[layout.states.index(name)]
    return layout.unit_of(layout.actuator(layout.inputs.index(name)))[1]


def _condition(found: Fit, windows: Windows, r: Float[np.ndarray, "W T"]) -> str:
    """What goes with large residuals of windows: fast or slow motion, large or small commands."""
    layout = found.model.plant.layout
    missed = np.sqrt((r**2).mean(axis=1))
    traits: dict[str, np.ndarray] = {}
    for j, joint in enumerate(layout.joints):
        q = windows.y[:, 2 * j]
        traits[f"|{layout.states[2 * j]}|"] = mean_of_known(np.abs(q))
        traits[f"speed of {joint}"] = mean_of_known(np.abs(np.gradient(q, axis=1)))
    for u, name in enumerate(layout.inputs):
        used = windows.commands[:, windows.lead :, u]
        traits[f"|{name}|"] = np.abs(used).mean(axis=1)
        traits[f"changes of {name}"] = np.abs(np.diff(used, axis=1)).mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ranks = {name: _rank_correlation(missed, trait) for name, trait in traits.items()}
    name = max(ranks, key=lambda n: abs(ranks[n]))
    if abs(ranks[name]) < 0.3:
        return "everywhere alike"
    return f"at {'large' if ranks[name] > 0.0 else 'small'} {name}"


def mean_of_known(y: Float[np.ndarray, "W T"]) -> Float[np.ndarray, " W"]:
    """Of what is known in each window; NaN where nothing is."""
    known = np.isfinite(y)
    total = np.where(known, y, 0.0).sum(axis=1)
    return np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), np.nan)


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's."""
    ranks = [np.argsort(np.argsort(np.nan_to_num(x))) for x in (a, b)]
    found = np.corrcoef(ranks[0], ranks[1])[0, 1]
    return float(found) if np.isfinite(found) else 0.0
