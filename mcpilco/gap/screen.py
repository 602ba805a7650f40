"""Which effects could explain what a fit leaves over: a score for every candidate at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.effects import Probe
from mcpilco.gap.fit import Fit, Linear, misfit, residual, run, weights
from mcpilco.gap.model import Model
from mcpilco.gap.windows import Windows
from mcpilco.plant import Active


@dataclass(frozen=True)
class Score:
    """What adding an effect promises."""

    active: Active
    gain: float
    """by how much chi^2 would fall, were the model linear"""
    start: Float[np.ndarray, " symbols"]
    """values of the effect from which to fit"""


def screen(
    fit: Fit, lin: Linear, windows: Windows, candidates: Sequence[Active], per_effect: int = 1
) -> list[Score]:
    """Scores of candidates, best first.

    Each is simulated at small sizes. Of these signatures, what no start state and no parameter of
    the fitted model could have done is compared with the residual; signs that make no sense
    are not allowed.

    Args:
        fit: of a model.
        lin: the model where it was fitted.
        windows: to which.
        candidates: effects that the model does not have.
        per_effect: how many probes of each may be scored.
    """
    by_window = np.einsum("wn,wn->w", lin.r, lin.r)
    weight = weights(by_window, windows)
    precision = misfit(windows, by_window, weight) * fit.model.precision
    P = lin.cleaned(lin.Jp)
    WP = weight[:, None, None] * P
    H = np.einsum("wni,wnj->ij", WP, P) + np.diag(precision + 1e-9)
    g = np.einsum("wni,wn->i", WP, lin.r) - precision * fit.theta
    found: list[Score] = []
    for active in candidates:
        probes = active.effect.probes(fit.model.scales[active.target])
        if not probes:
            continue
        own = []
        for probe, columns in zip(probes, signatures(fit, windows, active, probes), strict=True):
            Q = lin.cleaned(columns)
            HPQ = np.einsum("wni,wnj->ij", WP, Q)
            WQ = weight[:, None, None] * Q
            S = np.einsum("wni,wnj->ij", WQ, Q) - HPQ.T @ np.linalg.solve(H, HPQ)
            b = np.einsum("wni,wn->i", WQ, lin.r) - HPQ.T @ np.linalg.solve(H, g)
            mix, gain = _best_mix(S, b, one_sided=_one_sided(active, probe))
            own.append(Score(active, gain, _values(active, probe, mix)))
        found += sorted(own, key=lambda score: -score.gain)[:per_effect]
    return sorted(found, key=lambda score: -score.gain)


def signatures(
    fit: Fit, windows: Windows, active: Active, probes: Sequence[Probe]
) -> list[Float[np.ndarray, "W n k"]]:
    """How the simulation changes with an effect of each size of each probe, in noise std."""
    model = fit.model.having(active)
    sizes = np.concatenate([probe.values for probe in probes])
    known = fit.effects
    thetas = np.stack([model.encode([*known, size]) for size in sizes])
    thetas[:, : model.nuisances] = fit.theta[: model.nuisances]
    starts = np.tile(fit.starts, (len(thetas), 1, 1))
    y = run(model, windows, thetas, starts)
    y0 = run(fit.model, windows, fit.theta[None], fit.starts[None])[0]
    with np.errstate(invalid="ignore"):
        change = residual(windows, y0) - residual(windows, y)
    change[~np.isfinite(change) | (np.abs(change) > 500.0)] = 0.0
    ends = np.cumsum([len(probe.values) for probe in probes])
    return [part.transpose(1, 2, 0) for part in np.split(change, ends[:-1])]


def _one_sided(active: Active, probe: Probe) -> bool:
    symbol = active.effect.symbols[0]
    return symbol.low >= symbol.neutral or not probe.proportional


def _best_mix(S: np.ndarray, b: np.ndarray, one_sided: bool) -> tuple[np.ndarray, float]:
    """Coefficients c that maximise 2 b.c - c.S c, and that value; not negative if one-sided."""
    best, gain = np.zeros(len(b)), 0.0
    n = len(b)
    for subset in range(1, 2**n):
        chosen = [i for i in range(n) if subset >> i & 1]
        c = np.linalg.lstsq(S[np.ix_(chosen, chosen)], b[chosen], rcond=1e-10)[0]
        if one_sided and (c < 0.0).any():
            continue
        value = float(b[chosen] @ c)
        if value > gain:
            best, gain = np.zeros(n), value
            best[chosen] = c
    return best, gain


def _values(active: Active, probe: Probe, mix: np.ndarray) -> Float[np.ndarray, " symbols"]:
    """The mix of a probe's sizes; what shapes a formula stays as the probe has it."""
    neutral = active.effect.neutral
    amplitude = (neutral == 0.0) | (len(neutral) == 1)
    with np.errstate(invalid="ignore"):
        mixed = neutral + mix @ (probe.values - neutral)
    values = np.where(amplitude & np.isfinite(mixed), mixed, probe.values[0])
    low = np.array([symbol.low for symbol in active.effect.symbols])
    high = np.array([symbol.high for symbol in active.effect.symbols])
    return np.clip(values, low, high)
