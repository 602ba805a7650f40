"""Shapes, protocols and errors that the whole package shares.

Axis letters in jaxtyping annotations, in the order time, particles, features, behind a batch `*b`:

    T steps    P particles    N samples    M queries or inducing points
    X state    U input        E outputs    D regressor width    B bases    J joints
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    import torch
    from jaxtyping import Bool, Float
    from torch import Tensor

    from mcpilco.policies import Dropout


class McPilcoError(Exception):
    """An error that its reader can act on: what was expected, what came, what to do.

    The command line prints it as one sentence and exits with code 2.
    """


class InputError(McPilcoError, ValueError):
    """A value given by the user does not fit."""


class EnvError(McPilcoError):
    """An environment does not fit the agent, or misbehaves while it runs."""


class RunFolderError(McPilcoError):
    """A run folder or a saved agent cannot be written, read or trusted."""


class RecordingError(McPilcoError):
    """A file of measurements cannot be read: which file, row and column, and what to do."""


class NotPositiveDefiniteError(McPilcoError, ArithmeticError):
    """A covariance matrix has no Cholesky factor, not even with the jitters in the message."""


@runtime_checkable
class Policy(Protocol):
    """A policy in a rollout: inputs for a set of states."""

    def __call__(
        self, states: Float[Tensor, "*b X"], dropout: Dropout | None = None, step: int = 0
    ) -> Float[Tensor, "*b U"]: ...


@runtime_checkable
class Dynamics(Protocol):
    """A model in a rollout: one sampled step."""

    @property
    def noise_dim(self) -> int:
        """How many standard normal numbers one particle consumes in one step."""
        ...

    def step(
        self,
        states: Float[Tensor, "*b X"],
        inputs: Float[Tensor, "*b U"],
        noise: Float[Tensor, "*b E"],
    ) -> Float[Tensor, "*b X"]: ...


@runtime_checkable
class UncertainDynamics(Protocol):
    """A distribution over models: each rollout draws its own, and keeps it from step to step."""

    @property
    def noise_dim(self) -> int: ...

    def draw(self, particles: int, generator: torch.Generator) -> Dynamics: ...


@runtime_checkable
class Estimator(Protocol):
    """State estimates from the measurements of an episode, which a policy acts on.

    The same object works on the system and in the particles of a rollout. In each step:

        estimate, memory = estimator.observe(measured, memory)
        inputs = policy(estimate)
        memory = estimator.after(memory, inputs)
    """

    def begin(self, states: Float[Tensor, "*b n"]) -> Any:
        """The memory before the first measurement of an episode.

        Args:
            states: where the episode begins, as far as it is known; a batch begins together.
        """
        ...

    def observe(
        self, measured: Float[Tensor, "*b Y"], memory: Any, begun: Bool[Tensor, "*b"] | None = None
    ) -> tuple[Float[Tensor, "*b X"], Any]:
        """The estimate that the policy acts on, and the memory with this measurement.

        Args:
            measured: now.
            memory: of `begin`, or of the step before.
            begun: which of a batch begin an episode now, whatever the memory holds; None: none.
        """
        ...

    def after(self, memory: Any, inputs: Float[Tensor, "*b U"]) -> Any:
        """The memory once the inputs of the step are known."""
        ...


@runtime_checkable
class Cost(Protocol):
    """The cost that a search minimises: one number for each state and input."""

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b"]: ...


@runtime_checkable
class WidenableCost(Cost, Protocol):
    """A cost that can be made wider, so that a goal is felt from further away."""

    def widened(self, factor: float) -> Cost: ...
