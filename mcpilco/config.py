"""The numbers of a run: what is chosen once, written as JSON and found again in every run folder.

Nothing here imports torch, so that the command line can answer `--help` at once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from mcpilco.typing import InputError

TURN_OVER = 2e-3
"""velocity v_r over which the dry friction of a simulated joint turns over, as tanh(v / v_r) [m/s
or rad/s]: a joint at rest creeps no faster, and steps with error control can follow it"""
FITTED_TURN_OVER = 0.02
"""v_r of regressors that are fitted to measured motions [m/s or rad/s]: about the noise of a
velocity, below which its sign is not known"""
SMOOTH_TURN_OVER = 0.05
"""v_r of features of a model [m/s or rad/s]: a policy's gradient passes through them in steps of
dt, which must not leap over rest"""


Number = TypeVar("Number", int, float)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise InputError(message)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of an annotated type; numbers must be finite."""
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if get_origin(hint) in (Union, UnionType):
        return any(_fits(value, kind) for kind in get_args(hint))
    if get_origin(hint) is tuple:
        return isinstance(value, tuple) and all(_fits(v, get_args(hint)[0]) for v in value)
    if hint in (int, float):
        number = isinstance(value, int) or (hint is float and isinstance(value, float))
        return number and not isinstance(value, bool) and math.isfinite(value)
    return hint is Any or isinstance(value, get_origin(hint) or hint)


