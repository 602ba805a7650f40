"""The force that a model misses in each joint, as far as state and command predict it.

A small force in a joint during a short interval changes the rest of a window in a way that
simulation shows. The residuals of a fit are read as the response to such forces,

    r = G f + e,    f_j = f_j(q, v, u) ~ GP,

so that no derivative of a measurement is taken. Friction, springs, contacts and whatever else
depends on state and command can be learned so; a push by hand, which comes from outside, cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve

from mcpilco.gap.data import Windows
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit, Robust
from mcpilco.gap.plant_model import PerWindow
from mcpilco.gap.sensitivities import linearise, motion
from mcpilco.gap.thresholds import FORCE


@dataclass(frozen=True)
class ForceResponse:
    """The response of a fit's residuals to forces in the joints, initial states eliminated."""

    r: Float[np.ndarray, "W n"]
    """residuals, in noise std"""
    G: Float[np.ndarray, "W n m"]
    """their change with the forces of joint and interval, the intervals of a joint side by side"""
    x: Float[np.ndarray, "W K D"]
    """state and command that go with each interval, every coordinate within about -1 to 1"""
    turns: Float[np.ndarray, "W K E"]
    """sine and cosine of each hinge that turns round and round"""
    joint: Int[np.ndarray, " m"]
    """the joint of each force"""
    samples: Int[np.ndarray, " W"]
    """measured values of each window"""

    def __len__(self) -> int:
        return len(self.r)

    @cached_property
    def by_window(self) -> PerWindow:
        """The squared residuals of each."""
        return np.square(self.r).sum(axis=1)

    @cached_property
    def weights(self) -> PerWindow:
        """Weights that keep a few windows from leading all others."""
        return Robust.of(self.by_window, self.samples).weights(self.by_window)

    def priors(self, coordinates: int) -> list[Float[np.ndarray, "Wm Wm"]]:
        """Covariances of all forces, of variance 1: functions of one coordinate, or of two.

        The second one, where a hinge turns round and round, knows its place in a turn as well.
        """
        if coordinates not in self._known:
            places = [self.x]
            if self.turns.shape[2]:
                places.append(np.concatenate([self.x, self.turns], axis=2))
            self._known[coordinates] = [self._prior(x, coordinates) for x in places]
        return self._known[coordinates]

    @cached_property
    def _known(self) -> dict[int, list[Float[np.ndarray, "Wm Wm"]]]:
        return {}

    def _prior(self, x: Float[np.ndarray, "W K C"], coordinates: int) -> Float[np.ndarray, "Wm Wm"]:
        flat, joint = x.reshape(-1, x.shape[2]), np.tile(self.joint, len(x))
        alike = covariance(flat, flat, coordinates)  # in each joint
        K = np.zeros((len(joint), len(joint)))
        for j in np.unique(self.joint):
            own = np.flatnonzero(joint == j)
            K[np.ix_(own, own)] = alike
        return K


def force_response(fit: Fit, windows: Windows, hold_s: float = FORCE.hold_s) -> ForceResponse:
    """The response of residuals to forces in the joints, each held for `hold_s` [s]."""
    # where dear, motions that were fitted to the windows as they are stay near enough
    near, windows = fit.model.plant.costly and windows.whitening is None, windows.plain
    lin = linearise(fit.model, windows, fit.theta, fit.x0, over_theta=False)
    layout, disturbance = fit.model.plant.layout, Disturbance.of(fit, windows, hold_s, near)
    hold = max(1, round(hold_s / windows.dt))
    first = np.arange(0, windows.y.shape[2] - 1, hold)
    G = disturbance.columns
    G[lin.lost.any(axis=1)] = 0.0
    x, turns = _coordinates(windows, first, hold, layout.slides)
    return ForceResponse(
        r=lin.cleaned(lin.r[:, :, None])[:, :, 0],
        G=lin.cleaned(G),
        x=x,
        turns=turns,
        joint=disturbance.joint,
        samples=windows.samples,
    )


