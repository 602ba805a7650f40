"""A force that no effect explains, learned from what a fit leaves over.

The force is a sum of few parts. Each acts in one joint and is a Gaussian process over one or two of
the positions, velocities and actuator forces; which joint and which of these is chosen by how well
windows are predicted from others, so that it says where something is missing. The parts are found
in the linear response to small forces, as in `residual_force`, and then fitted to free runs, as any
effect is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from jaxtyping import Float, Int

from mcpilco.gap.fit import Fit, fit, misfits, settle
from mcpilco.gap.grid_force import GridForce, Prior
from mcpilco.gap.moves import MOST_TURNED, moves_of
from mcpilco.gap.residual_force import FOLDS, Response, respond
from mcpilco.gap.windows import Windows
from mcpilco.plant import Axis, Layout, LearnedForce

SHORT_S = 0.36
"""length of the windows in which a force is sought [s]"""
PARTS = 4
"""of a learned force, at most"""
SHARE = 0.6
"""of the steps left, to find parts; the rest is for the last fit"""
WORTH = 0.15
"""least part of the log misfit that a further part must predict"""
FITS = 0.05
"""mean log misfit below which nothing is left to explain"""
WORTH_A_PAIR = 0.06
"""part of the log misfit that a force over two coordinates must predict beyond one over one"""
KNOTS = 0.6
"""from knot to knot, in lengthscales"""
SLOW = 0.03
"""speed, in the rms of a joint's, below which speeds are spread out"""
STRENGTHS = 0.05, 0.2, 0.8
"""std of the force that are tried, in usual forces of a joint"""
INFLATION = 0.05
"""part of a window's misfit that counts as noise"""
LEAST = 0.03
"""prior variance of a direction of a grid below which it is left out"""
FELT = 0.1
"""what data tell of a direction, over what the prior does, below which it is left out"""
ROUGHLY, WELL = 6, 8
"""iterations of a fit to short windows, and to all of them"""


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


def learn(found: Fit, windows: Windows, short: Windows) -> Fit:
    """The fit with a learned force of as many parts as predict more; itself where none does.

    Args:
        found: a fit.
        windows: those that it is to be fitted to in the end.
        short: windows of `SHORT_S` of the same recordings: in them a force that is missing does not
            lead a motion so far away that its response is no longer linear.
    """
    share = found.model.effort.share(SHARE)
    part = moved(found, short)
    for _ in share.lasting(range(PARTS)):
        force = seek(part, short)
        if force is None:
            break
        model = replace(part.model, learned=(*part.model.learned, force))
        theta = np.append(part.theta, np.zeros(force.basis.shape[1]))
        part = fit(model, short, theta, part.starts, iterations=ROUGHLY)
    if not part.model.learned:
        return found
    part = moved(part, windows)
    return fit(part.model, windows, part.theta, part.starts, iterations=WELL)


def moved(found: Fit, windows: Windows) -> Fit:
    """A fit as it is on other windows, whose starts alone are fitted."""
    starts = settle(found.model, windows, found.theta)
    by_window = misfits(found.model, windows, found.theta, starts)
    return Fit(found.model, found.theta, starts, float(by_window.sum()), by_window)


def learned_of(found: Fit) -> tuple[LearnedForce, ...]:
    """The learned forces of a fit."""
    weights = found.model.weights(found.theta[None])
    return tuple(
        LearnedForce(grid.joint, grid.axes, tuple(map(float, own[0])))
        for grid, own in zip(found.model.learned, weights, strict=True)
    )


def seek(found: Fit, short: Windows) -> GridForce | None:
    """The force that predicts best what a fit leaves over; None where none is worth it."""
    if log_misfit(found.by_window / short.samples, short.samples) < FITS:
        return None
    best = simplest(list(candidates(found, short)))
    return best.force() if best.predicted > WORTH else None


def log_misfit(misfit: Float[np.ndarray, " W"], samples: Int[np.ndarray, " W"]) -> float:
    """Mean log misfit of a sample beyond the noise."""
    return float(np.average(np.log(np.maximum(misfit, 1.0)), weights=samples))


@dataclass(frozen=True)
class Candidate:
    """A force in one joint over some coordinates."""

    joint: str
    prior: Prior
    strength: float
    """std of the force that predicts best [N or N m]"""
    information: Float[np.ndarray, "R R"]
    """what the windows tell of its directions, beside a prior of 1"""
    predicted: float
    """part of the log misfit that it predicts of windows from others [-]"""
    left: Float[np.ndarray, " W"]
    """squared residual of a sample of each window that it does not predict from others"""

    def force(self) -> GridForce:
        """The force, in the directions that the windows tell of; in the others it stays 0."""
        told, directions = np.linalg.eigh(self.information)
        basis = self.strength * self.prior.weights(directions[:, told > FELT])
        return GridForce(self.joint, self.prior.axes, basis)


def simplest(known: Sequence[Candidate]) -> Candidate:
    """The candidate that predicts most, or one over a single coordinate that does about as well."""
    best = max(known, key=lambda one: one.predicted)
    single = max((one for one in known if len(one.prior.axes) == 1), key=lambda one: one.predicted)
    return best if best.predicted > single.predicted + WORTH_A_PAIR else single


