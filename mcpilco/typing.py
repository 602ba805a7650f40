"""Shapes, protocols and errors that the whole package shares.

Axis letters in jaxtyping annotations, in the order time, particles, features, behind a batch `*b`:

    T steps    P particles    N samples    M queries or inducing points
    X state    U input        E outputs    D regressor width    B bases    J joints
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float
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
    """What a rollout needs of a policy: inputs for a set of states."""

    def __call__(
        self, states: Float[Tensor, "*b X"], dropout: Dropout | None = None, step: int = 0
    ) -> Float[Tensor, "*b U"]: ...


@runtime_checkable
class Dynamics(Protocol):
    """What a rollout needs of a model: one sampled step."""

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
class Observer(Protocol):
    """What a rollout needs of a sensor, and of what estimates or predicts behind it."""

    @property
    def noise_dim(self) -> int:
        """How many standard normal numbers one measurement consumes."""
        ...

    def begin(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b M"]:
        """What is remembered before the first measurement of an episode that starts there."""
        ...

    def observe(
        self,
        states: Float[Tensor, "*b X"],
        noise: Float[Tensor, "*b Y"],
        memory: Float[Tensor, "*b M"],
    ) -> tuple[Float[Tensor, "*b X"], Float[Tensor, "*b M"]]:
        """What a policy is told of the states, and what to remember for the next step."""
        ...

    def after(
        self, memory: Float[Tensor, "*b M"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b M"]:
        """What to remember once the inputs of the step are known."""
        ...


@runtime_checkable
class Cost(Protocol):
    """What is minimised: one number for each state and input."""

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b"]: ...


@runtime_checkable
class WidenableCost(Cost, Protocol):
    """A cost that can be made wider, so that a goal is felt from further away."""

    def widened(self, factor: float) -> Cost: ...
