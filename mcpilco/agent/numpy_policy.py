"""Acts from an exported policy with numpy alone.

This file imports nothing of mcpilco: copy it beside `policy.npz` to the machine that acts.

    policy = NumpyPolicy("policy.npz")
    policy.reset()                        # an episode begins
    inputs = policy(measured)             # in each step

`mcpilco.agent.policy_file.write_policy` says what the arrays are.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
OF_TWO = (np.add, np.subtract, np.multiply, np.divide, np.minimum, np.maximum)
OF_ONE = (np.sin, np.cos, np.tanh, np.exp, np.sqrt, np.abs)
"""operations of a program by their numbers, those of one number behind those of two"""
STAGES = "regulator", "brake"
"""programs that may stand behind a policy, in order"""


class NumpyPolicy:
    """An exported policy, with the estimator that it needs, for one episode at a time."""

    def __init__(self, source: str | Path | Mapping[str, Array]) -> None:
        """The policy of a file, or of what is in one, by name."""
        arrays = dict(source if isinstance(source, Mapping) else _read(source))
        self._policy = arrays
        self._linear = _LinearEstimator(arrays) if "estimator.A" in arrays else None
        self._late = _LateActuator(arrays) if "delay.whole" in arrays else None
        self._count = int(arrays.get("past_inputs", 0)) * len(arrays["middle"])
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._past = np.zeros(self._count)
        for estimator in (self._linear, self._late):
            if estimator is not None:
                estimator.reset()

    def __call__(self, measured: Array) -> Array:
        """The inputs (U,) of this step, in their units, from what is measured now."""
        x = np.asarray(measured, dtype=np.float64)
        if self._linear is not None:
            x = self._linear(x)
        if self._late is not None:
            x = self._late.observe(x)
        u = self._act(np.concatenate([x, self._past]))
        self._past = np.concatenate([u, self._past])[: self._count]
        if self._late is not None:
            self._late.after(u)
        return u

    def expected(self) -> Array | None:
        """The state (X,) at the next measurement; None where there is no model to tell it."""
        return None if self._late is None else self._late.expected()

    def _act(self, x: Array) -> Array:
        p = self._policy
        z = augmented(x, p["angles"])
        phi = np.exp(-np.square((z - p["centres"]) / p["lengthscales"]).sum(-1))
        u = p["middle"] + p["half_range"] * np.tanh(phi @ p["weights"] / p["squash"])
        for stage in STAGES:
            u = self._behind(stage, x, u) if f"{stage}.outputs" in p else u
        return u

    def _behind(self, stage: str, x: Array, u: Array) -> Array:
        """The program's results: registers are state, command, constants, and those operations."""
        names = ("constants", "outputs", "operations", "first", "second")
        constants, outputs, *rows = (self._policy[f"{stage}.{name}"] for name in names)
        r = [*x, *u, *constants]
        for operation, a, b in zip(*rows, strict=True):
            one = operation - len(OF_TWO)
            r.append(OF_ONE[one](r[a]) if one >= 0 else OF_TWO[operation](r[a], r[b]))
        return np.array([r[i] for i in outputs])