def candidates(
    found: Fit, windows: Windows, folds: Int[np.ndarray, " W"] | None = None
) -> Iterator[Candidate]:
    """Forces in each joint over all that they could depend on, each at its best strength.

    Args:
        found: a fit to the windows.
        windows: short ones.
        folds: number of each window's fold, below `FOLDS`; by default they take turns.
    """
    folds = np.arange(len(windows)) % FOLDS if folds is None else folds
    response = respond(found, windows, hold_s=windows.dt)
    layout = found.model.plant.layout
    moves = moves_of(found.model, found.theta, windows)
    turned = [
        c
        for c in range(moves.shape[2])
        if _is_angle(layout, c) and np.ptp(moves[:, :, c]) > MOST_TURNED
    ]
    for j, joint in enumerate(layout.joints):
        G = response.G[:, :, response.joint == j]
        usual = found.model.scales[joint].force
        for over, shape in _forms(j, moves.shape[2], turned):
            grids = [_axis(found, c, moves[:, :, c], s) for c, s in zip(over, shape, strict=True)]
            axes, lengthscales = zip(*grids, strict=True)
            prior = Prior.of(axes, lengthscales, LEAST)
            features = prior.features([moves[:, :, c].ravel() for c in over])
            columns = G @ features.reshape(*moves.shape[:2], -1)
            yield _judged(joint, prior, usual, columns, response, folds)


Form = tuple[tuple[int, ...], tuple[Fineness, ...]]
"""the coordinates of a force, and how fine its grid is over each"""


def _forms(j: int, D: int, turned: Sequence[int]) -> Iterator[Form]:
    """What a force at joint j may depend on, and how finely; of two coordinates one is its own.

    Args:
        j: number of the joint.
        D: how many coordinates there are.
        turned: angles that turn so far that their place in a turn is another thing.
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


def _axis(found: Fit, c: int, x: Float[np.ndarray, "W m"], shape: Fineness) -> tuple[Axis, float]:
    """A grid over the range of a coordinate, and the lengthscale that it is fine enough for."""
    layout = found.model.plant.layout
    name = (*layout.states, *layout.inputs)[c]
    if shape.closed:
        lengthscale = shape.lengthscale * 0.5 * np.pi
        knots = int(np.ceil(2.0 * np.pi / (KNOTS * lengthscale)))
        return Axis(name, -np.pi, np.pi - 2.0 * np.pi / knots, knots, closed=True), lengthscale
    state, turns = c < len(layout.states), _is_angle(layout, c) and not shape.wound
    low, high = _densest(x.ravel(), MOST_TURNED if turns else np.inf)
    slow = SLOW * float(np.sqrt(np.mean(x**2))) if state and c % 2 == 1 else 0.0
    room = 1e-6 + 1e-3 * (high - low)
    axis = Axis(name, low - room, high + room, 4, slow)
    extent = float(axis.places[-1] - axis.places[0])
    lengthscale = shape.lengthscale * (min(0.5 * extent, 0.5 * np.pi) if turns else 0.5 * extent)
    knots = 1 + int(np.ceil(extent / (KNOTS * lengthscale)))
    return replace(axis, knots=max(axis.knots, knots)), lengthscale


def _densest(x: Float[np.ndarray, " N"], most: float) -> tuple[float, float]:
    """The interval, no longer than `most`, that holds most of some values."""
    x = np.sort(x)
    last = np.searchsorted(x, x + most, side="right") - 1
    first = int(np.argmax(last - np.arange(len(x))))
    return float(x[first]), float(x[last[first]])


def _judged(
    joint: str,
    prior: Prior,
    usual: float,
    columns: Float[np.ndarray, "W n R"],
    response: Response,
    fold: Int[np.ndarray, " W"],
) -> Candidate:
    """What a force predicts of each window from the windows of the other folds.

    The noise of a window is inflated by a part of its misfit, and its log misfit is what counts: a
    force that is felt in few windows shows only in these, and an event must not lead them all.
    """
    misfit = response.by_window / response.samples
    size = np.sqrt(np.maximum(1.0, INFLATION * misfit))[:, None]
    A, b = np.empty((FOLDS, *columns.shape[2:] * 2)), np.empty((FOLDS, columns.shape[2]))
    for k in range(FOLDS):
        own = fold == k
        flat = (columns[own] / size[own, :, None]).reshape(-1, columns.shape[2])
        A[k], b[k] = flat.T @ flat, flat.T @ (response.r[own] / size[own]).ravel()
    before = log_misfit(misfit, response.samples)
    left = [_unpredicted(strength, A, b, columns, fold, response) for strength in STRENGTHS]
    after = [log_misfit(part, response.samples) for part in left]
    best = int(np.argmin(after))
    information = STRENGTHS[best] ** 2 * A.sum(axis=0)
    share = 1.0 - after[best] / before if before > 0.0 else 0.0
    return Candidate(joint, prior, usual * STRENGTHS[best], information, share, left[best])


def _unpredicted(
    strength: float,
    A: Float[np.ndarray, "F R R"],
    b: Float[np.ndarray, "F R"],
    columns: Float[np.ndarray, "W n R"],
    fold: Int[np.ndarray, " W"],
    response: Response,
) -> Float[np.ndarray, " W"]:
    """Squared residual of a sample of each window, less what the other folds predict of it."""
    left = np.empty(len(response))
    for k in range(FOLDS):
        H = strength**2 * (A.sum(axis=0) - A[k]) + np.eye(A.shape[1])
        mean = strength**2 * np.linalg.solve(H, b.sum(axis=0) - b[k])
        missed = response.r[fold == k] - columns[fold == k] @ mean
        left[fold == k] = np.square(missed).sum(axis=1)
    return left / response.samples
