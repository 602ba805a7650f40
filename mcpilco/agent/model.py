"""The agent's model: measured transitions in, dynamics for the particles out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate, pairwise, starmap
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import FORCE_PART, LINEAR_PARTS, ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics import (
    AngleAugmentation,
    Delay,
    GPDynamics,
    PathwisePosterior,
    PhysicsDynamics,
    full_state,
    regressors,
    speed_integration,
    turning_regressors,
)
from mcpilco.gp import (
    GP,
    Posterior,
    condition_through,
    evenly_spaced,
    inducing_points,
    subset_of_data,
)
from mcpilco.kernels import MPK, RBF, SEDMPK, ActiveDims, Kernel, Linear
from mcpilco.plant import Program, Rows, features_of
from mcpilco.sensing import StatePredictor, StateTracker, sensor_noise
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.dynamics import PhysicsMean
    from mcpilco.plant import Plant

INTEGRATIONS = {"speed": speed_integration, "full": full_state}
"""what `ModelConfig.integration` names"""
ITERATIONS = {"lbfgs": 200, "adam": 1500}
"""most steps of each optimiser of the marginal likelihood; the authors later give Adam 1501"""
STRONG = 3.0
"""log Bayes factor from which evidence is strong (Kass & Raftery, Bayes factors, JASA 90, 1995)"""


KernelFactory = Callable[[int, tuple[int, ...]], Kernel]
"""makes a kernel of D regressors for a batch of outputs, `(E,)`; a kernel's class is one"""


def make_kernel(
    config: ModelConfig,
    width: int,
    outputs: int,
    features: Sequence[int] = (),
    lags: Sequence[Sequence[int]] = (),
) -> Kernel:
    """The kernel that a configuration names, for all outputs at once.

    The configuration names its parts. `width` is that of [z, u], which rbf and mpk see; each linear
    part sees so many of the further regressors, in the order of the parts; `lags` are, of each
    input, which of [z, u] are its present and past values, newest first.

    Reference: thesis eq. (5.10) for `rbf+mpk`, eqs. (6.29) and (6.35) for `sed-mpk`.
    """
    total, batch = width + sum(features), (outputs,)
    everything, lagged = range(width), [dim for channel in lags for dim in channel]
    rest = [dim for dim in everything if dim not in lagged]
    further = starmap(range, pairwise(accumulate(features, initial=width)))

    def of(dims: Sequence[int], kernel: Callable[..., Kernel], *how: int, **more: Any) -> Kernel:
        part = kernel(len(dims), *how, batch, **more)
        return part if len(dims) == total else ActiveDims(part, dims, total)

    def series(degree: int) -> Kernel:
        return of(lagged, SEDMPK, degree, channels=len(lags))

    make: Mapping[str, Callable[[], Kernel]] = {
        "rbf": lambda: of(everything, RBF),
        "mpk": lambda: of(everything, MPK, config.degree),
        "sed-mpk": lambda: series(config.degree),
        "sed-fir": lambda: of(rest, RBF) * series(1),
        **dict.fromkeys(LINEAR_PARTS, lambda: of(next(further), Linear, bias=False)),
    }
    names = [name for name in config.kernel.split("+") if name != FORCE_PART]
    first, *others = (make[name]() for name in names)
    return sum(others, start=first)


def _fitting(kernel: Any, width: int, batch: tuple[int, ...]) -> Kernel:
    if not isinstance(kernel, Kernel):
        raise InputError(
            "kernel must be a class or function that makes a mcpilco.kernels.Kernel of "
            f"(width, batch), got one that makes a {type(kernel).__name__}."
        )
    if (kernel.width, kernel.batch) != (width, batch):
        raise InputError(
            f"kernel must make a kernel of width {width} and batch {batch}, as it is asked to, "
            f"got width {kernel.width} and batch {kernel.batch}."
        )
    return kernel


