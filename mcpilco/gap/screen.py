"""Screening: by how much the misfit would fall with each effect that a fit lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from mcpilco.gap.data import Windows
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit, Robust, misfit
from mcpilco.gap.plant_model import PerWindow
from mcpilco.gap.sensitivities import Linearised, motion_midway, residual, run
from mcpilco.gap.thresholds import SCREEN
from mcpilco.plant import EffectInstance, JointForce, Probe


@dataclass(frozen=True)
class Score:
    """The fall of the misfit that an effect promises."""

    instance: EffectInstance
    gain: float
    """by how much chi^2 would fall, were the model linear"""
    start: Float[np.ndarray, " symbols"]
    """values of the effect from which to fit"""
    sensitivity: float
    """of the measurements to its probe of usual size, all else giving way [noise std]"""


def screen(
    fit: Fit,
    lin: Linearised,
    windows: Windows,
    candidates: Sequence[EffectInstance],
    per_effect: int = 2,
    pulses: Disturbance | None = None,
) -> list[Score]:
    """Scores of candidates, best first.

    Each is simulated at small sizes. Of these signatures, what no start state and no parameter of
    the fitted model could have done is compared with the residual; signs that make no sense
    are not allowed. Where that promises more, few windows that are moved far more than the others
    count less: near an unstable rest a signature is no straight line.

    Args:
        fit: of a model.
        lin: the model where it was fitted.
        windows: to which.
        candidates: effects that the model does not have.
        per_effect: how many probes of each may be scored.
        pulses: responses to forces in the joints, where a simulation is dear: all is then scored on
            few windows first, a force of many shapes as a train of these, and the best on all.
    """
    whole = _Projection.of(fit, lin, windows)
    thinned = whole
    if len(windows) > SCREEN.many_probes:
        some = np.arange(0, len(windows), SCREEN.thinned)
        thinned = _Projection.of(fit.at(some), lin[some], windows[some])
    views, scores = (whole, thinned), []
    first = {c: _scores(views, c, pulses=pulses) for c in candidates}
    if pulses is not None:
        order = sorted(first, key=lambda c: -max((score.gain for score in first[c]), default=0.0))
        for instance in order[: SCREEN.checked]:
            gains = [-score.gain for score in first[instance]]
            first[instance] = _scores(views, instance, np.argsort(gains)[:per_effect])
    for own in first.values():
        scores += sorted(own, key=lambda score: -score.gain)[:per_effect]
    return sorted(scores, key=lambda score: -score.gain)


def _scores(
    views: tuple[_Projection, _Projection],
    instance: EffectInstance,
    chosen: Int[np.ndarray, " n"] | None = None,
    pulses: Disturbance | None = None,
) -> list[Score]:
    """The scores of an effect's probes, or of some; `pulses` as of `screen`."""
    whole, thinned = views
    fit, effect = whole.fit, instance.effect
    parameter = fit.model.frees(instance)
    if parameter is not None:
        gain, sensitivity = whole.freeing(parameter)
        return [Score(instance, gain, effect.neutral, sensitivity)]
    probes = effect.probes(fit.model.scales[instance.target])
    probes = probes if chosen is None else [probes[n] for n in chosen]
    many, force = len(probes) > SCREEN.many_probes, isinstance(effect, JointForce)
    if pulses is not None and many and force:
        view, columns = whole, _trains(whole, instance, probes, pulses)
    else:
        view = thinned if pulses is not None or many else whole
        columns = signatures(view, instance, probes)
    repeated, scores = len(whole.windows) / len(view.windows), []
    first = effect.symbols[0]
    for probe, own in zip(probes, columns, strict=True):
        one_sided = first.low >= first.neutral or not probe.proportional
        Q = view.lin.cleaned(own)
        S, b = view.normal_equations(Q)
        mix, gain = _best_mix(S, b, one_sided)
        if (bounded_view := view.bounding(Q)) is not view:
            other = _best_mix(*bounded_view.normal_equations(Q), one_sided)
            mix, gain = max((mix, gain), other, key=lambda scored: scored[1])
        sensitivity = probe.usual * float(np.sqrt(repeated * np.diag(S).max()))
        values = _values(instance, probe, mix)
        scores.append(Score(instance, repeated * gain, values, sensitivity))
    return scores


