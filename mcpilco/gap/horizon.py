"""How far a machine that touches things can be followed, in which timesteps, and what is noise.

Behind an impact a motion does not answer smoothly to its start, and fits lose it: windows end
before. Nor do recordings alone tell what is noise there, for an impact is as sudden, or between
samples far apart. What even the nominal plant leaves of a few is more than the noise, and far less
than a smooth curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.fit import fit_initial_states
from mcpilco.gap.plant_model import PlantModel
from mcpilco.gap.sensitivities import residuals_at, run, start_nudges
from mcpilco.gap.thresholds import DATA

LOOKED_AT_S = 5.0
"""of motions that are looked at, for the cost [s]"""
BRIEF_S = 0.2
"""length of windows whose residuals are noise [s]; at least eight samples"""
CLOSE_S = 0.03
"""between samples, from which on a smooth curve misses how a machine turns from one to the next"""
ROUNDS = 2
"""in which noise is estimated: what a start explains depends on it"""
NORMAL = 0.6745
"""median absolute value of a standard normal variable"""


def followed(problem: GapProblem, known: Mapping[str, float]) -> GapProblem:
    """The problem with windows, timesteps and noise that suit a plant that MuJoCo simulates.

    With equations the noise alone, where samples are far apart.

    Args:
        problem: with windows as they are for equations.
        known: std of the noise of some states, by name [their unit], which stays as it is.

    Raises:
        InputError: most of the motions run away, however short the timesteps are.
    """
    stepped = problem.plant.timestep_s > 0.0
    if not stepped and problem.recordings[0].dt <= CLOSE_S:
        return problem
    fixed = np.isin(problem.plant.layout.states, list(known))
    if not stepped:
        left = _left(problem, problem.windows(seconds=BRIEF_S))
        return replace(problem, std=np.where(fixed, problem.std, left))
    windows = _looked_at(problem.windows())
    problem = replace(problem, window_s=_smooth_s(problem.model(windows), windows))
    windows, brief = map(_looked_at, (problem.windows(), problem.windows(seconds=BRIEF_S)))
    std = np.where(fixed, problem.std, _left(problem, brief))
    given = windows.commands, windows.lead, windows.held_s, windows.every
    times, error = problem.plant.timesteps(windows.guess, *given, windows.y, std)
    if times > 1:
        std = np.where(fixed, problem.std, _left(replace(problem, finer=times), brief))
    return replace(problem, finer=times, std=np.hypot(std, error))


def _looked_at(windows: Windows) -> Windows:
    """So many windows as are looked at."""
    return windows.evenly(math.ceil(LOOKED_AT_S / (windows.y.shape[2] * windows.dt)))


def _smooth_s(model: PlantModel, windows: Windows) -> float:
    """For how long most motions answer in proportion to changes of their starts [s], in bounds.

    Of an answer dm_control's walker has 0.8 out of proportion at once, gymnasium's half-cheetah
    0.17, an arm in free air 0.00.
    """
    X, theta = windows.guess.shape[1], np.zeros(model.nuisances)
    nudges = np.diag(start_nudges(X))
    moved = np.concatenate([np.zeros((1, X)), nudges, -nudges])[:, None] + windows.guess
    y = run(model, windows, np.tile(theta, (len(moved), 1)), moved) / windows.std[:, None]
    ups, downs = np.split(y[1:], 2)
    bent, straight = (
        np.cumsum(np.square(change).sum(axis=(0, 2)), axis=1)
        for change in (ups + downs - 2.0 * y[:1], ups - downs)
    )
    smooth = bent <= DATA.bent**2 * straight  # what runs away is NaN, and not smooth
    until = np.logical_and.accumulate(smooth, axis=1).sum(axis=1) * windows.dt
    return float(np.clip(np.median(until), DATA.shortest_s, DATA.window_s))


def _left(problem: GapProblem, windows: Windows) -> Float[np.ndarray, " X"]:
    """Std of what the nominal plant leaves of each state in brief windows, in its unit.

    It is at most the noise that the recordings alone seem to have.
    """
    model, x0 = problem.model(windows), windows.guess
    theta, readings = np.zeros(model.nuisances), int(windows.samples.sum())
    free = math.sqrt(readings / max(1, readings - x0.size))
    every = np.ma.masked_invalid(np.concatenate([one.states for one in problem.recordings]))
    least = np.minimum(DATA.least_noise * every.std(axis=0).filled(0.0), problem.std)
    for _ in range(ROUNDS):
        x0 = fit_initial_states(model, windows, theta, x0)
        r = residuals_at(model, windows, theta, x0).reshape(windows.y.shape)
        seen = windows.measured.any(axis=(0, 2))
        off = np.where(windows.measured, np.abs(r), np.nan)[:, seen]
        std = windows.std.copy()
        std[seen] *= free * np.nanmedian(off, axis=(0, 2)) / NORMAL
        windows = replace(windows, std=np.clip(std, least, problem.std))
    return windows.std
