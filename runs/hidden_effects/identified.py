"""The effects that `mujoco.sysid` names on the same recordings, with all freed that it can free.

All parameters of `freed.everything` are fitted at once: to short windows whose starts are read off
the smoothed recordings, for the toolbox fits none; each channel weighed by its noise. Two rules
make names of the numbers. The first takes the toolbox at its word: an effect is named where the
95 % interval of its parameter excludes the nominal value, and taking it away would make the sum of
squares larger by more than `PART`. Parameters that do the same to a motion have endless intervals,
so the second rule does what a careful user would: it freezes one parameter after another, the one
that is least sure first, and fits again those that are left.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from freed import ADVANCE, SENSOR, TIMESTEP, Freed, everything, nominal_model, spec_with
from jaxtyping import Float
from scipy.optimize import lsq_linear

from mcpilco.gap import DATA, GapProblem, Windows, usual_scales
from mcpilco.plant import Plant
from mcpilco.recordings import Recording, smoothed

FREED, FROZEN = "mujoco.sysid, all freed", "mujoco.sysid, frozen one by one"
"""names of the two rules"""
WINDOWS = 12
"""of about a second, spread over the recordings: more cost more than 30 s"""
ITERATIONS = 10
"""of the optimizer, at most"""
SETTLED = 1e-3
"""a fit has converged where an iteration makes the sum of squares smaller by no larger a part"""
PART = 0.1
"""by which the sum of squares must rise without an effect that is named, relative to what is left:
the toolbox's intervals take the starts for exact, and are too narrow"""


@dataclass(frozen=True)
class Named:
    """Effects by rule, and what is to be said of the fits."""

    terms: dict[str, list[tuple[str, str]]]
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Fit:
    """Parameters that were free, in their scales, with the residuals and their derivatives."""

    free: list[Freed]
    x: Float[np.ndarray, " K"]
    residuals: Float[np.ndarray, " n"]
    J: Float[np.ndarray, "n K"]
    converged: bool


def missing() -> str | None:
    """The package to install, where the toolbox is not there or, without its extra, is empty."""
    with contextlib.suppress(ImportError):  # MuJoCo before 3.5 has none
        from mujoco import sysid

        if hasattr(sysid, "optimize"):
            return None
    return "mujoco.sysid lacks its extra, so its rows are left out; pip install 'mujoco[sysid]'."


def identified(plant: Plant, recordings: Sequence[Recording]) -> Named:
    """The effects that each rule names."""
    try:
        return _identified(plant, recordings)
    except (ValueError, ArithmeticError, mujoco.FatalError, np.linalg.LinAlgError) as error:
        none: list[tuple[str, str]] = []
        return Named({FREED: none, FROZEN: none}, [f"no fit: {error}"])


def _identified(plant: Plant, recordings: Sequence[Recording]) -> Named:
    problem = GapProblem.of(plant, recordings, 0.01, (), {})
    windows = problem.windows()
    problem = _Problem(plant, recordings, windows)
    fit = problem.fit(everything(plant, usual_scales(plant, windows)))
    left = [fit.free[k] for k in kept(fit)]
    again = problem.fit(left) if left else None
    remarks = [
        f"{name}: not converged after {ITERATIONS} iterations"
        for name, each in ((FREED, fit), (FROZEN, again))
        if each and not each.converged
    ]
    second = _terms(again, sure(again)) if again else []
    return Named({FREED: _terms(fit, sure(fit)), FROZEN: second}, remarks)


def _terms(fit: Fit, chosen: Sequence[int]) -> list[tuple[str, str]]:
    return [fit.free[k].term for k in chosen]


# The rules ----------------------------------------------------------------------------------------


def sure(fit: Fit) -> list[int]:
    """Parameters whose interval excludes 0, and without which the residuals were larger."""
    outside = np.abs(fit.x) > _half_widths(fit.residuals, fit.J)
    rises = _rises(fit, list(range(len(fit.free))))
    return [k for k in range(len(fit.x)) if outside[k] and rises[k] > PART]


def kept(fit: Fit) -> list[int]:
    """Parameters that are left when the least needed is frozen at 0, until all are sure.

    What the others do instead is told by the linear model about the fit.
    """
    left = list(range(len(fit.free)))
    while left:
        x, residuals = _linear(fit, left)
        rises = _rises(fit, left)
        outside = np.abs(x) > _half_widths(residuals, fit.J[:, left])
        if outside.all() and rises.min() > PART:
            break
        left.pop(int(np.argmin(rises)))
    return left


def _half_widths(
    residuals: Float[np.ndarray, " n"], J: Float[np.ndarray, "n K"]
) -> Float[np.ndarray, " K"]:
    """Of the toolbox's 95 % intervals."""
    from mujoco import sysid

    with np.errstate(invalid="ignore", divide="ignore"):
        widths = sysid.calculate_intervals([residuals], J)[1]
    return np.where(np.isfinite(widths), widths, np.inf)