def _coordinates(
    windows: Windows, first: Int[np.ndarray, " K"], hold: int, slides: Sequence[bool]
) -> tuple[Float[np.ndarray, "W K D"], Float[np.ndarray, "W K E"]]:
    """Positions, speeds and commands around the intervals, each brought to about -1 to 1.

    Speeds near 0 are spread out: there dry friction turns over. Beside them stand sine and cosine
    of the hinges that turn round and round.
    """
    middle = np.minimum(first + hold // 2, windows.y.shape[2] - 1)
    moving = motion(windows)
    places = [np.zeros((*moving.shape[:2], 0))]
    for j, slide in enumerate(slides):
        q, v = moving[:, :, 2 * j], moving[:, :, 2 * j + 1]
        if not slide and np.ptp(q) > FORCE.most_turned_rad:
            places.append(np.stack([np.sin(q), np.cos(q)], axis=2))
        slow = FORCE.slow * np.sqrt(np.mean(v**2)) + 1e-12
        moving[:, :, 2 * j + 1] = np.arcsinh(v / slow)
    scaled = [_centred(moving[:, :, c]) for c in range(moving.shape[2])]
    return np.stack(scaled, axis=2)[:, middle], np.concatenate(places, axis=2)[:, middle]


def _centred(x: Float[np.ndarray, "W T"]) -> Float[np.ndarray, "W T"]:
    """So that most of it is between -1 and 1."""
    low, high = np.percentile(x, [2.0, 98.0])
    return 2.0 * (x - 0.5 * (low + high)) / max(high - low, 1e-9)


def covariance(
    a: Float[np.ndarray, "m D"], b: Float[np.ndarray, "n D"], coordinates: int = 2
) -> Float[np.ndarray, "m n"]:
    """Of forces in one joint: functions of two coordinates, or of one, added up; variance 1."""
    D = a.shape[1]
    pairs = [(c, d) for c in range(D) for d in range(c)] if coordinates == 2 else []
    pairs = pairs or [(c, c) for c in range(D)]
    total = np.zeros((len(a), len(b)))
    for lengthscale in FORCE.lengthscales:
        near = [np.exp(-0.5 * np.square((a[:, [d]] - b[:, d]) / lengthscale)) for d in range(D)]
        for c, d in pairs:
            total += near[c] * near[d]
    return total / (len(pairs) * len(FORCE.lengthscales))


def unpredicted_by_forces(
    response: ForceResponse,
    weight: PerWindow | None = None,
    folds: Int[np.ndarray, " W"] | None = None,
    coordinates: int = 2,
) -> PerWindow:
    """The squared residual of a sample of each window that others do not predict.

    They predict it by forces of state and command, as these are in them.

    Args:
        response: of a fit.
        weight: of each window; by default those that fit far worse than most count less.
        folds: number of each window's fold, below `FOLDS`; by default they take turns.
        coordinates: of state and command, on which a force may depend at once: 1 or 2.
    """
    weight = response.weights if weight is None else weight
    folds = np.arange(len(response)) % FORCE.folds if folds is None else folds
    given = weight, folds
    rests = [_unpredicted(response, K, *given) for K in response.priors(coordinates)]
    return min(np.concatenate(rests), key=lambda rest: float(weight @ rest)) / response.samples


def _unpredicted(
    response: ForceResponse,
    K: Float[np.ndarray, "Wm Wm"],
    weight: PerWindow,
    folds: Int[np.ndarray, " W"],
) -> Float[np.ndarray, "S W"]:
    """Squared residuals of each window, less what the other folds predict of it, by strength."""
    rest = np.empty((len(FORCE.strengths), len(response)))
    for fold in np.unique(folds):
        unseen = folds == fold
        missed = response.r[unseen] - _predict(response, K, weight, unseen)
        rest[:, unseen] = np.square(missed).sum(axis=2)
    return rest


def _predict(
    response: ForceResponse,
    K: Float[np.ndarray, "Wm Wm"],
    weight: PerWindow,
    unseen: Bool[np.ndarray, " W"],
) -> Float[np.ndarray, "S V n"]:
    """Residuals of some windows, from those of the others, by each strength of the forces.

    The noise of a window is inflated to what is usual, and by its weight.
    """
    m = response.G.shape[2]
    known = ~unseen
    some = np.flatnonzero(known)
    fewer = np.linspace(0, len(some) - 1, min(len(some), max(1, FORCE.most_unknown // m)))
    known[np.setdiff1d(some, some[fewer.astype(int)])] = False
    misfit = response.by_window[known] / response.samples[known]
    noise = max(1.0, 0.05 * float(np.median(misfit))) / np.maximum(weight[known], 1e-6)
    inside, outside = np.repeat(known, m), np.repeat(unseen, m)
    # with G = Q R, window by window, and strength s: f = K R^T (1/s^2 + R K R^T)^-1 Q^T r
    Q, R = np.linalg.qr(response.G[known] / np.sqrt(noise)[:, None, None])
    y = np.einsum("wni,wn->wi", Q, response.r[known] / np.sqrt(noise)[:, None]).ravel()
    system = _times_blocks(R, _times_blocks(R, K[np.ix_(inside, inside)]).T)
    found = []
    for strength in FORCE.strengths:
        noisy = system.copy(order="F")
        noisy[np.diag_indices(len(system))] += strength**-2
        factor = cho_factor(noisy, overwrite_a=True, check_finite=False)
        found.append(cho_solve(factor, y, check_finite=False))
    pulled = np.einsum("wij,swi->swj", R, np.reshape(found, (len(found), len(R), -1)))
    force = pulled.reshape(len(found), -1) @ K[np.ix_(inside, outside)]
    return np.einsum("wni,swi->swn", response.G[unseen], force.reshape(len(found), -1, m))


def _times_blocks(
    blocks: Float[np.ndarray, "V k m"], K: Float[np.ndarray, "Vm n"]
) -> Float[np.ndarray, "Vk n"]:
    """R K, where R is block-diagonal."""
    V, k, m = blocks.shape
    return (blocks @ K.reshape(V, m, -1)).reshape(V * k, -1)