def _read(path: str | Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def augmented(states: Array, angles: Array) -> Array:
    """z = [components that are no angle, cosines, sines] of states (..., X)."""
    plain = np.delete(states, angles, -1)
    return np.concatenate([plain, np.cos(states[..., angles]), np.sin(states[..., angles])], -1)


class _LinearEstimator:
    """x^ = x- + K (y - C x-), the next x- = A x^."""

    def __init__(self, arrays: dict[str, Array]) -> None:
        self._A, self._C, self._gains, self._start = (
            arrays[f"estimator.{name}"] for name in ("A", "C", "gains", "start")
        )

    def reset(self) -> None:
        self._expected, self._step = self._start, 0

    def __call__(self, measured: Array) -> Array:
        K = self._gains[min(self._step, len(self._gains) - 1)]
        estimate = self._expected + K @ (measured - self._C @ self._expected)
        self._expected, self._step = self._A @ estimate, self._step + 1
        return estimate


class _Model:
    """The mean and variance of the changes in a step, which learns further steps."""

    def __init__(self, arrays: dict[str, Array]) -> None:
        self._n = {k.removeprefix("model."): v for k, v in arrays.items() if k.startswith("model.")}
        self._at = self._terms_of(self._n["X"])

    def _terms_of(self, X: Array) -> Array:
        return np.concatenate([X, X @ self._n["W"]], -1)

    def _kernel(self, e: int, first: Array, second: Array) -> Array:
        """sum_k v exp(-|x - x'|^2_w / 2) prod_f (c + <x, x'>_s) of regressors (N, D), (M, D)."""
        n, ends, total = self._n, self._n["ends"], 0.0
        for k, (v, w) in enumerate(zip(n["v"][e], n["w"][e], strict=True)):
            apart = np.square(first[:, None] - second[None]) @ w
            term = v * np.exp(-0.5 * apart)
            for f in range(ends[k], ends[k + 1]):
                term = term * (n["c"][e, f] + (first * n["s"][e, f]) @ second.T)
            total = total + term
        return np.asarray(total)

    def learn(self, X: Array, Y: Array) -> None:
        """Condition on further steps, regressors (T, D) and changes (T, E), in place of others."""
        n, self._further = self._n, []
        new = self._terms_of(X)
        for e, noise in enumerate(n["noise_std"]):
            K = self._kernel(e, self._at, new)
            V = n["L_inv"][e] @ K
            prior = self._kernel(e, new, new)
            S = prior - V.T @ V + np.diag(noise**2 + 1e-10 * np.diag(prior))
            left = Y[:, e] - n["alpha"][e] @ K
            try:
                np.linalg.cholesky(S)
                weights = np.linalg.solve(S, left)
            except np.linalg.LinAlgError:
                weights = np.zeros_like(left)
            self._further.append((new, V, weights))

    def mean(self, X: Array) -> Array:
        """Expected changes (M, E) at regressors (M, D)."""
        n, at, means = self._n, self._terms_of(X), []
        for e, (new, V, weights) in enumerate(self._further):
            Kq = self._kernel(e, self._at, at)
            mean = n["alpha"][e] @ Kq
            if len(new):
                mean = mean + weights @ (self._kernel(e, new, at) - V.T @ (n["L_inv"][e] @ Kq))
            means.append(mean)
        return np.stack(means, -1)

    def variance(self, x: Array) -> Array:
        """Variances (E,) of the changes at a regressor (D,), by the data before the episode."""
        n, at, found = self._n, self._terms_of(x[None]), []
        for e, noise in enumerate(n["noise_std"]):
            white = n["L_inv"][e] @ self._kernel(e, self._at, at)[:, 0]
            found.append(max(self._kernel(e, at, at)[0, 0] - white @ white, 1e-9 * noise**2))
        return np.array(found)


class _LateActuator:
    """An extended Kalman filter for the state now, and the prediction of where a command acts.

    See `mcpilco.sensing.delay`.
    """

    def __init__(self, arrays: dict[str, Array]) -> None:
        self._whole, self._part = int(arrays["delay.whole"]), float(arrays["delay.part"])
        self._noise, self._recent = arrays["delay.noise_std"], int(arrays["delay.recent"])
        self._angles, self._U = arrays["angles"], len(arrays["middle"])
        self._A, self._B, self._C, self._predicted, self._bounds = (
            arrays[f"motion.{name}"] for name in ("A", "B", "C", "predicted", "bounds")
        )
        self._integrated = self._B.copy()
        self._integrated[self._predicted] = 0.0
        self._model, self._width = _Model(arrays), arrays["model.X"].shape[1]

    def reset(self) -> None:
        memory = self._whole + (self._part > 0)
        self._past = np.zeros((memory + 1, self._U))
        self._state: Array | None = None
        self._X, self._Y = np.zeros((0, self._width)), np.zeros((0, len(self._predicted)))
        self._model.learn(self._X, self._Y)

    def after(self, inputs: Array) -> None:
        """Note a command."""
        self._past = np.concatenate([inputs[None], self._past])[: len(self._past)]

    def expected(self) -> Array:
        """The state at the end of the step whose command was noted."""
        assert self._state is not None
        return self._stepped(self._state[None], self._past[self._whole :])[0]

    def observe(self, measured: Array) -> Array:
        """The state in which the next command will act, from what is measured now."""
        R = np.diag(self._noise**2)
        if self._state is None:
            self._state, self._P = measured, R
        else:
            before, asked = self._state, self._asked(self._state[None], *self._acting())[0]
            self._state, self._P = self._corrected(measured, R)
            self._X = np.concatenate([self._X, asked[None]])[-self._recent :]
            change = (measured - before)[self._predicted]
            self._Y = np.concatenate([self._Y, change[None]])[-self._recent :]
            self._model.learn(self._X, self._Y)
        states = self._state[None]
        for ahead in range(self._whole):
            states = self._stepped(states, self._past[:-1][self._whole - 1 - ahead :])
        return (states if self._part == 0 else self._begun(states, self._past[0]))[0]

    def _acting(self) -> tuple[Array, Array]:
        """The mean command that acts in the step that ends now, and its change in it."""
        new = self._past[self._whole]
        if self._part == 0:
            return new, np.zeros_like(new)
        old = self._past[self._whole + 1]
        return (1 - self._part) * new + self._part * old, new - old

    def _corrected(self, measured: Array, R: Array) -> tuple[Array, Array]:
        """The filter's estimate and covariance; the measurement where it has no finite answer."""
        assert self._state is not None
        steps = np.concatenate([np.zeros((1, len(R))), np.diag(self._noise)])
        moved = self._stepped(self._state + steps, self._past[self._whole :])
        expected, F = moved[0], ((moved[1:] - moved[0]) / self._noise[:, None]).T
        acting, turned = self._acting()
        variance = self._model.variance(self._asked(self._state[None], acting, turned)[0])
        both = self._change(np.stack([self._state, expected]), acting)
        left_out = (both[0] - both[1]) / 6 @ self._integrated.T
        Q = self._B @ np.diag(variance) @ self._B.T + np.diag(left_out**2)
        P = F @ self._P @ F.T + Q
        K = np.linalg.solve(P + R, P).T
        rest = np.eye(len(R)) - K
        P, state = rest @ P @ rest.T + K @ R @ K.T, expected + K @ (measured - expected)
        finite = bool(np.isfinite(state).all() and np.isfinite(P).all())
        return (state, P) if finite else (measured, R)

    def _asked(self, states: Array, inputs: Array, turned: Array | None = None) -> Array:
        """Regressors [z, u, change of u where the delay has a part] of states (N, X)."""
        each = np.broadcast_to(inputs, (len(states), self._U))
        parts = [augmented(states, self._angles), each]
        if self._part > 0:
            parts.append(np.zeros_like(each) if turned is None else np.zeros_like(each) + turned)
        return np.concatenate(parts, -1)

    def _change(self, states: Array, inputs: Array, turned: Array | None = None) -> Array:
        return self._model.mean(self._asked(states, inputs, turned))

    def _moved(self, states: Array, drift: Array, delta: Array) -> Array:
        """drift + B delta; a state stays rather than leave its bounds."""
        following = drift + delta @ self._B.T
        inside = (np.abs(following[:, self._predicted]) <= self._bounds).all(-1, keepdims=True)
        return np.where(inside, following, states)

    def _advance(self, states: Array, inputs: Array, delta: Array) -> Array:
        return self._moved(states, states @ self._A.T + self._C @ inputs, delta)

    def _stepped(self, states: Array, acting: Array) -> Array:
        """After a step, of the commands that act in it, newest first."""
        if self._part == 0:
            return self._advance(states, acting[0], self._change(states, acting[0]))
        p, new, old = self._part, acting[0], acting[1]
        delta = self._change(states, (1 - p) * new + p * old, new - old)
        sooner = self._change(states, old) - self._change(states, new)
        return self._advance(states, new, delta) + p * (1 - p) * sooner @ self._integrated.T

    def _begun(self, states: Array, inputs: Array) -> Array:
        """After the delay's part of a step in which a command is held."""
        p = self._part
        held = self._advance(states, inputs, self._change(states, inputs))
        delta = self._change(states - (1 - p) / 2 * (held - states), inputs)
        drift = states + p * states @ (self._A - np.eye(states.shape[1])).T
        return self._moved(states, drift + (p * p - p) * delta @ self._integrated.T, p * delta)