class Model:
    """Gaussian processes for the changes of the state, refitted from scratch to new data."""

    def __init__(
        self, config: ModelConfig, task: TaskSpec, kernel: KernelFactory | None = None
    ) -> None:
        """A model that has seen nothing yet.

        `kernel` makes that of [z, u] in place of the one that `config` names.

        Raises:
            InputError: there is no plant for physics, or it does not fit the task; the kernel
                does not fit the regressors.
        """
        if kernel is not None and config.sampling == "path":
            raise InputError("A kernel of your own has no paths to draw; choose sampling step.")
        self.parts: tuple[str, ...] = () if kernel else tuple(config.kernel.split("+"))
        """of the kernel that the configuration names; none where another was given"""
        self.config = config
        self.task = task
        U, memory = len(task.input_names), config.memory
        self.delay = Delay.of(config.delay, task.dt)
        width = len(task.state_names) + U * memory
        self.width = width + U * self.delay.memory
        """of a state in the rows, with the past inputs that it holds"""
        self.augmentation = AngleAugmentation(width, task.angles)
        self.increment = INTEGRATIONS[config.integration](task).remembering(U, memory)
        self.names = tuple(task.state_names[i] for i in self.increment.predicted)
        self.features, counts = self._features()
        width = self.augmentation.width + U * (2 if self.delay.part else 1)
        batch = (len(self.names),)
        if kernel is None:
            made = make_kernel(config, width, *batch, counts, self._lags())
        else:
            made = _fitting(kernel(width, batch), width, batch)
        self.gp = GP(made, noise_floor=config.noise_floor, names=self.names)
        self.physics = self._mean() if config.mean == "physics" else None
        self.mirrored = False
        """whether mirror images of few samples count, by the evidence of the last fit"""

    @property
    def memory(self) -> int:
        """How many past inputs a state in the rows holds."""
        return self.config.memory + self.delay.memory

    def _lags(self) -> list[list[int]]:
        """Where each input, and its past values behind it, stand in [z, u]."""
        seen, X, U = self.augmentation, len(self.task.state_names), len(self.task.input_names)
        past = [seen.plain.index(i) for i in range(X, seen.state_dim)]
        return [[seen.width + i, *past[i::U]] for i in range(U)]

    def _features(self) -> tuple[Program | None, tuple[int, ...]]:
        """Further regressors, and how many each linear part of the kernel sees."""
        config, task = self.config, self.task
        linear = [name for name in self.parts if name in LINEAR_PARTS]
        if not linear and not self.delay.part:
            return None, ()
        U = len(task.input_names)
        rows: list[Rows] = []
        if self.delay.part:  # the policy search holds an input for a whole step
            rows.append(lambda given: [0.0] * U)
        if linear:
            from mcpilco.plant import friction_features, physics_features

            make = {
                "features": lambda: physics_features(self._plant(), task, config.memory),
                "friction": lambda: friction_features(task, config.friction_gate),
            }
            rows += [make[name]() for name in linear]
        program, counts = features_of(self.augmentation.state_dim + U, rows)
        return program, counts[-len(linear) :] if linear else ()

    def _plant(self) -> Plant:
        """The plant that physics is of; plants need numba, which models without them do not."""
        from mcpilco.mjcf import plant_of_text
        from mcpilco.plant import plant_for

        return plant_for(self.task, self.config.plant, plant_of_text)

    def _mean(self) -> PhysicsMean:
        from mcpilco.dynamics import PhysicsMean
        from mcpilco.plant import Spread, doubted, members_of, recipe_of

        config, plant = self.config, self._plant()
        uncertainty: Any = config.uncertainty
        if uncertainty == "told":
            told = members_of((config.plant or {})["spread"])
            plant, uncertainty = doubted(plant, max(told, key=lambda member: member.probability))
        spread = config.spread
        members = recipe_of(plant, spread) if isinstance(spread, dict) else members_of(spread or ())
        return PhysicsMean(
            plant,
            self.task,
            self.increment,
            config.memory,
            uncertainty,
            config.plant_step,
            FORCE_PART in self.parts,
            Spread(plant, members) if members else None,
        )

    def rows(self, transitions: Transitions) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N E"]]:
        """Regressors [z, u, features] and targets of the GPs: what the mean leaves of the changes.

        States of the transitions hold their past inputs, see `Transitions.after_inputs`.
        """
        of = self.increment.targets if self.physics is None else self.physics.residuals
        targets = torch.from_numpy(of(transitions))
        law = self.augmentation, self.features
        if not self.delay.memory:
            states, inputs = map(torch.from_numpy, (transitions.states, transitions.inputs))
            return regressors(*law, states, inputs), targets
        states, commands = self._commands(transitions)
        acting, turned = self.delay.acting(commands)
        if not self.delay.part:
            return regressors(*law, states, acting), targets
        return turning_regressors(*law, states, acting, turned), targets

    def _commands(
        self, transitions: Transitions
    ) -> tuple[Float[Tensor, "N X"], Float[Tensor, "N M_plus_1 U"]]:
        """States, and the commands of the steps from them and of those before, newest first."""
        states, inputs = torch.from_numpy(transitions.states), torch.from_numpy(transitions.inputs)
        behind = len(states[0]) - inputs.shape[1] * self.delay.memory
        commands = torch.cat([inputs, states[:, behind:]], 1)
        return states[:, :behind], commands.reshape(len(inputs), -1, inputs.shape[1])

    def fit(self, transitions: Transitions, warm: bool = False) -> dict[str, float]:
        """Learn the hyperparameters from these data; returns the numbers of the fit by name.

        With `warm` it begins with the present hyperparameters, instead of anew.

        Raises:
            NotPositiveDefiniteError: no jitter makes the covariance of a GP factorisable.
        """
        if self.physics is not None:
            self.physics.identify(transitions, self.config.noise_floor)
        everything = transitions
        if len(everything) > self._exact:
            transitions = everything[evenly_spaced(len(everything), self._exact)]
        X, Y = self.rows(transitions)
        self._maximise(X, Y, warm)
        self.mirrored = self._few(transitions) and self._looks_the_same(transitions, warm)
        if self.physics is not None:
            self.physics.refine(transitions, self.gp.condition(X, Y))
            X, Y = self.rows(transitions)
        with torch.no_grad():
            nlml = self.gp.nlml(X, Y)
        values = {"model/samples": float(len(everything))}
        if len(X) < len(everything):
            kept = self._kept(*self.rows(everything))
            of = "inducing_points" if self._through else "posterior_samples"
            values["model/fitted_samples"] = float(len(X))
            values[f"model/{of}"] = float(len(everything) if kept is None else len(kept))
        for i, noise in enumerate(self.noise_std):
            values[f"model/nlml_{i}"] = float(nlml[i])
            values[f"model/noise_std_{i}"] = noise
        parameters = {} if self.physics is None else self.physics.values
        return values | {f"model/{name}": value for name, value in parameters.items()}

    def _maximise(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"], warm: bool) -> None:
        """Give the GPs the likeliest hyperparameters."""
        optimiser = self.config.optimiser
        limit = ITERATIONS[optimiser]
        prior_std = self.config.prior_std if self.physics is None else None
        numbers: dict[str, Any] = {"max_iterations": limit, "prior_std": prior_std}
        self.gp.fit(X, Y, optimiser=optimiser, warm=warm, **numbers)

    def _few(self, transitions: Transitions) -> bool:
        """Whether images may count: the mean is zero, and with them an exact posterior is cheap."""
        most = min(self.config.mirror, self.config.inducing)
        return self.physics is None and len(transitions) <= most

    @torch.no_grad()
    def _looks_the_same(self, transitions: Transitions, warm: bool) -> bool:
        """Whether the samples' evidence is strongly for a system that its mirror image equals.

        If so the hyperparameters are those of samples and images, else they stay as they are.
        """
        (X, Y), (images, turned) = self.rows(transitions), self.rows(transitions.mirrored())
        before, nlml = self.gp.to_arrays(), self.gp.nlml(X, Y).sum()
        with torch.enable_grad():
            self._maximise(torch.cat([X, images]), torch.cat([Y, turned]), warm)
        if nlml - self.gp.odd_nlml(X, images, Y).sum() > STRONG:
            return True
        self.gp.load_arrays(before)
        return False

    def known(self, transitions: Transitions) -> Transitions:
        """The samples that the GPs are conditioned on: these, and where they count their images."""
        counts = self.mirrored and self._few(transitions)
        return transitions + transitions.mirrored() if counts else transitions

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything learned, as named arrays: what `load_arrays` reads."""
        known = {} if self.physics is None else self.physics.to_arrays()
        return self.gp.to_arrays() | known | ({"mirrored": np.array(True)} if self.mirrored else {})

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take what `to_arrays` gave.

        Raises:
            InputError: an array is missing or unknown, of another shape, or not finite.
        """
        ours = {} if self.physics is None else self.physics.to_arrays()
        kept = {*ours, "mirrored"}
        self.gp.load_arrays({name: a for name, a in arrays.items() if name not in kept})
        self.mirrored = "mirrored" in arrays
        if self.physics is not None:
            self.physics.load_arrays(arrays)

    @property
    def noise_std(self) -> tuple[float, ...]:
        """Learned noise of each GP, in its target's unit."""
        return tuple(self.gp.noise_std.detach().tolist())

    @property
    def _exact(self) -> int:
        """Samples beyond which inducing points pay."""
        return 2 * self.config.inducing

    @property
    def _through(self) -> bool:
        """Whether many samples are known through few.

        What draws functions, and what learns a plant beside them, has an exact posterior of few.
        """
        chosen = self.config.subset_threshold is not None
        return not chosen and self.physics is None and self.config.sampling == "step"

    def _kept(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Tensor | None:
        """Which samples the posterior is of: a subset, inducing points, or, None, all."""
        if self.config.subset_threshold is not None:
            return subset_of_data(self.gp, X, Y, self.config.subset_threshold)
        if len(X) > self._exact:
            return inducing_points(self.gp, X, Y, self.config.inducing)
        return None

    def _posterior(self, transitions: Transitions) -> tuple[Posterior, Transitions]:
        """The posterior given what is known of these data, and those rows that it is of."""
        transitions = self.known(transitions)
        X, Y = self.rows(transitions)
        kept = self._kept(X, Y)
        if kept is None:
            return self.gp.condition(X, Y), transitions
        if self._through:
            return condition_through(self.gp, X, Y, kept), transitions[kept.numpy()]
        return self.gp.condition(X[kept], Y[kept]), transitions[kept.numpy()]

    def dynamics(
        self, transitions: Transitions
    ) -> GPDynamics | PathwisePosterior | PhysicsDynamics:
        """The posterior given these data, or some of them, as a model of the next state.

        Raises:
            NotPositiveDefiniteError: no jitter makes the covariance of a GP factorisable.
        """
        bounds = self._bounds(transitions)
        posterior, transitions = self._posterior(transitions)
        law = self.augmentation, self.increment, bounds
        dynamics = GPDynamics(posterior, *law, self.features)
        if self.physics is not None:
            return PhysicsDynamics(self.physics, dynamics, transitions)
        if self.config.sampling == "step":
            return dynamics
        return PathwisePosterior(dynamics, self.config.path_features)

    def tracker(
        self, transitions: Transitions | None, estimate_std: Float[np.ndarray, " X"] | None = None
    ) -> StateTracker | None:
        """The estimator of the state in which a late command acts; None where none is late.

        It learns from all transitions that the model was fitted to. `estimate_std` is the error of
        the state estimates that it is given, in each state's unit; without it, it is given
        measurements of all states.
        """
        if not self.delay.memory:
            return None
        inputs = len(self.task.input_names)
        if transitions is None:
            return StateTracker(StatePredictor(self.delay, None), inputs)
        known = self.dynamics(transitions)
        assert isinstance(known, GPDynamics), "the configuration has made sure"
        states, commands = self._commands(transitions)
        following = torch.from_numpy(transitions.next_states)[:, : states.shape[1]]
        predictor = StatePredictor(self.delay, known)
        noise = sensor_noise(predictor, states, commands, following)
        if estimate_std is not None:
            noise = noise.maximum(torch.from_numpy(estimate_std))
        return StateTracker(predictor, inputs, noise)

    def _bounds(self, transitions: Transitions) -> Float[np.ndarray, " E"]:
        """Largest plausible magnitude of each predicted state; none for one that never moved."""
        recorded = np.concatenate([transitions.states, transitions.next_states])
        recorded = recorded[:, : len(self.task.state_names)]
        largest = np.maximum(np.abs(recorded).max(0), self.task.start_std)
        bounds = np.where(largest > 0, self.config.plausible * largest, np.inf)
        return bounds[list(self.increment.predicted)]