def _rises(fit: Fit, left: list[int]) -> Float[np.ndarray, " L"]:
    """By how much the sum of squares rises where each parameter alone is frozen too, relative."""
    before = np.sum(_linear(fit, left)[1] ** 2)
    after = [np.sum(_linear(fit, [m for m in left if m != k])[1] ** 2) for k in left]
    return np.array(after) / before - 1.0


def _linear(fit: Fit, left: list[int]) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, " n"]]:
    """Parameters within their bounds, and residuals r(z) = r + J (z - x), where others are 0."""
    goal = fit.J @ fit.x - fit.residuals
    if not left:
        return np.zeros(0), -goal
    Q, R = np.linalg.qr(fit.J[:, left])
    bounds = [fit.free[k].low for k in left], [fit.free[k].high for k in left]
    z = lsq_linear(R, Q.T @ goal, bounds, method="bvls").x
    return z, fit.J[:, left] @ z - goal


# The fit ------------------------------------------------------------------------------------------


class _Problem:
    """Windows of recordings as the toolbox wants them."""

    def __init__(self, plant: Plant, recordings: Sequence[Recording], windows: Windows) -> None:
        self._plant, self._nominal = plant, nominal_model(plant)
        measured = windows.measured.any(axis=(0, 2))
        self._channels = np.flatnonzero(measured)
        self._first = int(np.argmax(windows.measured.any(axis=(0, 1))))
        self._windows = _spread(windows, self._channels, self._first)
        self._apart = 1.0 + max(recording.time[-1] for recording in recordings)
        self._clock = np.concatenate([self._at(n, r.time) for n, r in enumerate(recordings)])
        self._smooth = np.concatenate([smoothed(recording)[0] for recording in recordings])
        begins = zip(self._windows.recording, self._windows.start_s, strict=True)
        self._begins = [self._at(recording, start) for recording, start in begins]

    def _at(self, recording: int, time: Any) -> Any:
        """A time in a recording on one clock for all, by which a simulation knows its window."""
        return self._apart * recording + time

    def fit(self, free: list[Freed]) -> Fit:
        """Least squares over the parameters that are free."""
        from mujoco import sysid

        parameters = sysid.ParameterDict()
        for f in free:
            parameters.add(sysid.Parameter(f.name, f.start, f.low, f.high))
        residual = sysid.build_residual_fn(
            models_sequences=[self._sequences()],
            build_model=_Builder(self._nominal, self._plant, free),
            modify_residual=self._compare(free),
            custom_rollout=self._roll_out(free),
            n_threads=1,
            resample_true=False,
        )
        with contextlib.redirect_stdout(io.StringIO()):  # it records only what it prints, too
            _, found = sysid.optimize(
                parameters, residual, max_iters=ITERATIONS, xtol=SETTLED, x_scale="jac"
            )
        costs = found.extras["objective"]
        x = np.asarray(found.x).ravel()
        left = np.concatenate([np.ravel(part) for part in residual(x, parameters)[0]])
        settled = len(costs) > 1 and costs[-2] - costs[-1] <= SETTLED * costs[-1]
        return Fit(free, x, left, np.asarray(found.jac), settled)

    def _sequences(self) -> Any:
        """The windows: starts, commands and what was measured."""
        from mujoco import sysid

        spec, w = spec_with(self._nominal, self._plant, []), self._windows
        model, T = spec.compile(), w.y.shape[2]
        signals = sysid.TimeSeries.compute_all_sensor_mapping(model)
        # a sensor's delay moves the last sample that is simulated
        steps = round(((T - 1) * w.dt + DATA.latency_s) / TIMESTEP) + 2
        x0, controls, measured = [], [], []
        for n, begin in enumerate(self._begins):
            times = begin + TIMESTEP * np.arange(steps)
            x0.append(self._start(model, n))
            controls.append(sysid.TimeSeries(times, self._commands(n, times)))
            times = begin + w.dt * np.arange(self._first, T)
            rows = np.nan_to_num(w.y[n][:, self._first :].T)
            measured.append(sysid.TimeSeries(times, rows, signals))
        names = [str(n) for n in range(len(w))]
        return sysid.ModelSequences("windows", spec, names, x0, controls, measured)

    def _commands(self, n: int, times: Float[np.ndarray, " S"]) -> Float[np.ndarray, "S U"]:
        """The commands, so early that the least delay and lag bring it in time."""
        w = self._windows
        since = times - self._begins[n] + ADVANCE * TIMESTEP
        rows = w.lead + np.floor(since / w.dt + 1e-6).astype(int)
        return w.commands[n][np.clip(rows, 0, w.commands.shape[1] - 1)]

    def _start(self, model: mujoco.MjModel, n: int) -> Float[np.ndarray, " S"]:
        """Time, positions and velocities, and what the motors remember."""
        data, begin = mujoco.MjData(model), self._begins[n]
        data.time = begin
        data.qpos[:], data.qvel[:] = self._states(begin, {})
        data.act[:] = self._windows.commands[n][self._windows.lead]
        for u in range(model.nu):
            samples = int(model.actuator_history[u, 0])
            times = begin - TIMESTEP * np.arange(samples, 0, -1.0)
            values = np.ascontiguousarray(self._commands(n, times)[:, [u]])
            mujoco.mj_initCtrlHistory(model, data, u, times, values)
        kind = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
        start = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, start, kind)
        return start

    def _states(
        self, begin: float, known: Mapping[tuple[str, str], float]
    ) -> tuple[Float[np.ndarray, " J"], Float[np.ndarray, " J"]]:
        """Positions and velocities at which a window starts, if its sensors are as known."""
        positions, velocities = [], []
        for x, name in enumerate(self._plant.layout.states[0::2]):
            delay = known.get(("sensor_delay", name), 0.0)
            offset = known.get(("sensor_offset", name), 0.0)
            factor = known.get(("sensor_scale", name), 1.0)
            q = np.interp(begin + delay, self._clock, self._smooth[:, 2 * x])
            positions.append((q - offset) / factor)
            own = 2 * x + 1 in self._channels  # a sensor of its own, which is right
            v = np.interp(begin + (0.0 if own else delay), self._clock, self._smooth[:, 2 * x + 1])
            velocities.append(v if own else v / factor)
        return np.array(positions), np.array(velocities)

    def _roll_out(self, free: list[Freed]) -> Callable[..., Any]:
        """The toolbox's simulation, from starts that agree with the parameters of the sensors."""
        from mujoco import sysid

        J = len(self._plant.layout.joints)

        def roll_out(initial_states: Any, param_dicts: Any, **others: Any) -> Any:
            x0 = []
            for state, parameters in zip(initial_states, param_dicts, strict=True):
                start = np.array(state)
                start[1 : 1 + 2 * J] = np.concatenate(
                    self._states(start[0], _sensors(free, parameters.as_vector()))
                )
                x0.append(start)
            return sysid.sysid_rollout(initial_states=x0, **others)

        return roll_out

    def _compare(self, free: list[Freed]) -> Callable[..., Any]:
        """Simulated readings less measured ones, in the noise of each."""
        from mujoco import sysid

        states, std = self._plant.layout.states, self._windows.std

        def compare(
            params: Any, predicted: Any, measured: Any, model: Any, all_of_it: bool, *, state: Any
        ) -> Any:
            known, J = _sensors(free, params.as_vector()), len(states) // 2
            rows = np.zeros_like(measured.data)
            for k in self._channels:
                name, column = states[k], state[:, 1 + k // 2 + J * (k % 2)]
                late = measured.times - known.get(("sensor_delay", name), 0.0)
                y = np.interp(late, state[:, 0], column)
                y = known.get(("sensor_scale", name), 1.0) * y
                rows[:, k] = y + known.get(("sensor_offset", name), 0.0)
            residual = ((measured.data - rows) / std)[:, self._channels]
            told = sysid.TimeSeries(measured.times, rows, measured.signal_mapping)
            return residual, told, measured

        return compare


class _Builder:
    """Models of parameters; each is asked for once for every window, and compiled once."""

    def __init__(self, nominal: mujoco.MjSpec, plant: Plant, free: list[Freed]) -> None:
        self._nominal, self._plant, self._free = nominal, plant, free
        self._known: dict[bytes, mujoco.MjModel] = {}

    def __call__(self, parameters: Any, spec: mujoco.MjSpec) -> mujoco.MjModel:
        x = parameters.as_vector()
        if x.tobytes() not in self._known:
            pairs = list(zip(self._free, x.tolist(), strict=True))
            if len(self._known) > 2 * len(x) + 2:
                self._known.clear()
            self._known[x.tobytes()] = spec_with(self._nominal, self._plant, pairs).compile()
        return self._known[x.tobytes()]


def _sensors(free: list[Freed], x: Float[np.ndarray, " K"]) -> dict[tuple[str, str], float]:
    """Parameters of the sensors, in their units."""
    pairs = zip(free, x.tolist(), strict=True)
    return {f.term: f.value(number) for f, number in pairs if f.effect in SENSOR}


def _spread(windows: Windows, channels: Sequence[int], first: int) -> Windows:
    """Some of the windows in which nothing is masked."""
    whole = np.flatnonzero(windows.measured[:, channels, first:].all(axis=(1, 2)))
    if not len(whole):
        raise ValueError("no window of a second without a masked value")
    count = min(WINDOWS, len(whole))
    return windows[whole[np.linspace(0, len(whole) - 1, count).round().astype(int)]]
