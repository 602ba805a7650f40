"""A force that no effect explains, learned from the residuals of a fit.

The force is a sum of few parts. Each acts in one joint and is a Gaussian process over one or two of
the positions, velocities and actuator forces; which joint and which of these is chosen by how well
windows are predicted from others, so that it says where something is missing. The parts are found
in the linear response to small forces, as in `residual_force`, and then fitted to free runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve

from mcpilco.gap.data import Windows
from mcpilco.gap.fit import Fit, fit_model, on_windows
from mcpilco.gap.plant_model import GridForce, PerWindow
from mcpilco.gap.residual_force import ForceResponse, force_response
from mcpilco.gap.sensitivities import motion_midway
from mcpilco.gap.thresholds import BUDGET, FORCE
from mcpilco.plant import Axis, GridPrior, Layout, LearnedForce, Plant


@dataclass(frozen=True)
class Fineness:
    """How fine the grid over a coordinate is."""

    lengthscale: float
    """relative to half its extent; of an angle that is not wound to a quarter turn at most"""
    wound: bool = False
    """whether all that an angle has turned counts, as of a spring that winds up"""
    closed: bool = False
    """whether the place in a turn alone counts"""


FINE, MEDIUM, COARSE, WOUND = Fineness(0.05), Fineness(0.1), Fineness(0.25), Fineness(0.25, True)


def with_learned_force(fit: Fit, windows: Windows, short: Windows) -> Fit:
    """The fit with a learned force of as many parts as predict more; itself where none does.

    Args:
        fit: a fit.
        windows: those that it is to be fitted to in the end.
        short: windows of `GapProblem.short_s` of the same recordings: in them the response to a
            missing force is still linear.
    """
    share = fit.model.budget.share(BUDGET.learning)
    part = on_windows(fit, short)
    for number in range(FORCE.parts):
        force = None if number and share.used_up else best_force(part, short)
        if force is None:
            break
        model = replace(part.model, learned=(*part.model.learned, force))
        theta = np.append(part.theta, np.zeros(force.basis.shape[1]))
        part = fit_model(model, short, theta, part.x0, iterations=FORCE.iterations_short)
    if not part.model.learned:
        return fit
    part = on_windows(part, windows)
    return fit_model(part.model, windows, part.theta, part.x0, iterations=FORCE.iterations)


def learned_of(fit: Fit) -> tuple[LearnedForce, ...]:
    """The learned forces of a fit."""
    weights = fit.model.weights(fit.theta[None])
    return tuple(
        LearnedForce(grid.joint, grid.axes, tuple(map(float, own[0])))
        for grid, own in zip(fit.model.learned, weights, strict=True)
    )


def corrected(fit: Fit) -> Plant:
    """The plant with the effects, parameters and learned forces of a fit, in no timesteps."""
    model, plant, theta = fit.model, fit.model.plant.in_steps(0.0), fit.theta[None]
    parameters, _ = model.decode(theta)
    names = [parameter.name for parameter in plant.parameters]
    changed = {name: float(parameters[0, names.index(name)]) for name in model.priors}
    pairs = [(effect, values[0]) for effect, values in model.effect_values(theta)]
    return plant.where(**changed).having(pairs[len(model.freed) :]).with_learned(learned_of(fit))


def best_force(fit: Fit, short: Windows) -> GridForce | None:
    """The force that predicts best what a fit leaves over; None where none is worth it."""
    if log_misfit(fit.by_window / short.samples, short.samples) < FORCE.fits:
        return None
    best = simplest(list(candidates(fit, short)))
    return best.force() if best.predicted > FORCE.worth else None


def log_misfit(misfit: PerWindow, samples: Int[np.ndarray, " W"]) -> float:
    """Mean log misfit of a sample beyond the noise."""
    return float(np.average(np.log(np.maximum(misfit, 1.0)), weights=samples))


@dataclass(frozen=True)
class ForceCandidate:
    """A force in one joint over some coordinates."""

    joint: str
    prior: GridPrior
    strength: float
    """std of the force that predicts best [N or N m]"""
    information: Float[np.ndarray, "R R"]
    """what the windows tell of its directions, beside a prior of 1"""
    predicted: float
    """part of the log misfit that it predicts of windows from others [-]"""
    unpredicted: PerWindow
    """squared residual of a sample of each window that it does not predict from others"""

    def force(self) -> GridForce:
        """The force, in the directions that the windows tell of; in the others it stays 0."""
        informed, directions = np.linalg.eigh(self.information)
        basis = self.strength * self.prior.weights(directions[:, informed > FORCE.informed])
        return GridForce(self.joint, self.prior.axes, basis)


def simplest(forces: Sequence[ForceCandidate]) -> ForceCandidate:
    """The candidate that predicts most, or one over a single coordinate that does about as well."""
    best = max(forces, key=lambda one: one.predicted)
    single = max((one for one in forces if len(one.prior.axes) == 1), key=lambda one: one.predicted)
    return best if best.predicted > single.predicted + FORCE.worth_a_pair else single


def candidates(
    fit: Fit, windows: Windows, folds: Int[np.ndarray, " W"] | None = None
) -> Iterator[ForceCandidate]:
    """Forces in each joint over all that they could depend on, each at its best strength.

    Args:
        fit: a fit to the windows.
        windows: short ones.
        folds: number of each window's fold, below `FOLDS`; by default they take turns.
    """
    folds = np.arange(len(windows)) % FORCE.folds if folds is None else folds
    response = force_response(fit, windows, hold_s=windows.dt)
    layout = fit.model.plant.layout
    motion = motion_midway(fit.model, fit.theta, windows)
    turned = [
        c
        for c in range(motion.shape[2])
        if _is_angle(layout, c) and np.ptp(motion[:, :, c]) > FORCE.most_turned_rad
    ]
    for j, joint in enumerate(layout.joints):
        Q, R = np.linalg.qr(response.G[:, :, response.joint == j])
        r = (response.r[:, None] @ Q)[:, 0]  # all that a force in the joint can change
        usual = fit.model.scales[joint].force
        for over, shape in _forms(j, motion.shape[2], turned):
            grids = [_axis(fit, c, motion[:, :, c], s) for c, s in zip(over, shape, strict=True)]
            axes, lengthscales = zip(*grids, strict=True)
            prior = GridPrior.of(axes, lengthscales, FORCE.least_variance)
            features = prior.features([motion[:, :, c].ravel() for c in over])
            columns = R @ features.reshape(*motion.shape[:2], -1)
            yield _judged(joint, prior, usual, columns, r, response, folds)


Form = tuple[tuple[int, ...], tuple[Fineness, ...]]
"""the coordinates of a force, and how fine its grid is over each"""


def _forms(j: int, D: int, turned: Sequence[int]) -> Iterator[Form]:
    """The coordinates of a force at joint j, of D, and how fine; of two coordinates one is its own.

    Angles that have `turned` so far have a place in a turn that is another thing.
    """
    for over, shape in _plain_forms(j, D):
        either = [
            _over_turns(part) if c in turned else (part,)
            for c, part in zip(over, shape, strict=True)
        ]
        yield from ((over, one) for one in product(*either))


def _over_turns(part: Fineness) -> Iterator[Fineness]:
    """Grids over an angle that turns far: over a turn, over part of all that it turns, over all."""
    yield replace(part, closed=True)
    yield part
    if part is COARSE:
        yield WOUND


def _plain_forms(j: int, D: int) -> Iterator[Form]:
    for c in range(D):
        yield from (((c,), (shape,)) for shape in (FINE, COARSE))
    for c, d in combinations(range(D), 2):
        if not {2 * j, 2 * j + 1}.isdisjoint((c, d)):
            yield (c, d), (COARSE, COARSE)
    yield from (((2 * j, d), (MEDIUM, COARSE)) for d in range(D) if d != 2 * j)


def _is_angle(layout: Layout, c: int) -> bool:
    """Whether a coordinate is the position of a hinge."""
    return c < len(layout.states) and c % 2 == 0 and not layout.slides[c // 2]


def _axis(fit: Fit, c: int, x: Float[np.ndarray, "W m"], shape: Fineness) -> tuple[Axis, float]:
    """A grid over the range of a coordinate, and the lengthscale that it is fine enough for."""
    layout = fit.model.plant.layout
    name = (*layout.states, *layout.inputs)[c]
    if shape.closed:
        lengthscale = shape.lengthscale * 0.5 * np.pi
        knots = int(np.ceil(2.0 * np.pi / (FORCE.knots * lengthscale)))
        return Axis(name, -np.pi, np.pi - 2.0 * np.pi / knots, knots, closed=True), lengthscale
    state, turns = c < len(layout.states), _is_angle(layout, c) and not shape.wound
    low, high = _densest(x.ravel(), FORCE.most_turned_rad if turns else np.inf)
    slow = FORCE.learned_slow * float(np.sqrt(np.mean(x**2))) if state and c % 2 == 1 else 0.0
    room = 1e-6 + 1e-3 * (high - low)
    axis = Axis(name, low - room, high + room, 4, slow)
    extent = float(axis.places[-1] - axis.places[0])
    lengthscale = shape.lengthscale * (min(0.5 * extent, 0.5 * np.pi) if turns else 0.5 * extent)
    knots = 1 + int(np.ceil(extent / (FORCE.knots * lengthscale)))
    return replace(axis, knots=max(axis.knots, knots)), lengthscale


def _densest(x: Float[np.ndarray, " N"], most: float) -> tuple[float, float]:
    """The interval, no longer than `most`, that holds most of some values."""
    x = np.sort(x)
    last = np.searchsorted(x, x + most, side="right") - 1
    first = int(np.argmax(last - np.arange(len(x))))
    return float(x[first]), float(x[last[first]])


def _judged(
    joint: str,
    prior: GridPrior,
    usual: float,
    columns: Float[np.ndarray, "W K R"],
    r: Float[np.ndarray, "W K"],
    response: ForceResponse,
    fold: Int[np.ndarray, " W"],
) -> ForceCandidate:
    """A force as it predicts each window from the windows of the other folds.

    The noise of a window is inflated by a part of its misfit, and its log misfit is what counts: a
    force that acts in few windows shows only in these, and an event must not lead them all.
    """
    misfit = response.by_window / response.samples
    size = np.sqrt(np.maximum(1.0, FORCE.inflation * misfit))[:, None]
    beyond = np.maximum(response.by_window - np.square(r).sum(axis=1), 0.0)
    R, of = columns.shape[2], [fold == k for k in range(FORCE.folds)]
    parts = [columns[own].reshape(-1, R) for own in of]
    rows = [np.repeat(1.0 / size[own], columns.shape[1]) for own in of]
    scaled = [part * row[:, None] for part, row in zip(parts, rows, strict=True)]
    wanted = [r[own].ravel() * row for own, row in zip(of, rows, strict=True)]
    A = np.stack([part.T @ part for part in scaled])
    b = np.stack([part.T @ own for part, own in zip(scaled, wanted, strict=True)])
    whole_A, whole_b = A.sum(axis=0), b.sum(axis=0)
    before = log_misfit(misfit, response.samples)
    unpredicted = np.empty((len(FORCE.learned_strengths), len(response)))
    for k, own in enumerate(of):
        means = _means(whole_A - A[k], whole_b - b[k])
        missed = r[own] - (means @ parts[k].T).reshape(len(means), *r[own].shape)
        squares = np.square(missed).sum(axis=2) + beyond[own]
        unpredicted[:, own] = squares / response.samples[own]
    after = [log_misfit(part, response.samples) for part in unpredicted]
    best = int(np.argmin(after))
    information = FORCE.learned_strengths[best] ** 2 * whole_A
    share = 1.0 - after[best] / before if before > 0.0 else 0.0
    return ForceCandidate(
        joint, prior, usual * FORCE.learned_strengths[best], information, share, unpredicted[best]
    )


def _means(A: Float[np.ndarray, "R R"], b: Float[np.ndarray, " R"]) -> Float[np.ndarray, "S R"]:
    """The likeliest force by each strength, where A is known of it beside a prior, and b wanted."""
    means = []
    for strength in FORCE.learned_strengths:
        factor = cho_factor(A + np.eye(len(A)) / strength**2, check_finite=False)
        means.append(cho_solve(factor, b, check_finite=False))
    return np.stack(means)


BINS, SEEN = 80, 3
"""of an axis, and samples that one needs to count"""


@dataclass(frozen=True)
class ForcePlace:
    """Where a part of a learned force acts."""

    force: LearnedForce
    largest: float
    """in the recordings, but for one sample in two hundred [N or N m]"""
    share: float
    """of the squared learned force, in usual forces of the joints [-]"""
    within: tuple[tuple[float, float], ...]
    """for each axis, the shortest interval with most of the squared force over what was visited"""


def force_places(fit: Fit, windows: Windows) -> tuple[ForcePlace, ...]:
    """The joints and regions of a fit's learned force, the part that does most first."""
    layout = fit.model.plant.layout
    names = (*layout.states, *layout.inputs)
    motion = motion_midway(fit.model, fit.theta, windows).reshape(-1, len(names))
    parts = []
    for force in learned_of(fit):
        x = [motion[:, names.index(axis.of)] for axis in force.axes]
        size = np.abs(force.at(*x))
        work = np.mean(np.square(size / fit.model.scales[force.joint].force))
        visited = [axis.once(places) for axis, places in zip(force.axes, x, strict=True)]
        within = tuple(_shortest(places, size**2) for places in visited)
        parts.append((force, float(np.percentile(size, 99.5)), float(work), within))
    total = sum(work for _, _, work, _ in parts) or 1.0
    places = [ForcePlace(force, most, work / total, within) for force, most, work, within in parts]
    return tuple(sorted(places, key=lambda place: -place.share))


def _shortest(x: Float[np.ndarray, " N"], squares: Float[np.ndarray, " N"]) -> tuple[float, float]:
    """The shortest interval with most of the squares, every part that was visited alike."""
    count, edges = np.histogram(x, BINS)
    total, _ = np.histogram(x, edges, weights=squares)
    mean = np.where(count >= SEEN, total / np.maximum(count, 1), 0.0)
    sums = np.append(0.0, np.cumsum(mean))
    last = np.searchsorted(sums, sums[:-1] + FORCE.most_of_force * sums[-1])
    length = np.where(last < len(sums), last - np.arange(BINS), BINS + 1)
    first = int(np.argmin(length))
    return float(edges[first]), float(edges[min(last[first], BINS)])