class Checked:
    """A configuration; raises InputError where an entry is not of its annotated type."""

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self)).items():
            value, kind = getattr(self, name), getattr(hint, "__name__", hint)
            expected = str(hint if get_args(hint) else kind).replace("typing.", "")
            endless = isinstance(value, float) and not math.isfinite(value)
            expected += " and finite" if endless else ""
            _require(
                _fits(value, hint),
                f"{type(self).__name__}.{name} must be of type {expected}, got {value!r}.",
            )

    def _at_least(self, **limits: float) -> None:
        for name, least in limits.items():
            value = getattr(self, name)
            known = value is None or value >= least
            _require(known, f"{name} must be at least {least}, got {value}.")

    def _at_most(self, **limits: float) -> None:
        for name, most in limits.items():
            value = getattr(self, name)
            _require(value <= most, f"{name} must be at most {most}, got {value}.")

    def _above(self, name: str, least: float) -> None:
        value = getattr(self, name)
        _require(value > least, f"{name} must exceed {least:g}, got {value}.")

    def _positive(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            known = value is None or isinstance(value, str)
            _require(known or value > 0, f"{name} must be positive, got {value}.")


LINEAR_PARTS = ("features", "friction")
"""parts of a kernel that are linear in features of their own"""
LAGGED_PARTS = ("sed-mpk", "sed-fir")
"""parts of a kernel that see present and past inputs as what a filter answers"""
FORCE_PART = "gip"
"""the part that is a force in the plant's equations, and none of the GPs' kernel"""
KERNELS = ("rbf", "mpk", *LAGGED_PARTS, *LINEAR_PARTS, FORCE_PART)
"""parts that the kernel of a model is a sum of"""


@dataclass(frozen=True)
class ModelConfig(Checked):
    """How the dynamics are learned."""

    kernel: str = "rbf+mpk"
    """kernel of each GP, a sum of parts: rbf, mpk; of the present and past inputs sed-mpk, a
    Volterra series, and sed-fir, a filter that depends on the state; and linear ones of `features`,
    what the plant's equations say, and `friction`, functions of the velocities; with `gip` the
    plant's equations get the forces that they lack, polynomials of the motion"""
    degree: int = 2
    """degree of the polynomials of mpk and sed-mpk"""
    mean: Literal["zero", "physics"] = "zero"
    """of the GPs; physics: the plant's equations, whose parameters are learned"""
    plant: dict | None = None
    """the plant that physics and features are of, as a file of `mcpilco.plant.correction` says it:
    name, parameters, effects; None: the one with the task's states and inputs, as it is"""
    uncertainty: float | Literal["told"] = 0.2
    """prior standard deviation of the logarithms of the plant's uncertain parameters [-]; told:
    their joint distribution is the part `spread` of `plant`, of its likeliest member"""
    spread: dict | list | None = None
    """plants that particles draw from, so that the policy holds for them: relative standard
    deviations by name, such as {"mass": 0.1, "f_c": 0.3}, or the part `spread` of
    `corrected.json`; None: the plant alone"""
    plant_step: float = 0.025
    """longest Runge-Kutta step of the plant's equations [s]"""
    memory: int = 0
    """how many past inputs the state holds, for actuators that lag"""
    delay: float = 0.0
    """how late the actuator answers [s]: policies act on the state predicted for then"""
    friction_gate: float = SMOOTH_TURN_OVER
    """velocity over which the friction features turn over [m/s or rad/s]"""
    integration: Literal["speed", "full"] = "speed"
    """speed: GPs for the velocities, positions integrated (thesis eq. 5.9); full: for all states"""
    optimiser: Literal["lbfgs", "adam"] = "lbfgs"
    """maximiser of the marginal likelihood"""
    prior_std: float | None = 2.0
    """standard deviation of the prior of the logarithm of each hyperparameter, about where its fit
    starts [-]: of a few samples the likeliest values alone are too sure. None: there is no prior;
    nor is there where physics is the mean, which may leave nothing to learn"""
    noise_floor: float = 0.01
    """smallest noise standard deviation a GP may learn, in its target's unit"""
    subset_threshold: float | None = None
    """a sample is kept if its posterior std given the kept ones exceeds this many noise std [-];
    None keeps all"""
    inducing: int = 300
    """with more than twice as many samples as this the GPs' hyperparameters are learned from twice
    as many, evenly spaced, and the GPs know all samples through at most so many inducing points"""
    mirror: int = 90
    """with at most so many samples the GPs learn from each one's mirror image too, in which states,
    inputs and changes have the other sign, where the marginal likelihood of the samples says that
    the system obeys the same laws in a mirror; 0 never asks"""
    plausible: float = 5.0
    """a particle stops where it would leave this multiple of the largest magnitude recorded [-]"""
    sampling: Literal["step", "path"] = "step"
    """step: a particle's changes are drawn anew in each step; path: each particle has functions of
    its own, drawn beforehand, and rolls out in plain torch"""
    path_features: int = 256
    """random Fourier features of a path, cosines and sines, for each exponential factor of the
    kernel; the error of its covariance falls with their root"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(degree=1, path_features=2, memory=0, delay=0, inducing=1)
        self._at_least(subset_threshold=0, mirror=0)
        self._at_most(degree=20, path_features=100_000, memory=100)
        told = self.uncertainty == "told"
        _require(
            bool((self.plant or {}).get("spread")) if told else 0 <= float(self.uncertainty) <= 3,
            'uncertainty must be from 0 to 3, or "told" where the plant has a spread, got '
            f"{self.uncertainty!r}.",
        )
        self._positive("plant_step", "friction_gate")
        parts = self.kernel.split("+")
        _require(
            set(parts) <= set(KERNELS) and len(set(parts)) == len(parts),
            f"kernel must be a sum of different parts out of {', '.join(KERNELS)}, such as "
            f"rbf+mpk, got {self.kernel!r}.",
        )
        _require(
            FORCE_PART not in parts or (self.mean == "physics" and len(parts) > 1),
            "gip is what a plant's equations lack, and another part learns the rest; choose mean "
            f"physics and a kernel such as gip+rbf, got {self.mean} and {self.kernel}.",
        )
        _require(
            self.sampling == "step" or (self.mean == "zero" and not {*parts} & {*LINEAR_PARTS}),
            "sampling path knows no physics and no features; choose sampling step.",
        )
        lagged = [part for part in parts if part in LAGGED_PARTS]
        _require(
            not lagged or (self.memory > 0 and self.sampling == "step"),
            f"{'+'.join(lagged)} is of past inputs: choose a memory of at least 1 and sampling "
            f"step, got memory {self.memory} and sampling {self.sampling}.",
        )
        _require(
            self.spread is None or self.mean == "physics",
            "spread is of the plant's equations: choose the mean physics (on the command line "
            f"--model physics+rbf), got {self.mean}.",
        )
        late = self.delay > 0
        _require(
            not late or (self.mean == "zero" and "features" not in parts),
            "delay is of models that know no plant; give a plant the effect actuator_delay.",
        )
        _require(
            not late or (self.memory == 0 and self.sampling == "step"),
            f"delay goes with memory 0 and sampling step, got memory {self.memory} and sampling "
            f"{self.sampling}.",
        )
        _require(
            self.path_features % 2 == 0,
            f"path_features must be even, as many cosines as sines, got {self.path_features}.",
        )
        self._positive("noise_floor", "prior_std")
        self._above("plausible", 1)


REGULATOR_ROOM = 2.0
"""`PolicyConfig.regulator` where it is only asked for, as by --regulator [-]: what was chosen for
the pendubot of runs/pendubot_swingup"""


@dataclass(frozen=True)
class PolicyConfig(Checked):
    """The policy `mcpilco.policies.policies.SumOfGaussians`, and its random start."""

    bases: int = 100
    """number of Gaussians"""
    span: float | Literal["rms", "data"] = "rms"
    """centres of the components that are no angle start uniform in +-span, in their units;
    rms: their root mean square in the recordings; data: the largest magnitude recorded"""
    lengthscale: float | Literal["span"] = "span"
    """starting lengthscale of those components, in their units; span: the same as their span"""
    angle_lengthscale: float = 1.0
    """starting lengthscale of the cosines and sines [-]"""
    weight: float = 10.0
    """weights start uniform in +-weight [-]"""
    squash: float = 10.0
    """the argument of the tanh is divided by this number [-]"""
    regulator: float = 0.0
    """a linear regulator takes over near the task's goal, `mcpilco.policies.regulator`: in its
    region it may ask for so many times the largest input, at which it is cut off [-]; 0: none"""
    regulator_units: tuple[float, ...] = ()
    """error of each state that costs the regulator as much as the largest input, in the state's
    unit; none: 1 each"""
    regulator_trust: float = 0.9
    """of the systems that the model leaves possible, the share that the regulator must hold to act
    [-]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(bases=1, regulator=0, regulator_trust=0)
        self._at_most(bases=100_000, regulator_trust=1)
        _require(
            all(unit > 0 for unit in self.regulator_units),
            f"regulator_units must be positive, got {self.regulator_units}.",
        )
        self._positive("span", "lengthscale", "angle_lengthscale", "weight", "squash")


@dataclass(frozen=True)
class Phase(Checked):
    """A stretch of the search with one learning rate and one dropout rate."""

    learning_rate: float
    """Adam's step size [-]"""
    dropout: float = 0.0
    """probability that a basis is left out [-]"""
    until: float = 1.0
    """fixed schedule: the share of all steps at which the phase ends [-]"""
    drift: float = 0.0
    """monitored schedule: the phase ends when the cost's standardised drift stays below it [-]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._positive("learning_rate")
        _require(0 <= self.dropout < 1, f"dropout must be in [0, 1), got {self.dropout}.")


@dataclass(frozen=True)
class Limit(Checked):
    """Bounds within which a state must stay while the agent learns."""

    state: str
    """its name in the task"""
    low: float | None = None
    """in its unit; None: it has none"""
    high: float | None = None
    """likewise"""

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = [end for end in (self.low, self.high) if end is not None]
        _require(
            bool(ends) and ends[0] < (ends[-1] if len(ends) == 2 else math.inf),
            f"A limit of {self.state} needs a bound, and low below high, got {self.low} to "
            f"{self.high}.",
        )


@dataclass(frozen=True)
class SearchConfig(Checked):
    """How the policy is improved in the model."""

    particles: int = 64
    """P of each rollout"""
    steps: tuple[int, ...] = (400,)
    """most optimisation steps of a start in trial 1, 2, ...; the last entry holds from there on"""
    rates: tuple[float, ...] = (1.0,)
    """factor of the learning rates in trial 1, 2, ...; the last entry holds from there on [-]"""
    phases: tuple[Phase, ...] = (Phase(0.03, until=0.5), Phase(0.015, until=0.75), Phase(0.0075))
    """learning and dropout rates, in order"""
    monitored: bool = False
    """end a phase when the cost no longer drifts, instead of at a fixed share of the steps"""
    widening: float = 3.0
    """the cost's lengthscales start this many times as large and shrink to their own over the
    first half of the steps, so that a distant goal is felt [-]"""
    clip_norm: float | None = 1.0
    """the gradient is scaled down to this norm; None leaves it"""
    warm_start: bool = True
    """begin with the last trial's policy, where there is one"""
    polish: bool = True
    """the policy that a search begins with is a candidate too; where the model predicts no failure
    of it, its improvement enters the schedule half-way: at lower rates and the cost's own width"""
    restarts: tuple[int, ...] = (1, 3)
    """further starts from random policies in trial 1, 2, ..., tried while the model predicts
    failure; the last entry holds from there on"""
    screening: float = 0.5
    """a further start is given up at this share of its steps if it costs more there than half of
    those before it did; 1 gives none up [-]"""
    failing: float = 0.02
    """the model predicts failure while the mean cost over the last third of the horizon exceeds
    this share of the mean cost of the first rollout [-]"""
    continuation: int = 0
    """most steps of the way from an easier model to the model itself, on which a policy is
    followed: from a plant without its effects, where physics is the mean; 0 goes no way"""
    evaluation_particles: int = 384
    """particles that judge a start, without dropout"""
    correlations: tuple[float, ...] = (0.0, 0.0, 0.5, 0.8)
    """correlation of a particle's noise in successive steps in trial 1, 2, ...; the last entry
    holds from there on; with 0 the model errs anew in each step [-]"""
    limits: tuple[Limit, ...] = ()
    """of states, which a brake holds, or else a policy must be predicted to keep"""
    kept: float = 0.99
    """share of the particles that must keep all limits at every step where no brake does [-]"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(particles=1, evaluation_particles=2, widening=1, continuation=0)
        self._at_most(particles=1_000_000, evaluation_particles=1_000_000)
        _require(0 < self.kept < 1, f"kept must be in (0, 1), got {self.kept}.")
        _require(0 < self.screening <= 1, f"screening must be in (0, 1], got {self.screening}.")
        self._positive("clip_norm")
        for name in ("steps", "rates", "phases", "restarts", "correlations"):
            _require(bool(getattr(self, name)), f"{name} must have at least one entry.")
        _require(min(self.restarts) >= 0, f"restarts must not be negative, got {self.restarts}.")
        _require(min(self.steps) >= 1, f"steps must all be at least 1, got {self.steps}.")
        _require(min(self.rates) > 0, f"rates must all be positive, got {self.rates}.")
        _require(
            all(0 <= correlation < 1 for correlation in self.correlations),
            f"correlations must all be in [0, 1), got {self.correlations}.",
        )

    def steps_of(self, trial: int) -> int:
        """Most steps of one start in trial 1, 2, ..."""
        return _of_trial(self.steps, trial)

    def rate_of(self, trial: int) -> float:
        """Factor of the learning rates in trial 1, 2, ..."""
        return _of_trial(self.rates, trial)

    def correlation_of(self, trial: int) -> float:
        """Correlation of a particle's noise in successive steps in trial 1, 2, ... [-].

        With limits the last entry holds from the first trial on: a model that errs anew in each
        step is too sure of where it goes.
        """
        return self.correlations[-1] if self.limits else _of_trial(self.correlations, trial)

    def starts_of(self, trial: int) -> int:
        """Most starts in trial 1, 2, ..."""
        return 1 + _of_trial(self.restarts, trial)


def _of_trial(entries: tuple[Number, ...], trial: int) -> Number:
    """The entry of trial 1, 2, ...; the last one holds from there on."""
    return entries[min(trial, len(entries)) - 1]


@dataclass(frozen=True)
class EstimatorConfig(Checked):
    """How the state is estimated where a task measures a part of it; else of no effect."""

    kind: Literal["kalman", "differences"] = "kalman"
    """kalman: a Kalman filter; differences: of successive positions, filtered"""
    low_pass: float = 0.0
    """differences: share of the last estimate of a velocity that the next one keeps [-]"""
    modelled: bool = True
    """the particles are measured, with noise, and estimated as the system is; else the policy is
    searched as if it saw their states"""
    refinements: int = 1
    """times in a trial that recordings are smoothed anew by the model that was learned from them,
    and the model is fitted anew: the first smoother knows of no forces. Not where it has memory"""

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self.refinements >= 0, f"refinements must be >= 0, got {self.refinements}.")
        _require(0 <= self.low_pass < 1, f"low_pass must be in [0, 1), got {self.low_pass}.")


LONGEST = 100_000
"""most steps of an episode: 28 hours at 1 s a step, and some GB of particles"""


@dataclass(frozen=True)
class Config(Checked):
    """Everything an agent is told; the defaults are what learns best in the thesis's setting."""

    model: ModelConfig = field(default_factory=ModelConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    horizon: int | None = None
    """steps of one episode; None takes the env's time limit"""
    exploration: int | None = None
    """steps before the first trial, in rollouts of at most the horizon; None: one
    horizon. Where rollouts end early there are as many as it takes"""
    excitation: Literal["planned", "random"] = "planned"
    """inputs before the first trial. planned: from what they have shown so far, towards where
    little is known and the cost is low; random: uniform within the bounds, and so they are where
    the cost is learned or cannot be made wider, states are measured in part, an actuator is late,
    steps are shorter than 0.04 s, or there are limits"""
    engine: Literal["fused", "eager"] = "fused"
    """how particles are rolled out: compiled loops, or plain torch with the same result;
    where numba is missing, torch takes the place of the loops"""
    precision: Literal["float64", "float32"] = "float32"
    """of the compiled rollouts; factorisations, costs and parameters have float64 always, and so
    has plain torch"""

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(
            self.horizon is None or self.horizon >= 1,
            f"horizon must be >= 1 step, got {self.horizon}; pass duration / dt.",
        )
        _require(
            self.exploration is None or 1 <= self.exploration <= LONGEST,
            f"exploration must be >= 1 step and at most {LONGEST}, got {self.exploration}; None is "
            "one horizon.",
        )
        _require(
            not (self.search.limits and self.model.delay),
            "limits go with model.delay 0: a brake does not know how late an actuator answers, got "
            f"{self.model.delay} s.",
        )


def from_dict(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """A configuration from its JSON form, the inverse of `dataclasses.asdict`.

    Raises:
        InputError: an entry is unknown, missing, or of another type.
    """
    _require(
        isinstance(values, Mapping),
        f"{kind.__name__} must be an object with named entries, got {values!r}.",
    )
    known = {f.name for f in fields(kind)}
    unknown = sorted(set(values) - known)
    _require(not unknown, f"{kind.__name__} has no entries {unknown}; it has {sorted(known)}.")
    hints = get_type_hints(kind)
    entries = {name: _from_json(hints[name], value) for name, value in values.items()}
    try:
        return kind(**entries)
    except TypeError as error:
        raise InputError(f"{kind.__name__} lacks an entry: {error}.") from error


def _from_json(hint: Any, value: Any) -> Any:
    if isinstance(hint, type) and is_dataclass(hint):
        return from_dict(hint, value)
    if get_origin(hint) is tuple and isinstance(value, list | tuple):
        return tuple(_from_json(get_args(hint)[0], entry) for entry in value)
    return value


CART_POLE = "mcpilco/CartPoleSwingUp-v0"
"""the env that presets and commands are about by default"""
CART_POLES = (CART_POLE, "mcpilco/MujocoCartPoleSwingUp-v0")
"""the envs that the keywords of a preset describe"""


@dataclass(frozen=True)
class Preset:
    """A named setting: the agent's numbers and the env's."""

    summary: str
    """what it is, in a line"""
    config: Any
    """numbers of the agent: `Config`, or those of another algorithm"""
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    """keywords for `gymnasium.make`; they describe the cart-poles"""

    def config_for(self, env_id: str) -> Any:
        """The agent's numbers for an env; an algorithm may have others for each."""
        return self.config

    def keywords(self, env_id: str) -> dict[str, Any]:
        """The keywords to make an env with: those of the preset for a cart-pole, else none."""
        return dict(self.env_kwargs) if env_id.rsplit(":", maxsplit=1)[-1] in CART_POLES else {}


def _shipped() -> dict[str, Preset]:
    """The presets of MC-PILCO, of `presets.json`; what is not named there has its default."""
    content = json.loads(Path(__file__).with_name("presets.json").read_text(encoding="utf-8"))
    return {
        name: Preset(**{**entries, "config": from_dict(Config, entries["config"])})
        for name, entries in content.items()
    }


PRESETS: dict[str, Preset] = _shipped()