def _trains(
    view: _Projection, instance: EffectInstance, probes: Sequence[Probe], pulses: Disturbance
) -> list[Float[np.ndarray, "W n k"]]:
    """The same as `signatures` for a force in a joint, as pulses along the measured motion."""
    model, windows, target = view.fit.model, view.windows, instance.target
    assert isinstance(instance.effect, JointForce)
    j, at = model.plant.layout.joints.index(target), motion_midway(model, view.fit.theta, windows)
    q, v, columns = at[:, :, 2 * j], at[:, :, 2 * j + 1], []
    for probe in probes:
        forces = [instance.effect.force(q, v, *values) + 0.0 * q for values in probe.values]
        usual = np.stack(forces) / model.scales[target].force
        columns.append(pulses.response(j, usual, windows))
    return columns


@dataclass(frozen=True)
class _Projection:
    """A fit, and what is needed to project signatures off its own columns."""

    fit: Fit
    lin: Linearised
    windows: Windows
    weight: PerWindow
    H: Float[np.ndarray, "p p"]
    g: Float[np.ndarray, " p"]
    precision: Float[np.ndarray, " p"]
    """of the prior, tempered"""

    def freeing(self, number: int) -> tuple[float, float]:
        """The fall of chi^2 without the prior of a parameter; the sensitivity to a tenth of it."""
        H, g, held = self.H.copy(), self.g.copy(), self.precision[number]
        H[number, number] -= held
        others = np.delete(np.arange(len(H)), number)
        shared = H[others, number]
        alone = H[number, number] - shared @ np.linalg.solve(H[np.ix_(others, others)], shared)
        if alone < SCREEN.separable * self.H[number, number]:
            return 0.0, 0.0
        g[number] += held * self.fit.theta[number]
        before = held * self.fit.theta[number] ** 2 + self.g @ self.step
        gain = g @ np.linalg.solve(H, g) - before + 2.0 * held * self.fit.theta[number] ** 2
        return float(gain), 0.1 * float(np.sqrt(alone))

    @classmethod
    def of(cls, fit: Fit, lin: Linearised, windows: Windows) -> _Projection:
        by_window = np.einsum("wn,wn->w", lin.r, lin.r)
        weight = Robust.of(by_window, windows.samples).weights(by_window)
        precision = misfit(windows, by_window, weight) * fit.model.precision
        precision += 1e-9  # of what is free and changes nothing
        H, g = lin.normal_equations(fit.theta, weight, precision)
        return cls(fit, lin, windows, weight, _solvable(H), g, precision)

    @cached_property
    def step(self) -> Float[np.ndarray, " p"]:
        """That of theta which the fit would take next."""
        return np.linalg.solve(self.H, self.g)

    def bounding(self, Q: Float[np.ndarray, "W n k"]) -> _Projection:
        """This view, no window of which has far more influence on a cleaned signature than others.

        It is this one itself where none has.
        """
        bound = bounded(np.square(Q).sum(axis=(1, 2)))
        if (bound == 1.0).all():
            return self
        weight = self.weight * bound
        H, g = self.lin.normal_equations(self.fit.theta, weight, self.precision)
        return replace(self, weight=weight, H=_solvable(H), g=g)

    def normal_equations(
        self, Q: Float[np.ndarray, "W n k"]
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """S and b of the best mix of cleaned signatures, everything else free to give way."""
        WQ = self.weight[:, None, None] * Q
        rows = WQ.reshape(-1, WQ.shape[2]).T
        QHP, whole = (
            rows @ part.reshape(rows.shape[1], part.shape[2]) for part in (self.lin.own, Q)
        )
        S = whole - QHP @ np.linalg.solve(self.H, QHP.T)
        b = rows @ self.lin.r.ravel() - QHP @ self.step
        same = np.diag(S) < SCREEN.separable * np.diag(whole)
        S[same], S[:, same], b[same] = 0.0, 0.0, 0.0
        return S, b


def _solvable(H: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """H, where two numbers of theta do the same too."""
    return H + SCREEN.rounding * np.diag(np.diag(H))


def bounded(influence: PerWindow) -> PerWindow:
    """Weights of windows, none of which then has far more influence than the others [-].

    Reference: Hampel, Ronchetti, Rousseeuw & Stahel, Robust Statistics (1986), section 6.3:
        Mallows's estimator, with windows for samples.
    """
    most = SCREEN.influence * np.percentile(influence, 75.0)
    return np.minimum(1.0, most / np.maximum(influence, 1e-12))


def signatures(
    view: _Projection, instance: EffectInstance, probes: Sequence[Probe]
) -> list[Float[np.ndarray, "W n k"]]:
    """How the simulation changes with an effect of each size of each probe, in noise std."""
    if not probes:
        return []
    fit, windows = view.fit, view.windows
    model = fit.model.having(instance)
    by_probe = [_sizes(instance, probe) for probe in probes]
    sizes = np.concatenate(by_probe)
    thetas = np.stack([model.appended(fit.theta, size) for size in sizes])
    x0 = np.tile(fit.x0, (len(thetas), 1, 1))
    y = run(model, windows, thetas, x0)
    change = view.lin.r - residual(windows, y)
    change[~np.isfinite(change) | (np.abs(change) > _most(windows))] = 0.0
    parts = np.split(change, np.cumsum([len(own) for own in by_probe])[:-1])
    straight = [_straight(probe, part) for probe, part in zip(probes, parts, strict=True)]
    return [part.transpose(1, 2, 0) for part in straight]


def _most(windows: Windows) -> Float[np.ndarray, " n"]:
    """The change of each reading beyond which a simulation ran away, in noise std."""
    y = windows.y.transpose(1, 0, 2).reshape(windows.y.shape[1], -1)
    ends = (np.max(sign * y, axis=1, where=np.isfinite(y), initial=-np.inf) for sign in (1, -1))
    most = np.maximum(SCREEN.farthest, sum(ends) / windows.std)
    return np.repeat(most, windows.y.shape[2])


def _sizes(instance: EffectInstance, probe: Probe) -> Float[np.ndarray, "n symbols"]:
    """Those at which a probe is simulated."""
    if not probe.bent:
        return probe.values
    neutral = instance.effect.neutral
    return np.concatenate([probe.values, neutral + 0.5 * (probe.values - neutral)])


def _straight(probe: Probe, change: Float[np.ndarray, "n W N"]) -> Float[np.ndarray, "m W N"]:
    """The changes by a probe's sizes; where it bends, in proportion to infinitesimal ones.

    Reference: Richardson, Philosophical Transactions A 210 (1911), the first step.
    """
    if not probe.bent:
        return change
    whole, half = np.split(change, 2)
    return 4.0 * half - whole


def _best_mix(S: np.ndarray, b: np.ndarray, one_sided: bool) -> tuple[np.ndarray, float]:
    """Coefficients c that maximise 2 b.c - c.S c, and that value; not negative if one-sided."""
    best, gain = np.zeros(len(b)), 0.0
    n = len(b)
    for subset in range(1, 2**n):
        chosen = [i for i in range(n) if subset >> i & 1]
        some, wanted = S[np.ix_(chosen, chosen)], b[chosen]
        if len(chosen) == 1:
            c = wanted / np.where(some[0] > 0.0, some[0], np.inf)
        else:
            c = np.linalg.lstsq(some, wanted, rcond=1e-10)[0]
        if one_sided and (c < 0.0).any():
            continue
        value = float(b[chosen] @ c)
        if value > gain:
            best, gain = np.zeros(n), value
            best[chosen] = c
    return best, gain


def _values(
    instance: EffectInstance, probe: Probe, mix: np.ndarray
) -> Float[np.ndarray, " symbols"]:
    """The mix of a probe's sizes; what shapes a formula stays as the probe has it."""
    neutral, amplitudes = instance.effect.neutral, instance.effect.amplitudes
    with np.errstate(invalid="ignore"):
        mixed = neutral + mix @ (probe.values - neutral)
    values = np.where(amplitudes & np.isfinite(mixed), mixed, probe.values[0])
    low = np.array([symbol.low for symbol in instance.effect.symbols])
    high = np.array([symbol.high for symbol in instance.effect.symbols])
    return np.clip(values, low, high)
