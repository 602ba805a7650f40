"""PILCO's numbers, and its model: a Gaussian process for the change of each state.

The default numbers are those of its authors' package for the cart-pole; the hyperparameters of the
Gaussian processes are kept from extremes by penalties.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.moments.image import Bases
from baselines.pilco.rollout import GaussianDynamics
from mcpilco.agent import Model
from mcpilco.config import Checked, ModelConfig, Preset
from mcpilco.data import Transitions
from mcpilco.gp import GP
from mcpilco.kernels import RBF, typical_size
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError


@dataclass(frozen=True)
class PilcoConfig(Checked):
    """The numbers of PILCO: of its model, policy and search."""

    signal_to_noise: float = 1000.0
    """a GP whose signal is more times its noise, in standard deviations, is penalised [-]"""
    longest: float = 100.0
    """a lengthscale more times the standard deviation of its input is penalised [-]"""
    centres: int = 10
    """points that the policy's mean goes through"""
    lengthscale: float = 1.0
    """the policy's starting lengthscale of states that are no angle, in their units"""
    angle_lengthscale: float = 0.7
    """of cosines and sines [-]"""
    target_std: float = 0.1
    """the points' values start around zero with this spread [-]"""
    line_searches: int = 150
    """most steps of the optimiser of a start"""
    evaluations: int = 500
    """most evaluations of the expected cost and its gradient of a start"""
    restarts: tuple[int, ...] = (0,)
    """most further starts from random policies, by trial, the last for all later ones: one begins
    while the model predicts failure, see `failing`; PILCO has none"""
    failing: float = 0.02
    """the model predicts failure where the mean expected cost over the last third of the horizon
    exceeds this share of the mean cost of the first rollouts [-]"""
    cost: Literal["task", "tip"] = "task"
    """task: the task's own; tip: that of PILCO's cart-pole, of the distance of the pole's tip"""
    tip_length: float = 0.5
    """of the pole, for the cost `tip` [m]"""
    tip_width: float = 0.25
    """distance at which the cost `tip` is 1 - exp(-1/2) [m]"""
    horizon: int | None = None
    """steps of one episode; None takes the env's time limit"""
    exploration: int | None = None
    """steps of random inputs before the first trial; None: one horizon"""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._at_least(centres=1, line_searches=1, evaluations=2, horizon=1, exploration=1)
        self._positive("lengthscale", "angle_lengthscale", "target_std", "tip_length", "tip_width")
        for name in ("signal_to_noise", "longest"):
            self._above(name, 1.0)
        if not self.restarts or min(self.restarts) < 0:
            raise InputError(f"restarts must be counts, one or more, got {self.restarts}.")
        self._positive("failing")

    def further_starts(self, trial: int) -> int:
        """The most of them in a trial, counted from 1."""
        return self.restarts[min(trial, len(self.restarts)) - 1]


PRESETS: dict[str, Preset] = {
    "default": Preset("PILCO's numbers, with the cost of the task", PilcoConfig()),
    "restarts": Preset(
        "PILCO's numbers, the cost of the task, and as many starts as MC-PILCO has",
        PilcoConfig(restarts=(1, 3)),
    ),
    "tip": Preset("PILCO's numbers and its own cost of the cart-pole", PilcoConfig(cost="tip")),
}


_POWER = 30
"""of the penalties: next to nothing within the curb, a wall beyond it"""


class CurbedGP(GP):
    """A GP whose marginal likelihood falls where signal-to-noise or lengthscales are extreme.

        nlml + sum_d (log(l_d / std_d) / log longest)^30 + (log(signal / noise) / log ratio)^30

    Reference: the PILCO package of Deisenroth, McHutchon, Hall and Rasmussen, its `hypCurb`.
    """

    kernel: RBF

    def __init__(self, kernel: RBF, config: PilcoConfig, names: tuple[str, ...]) -> None:
        super().__init__(kernel, noise_floor=0.0, names=names)
        self._curbs = log(config.longest), log(config.signal_to_noise)

    def nlml(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        """Negative log marginal likelihood of each output, with the penalties.

        Raises:
            NotPositiveDefiniteError: K + s^2 I has no Cholesky factor.
        """
        longest, ratio = self._curbs
        lengths = (self.kernel.lengthscale / typical_size(X)).log() / longest
        signals = (0.5 * self.kernel.log_variance - self.noise_std.log()) / ratio
        return super().nlml(X, Y) + lengths.pow(_POWER).sum(-1) + signals.pow(_POWER)

    @torch.no_grad()
    def _start_from(self, X: Tensor, Y: Tensor) -> None:
        super()._start_from(X, Y)
        self.kernel.lengthscale = typical_size(X).expand_as(self.kernel.lengthscale)


class PilcoModel(Model):
    """GPs with squared exponential kernels for the changes of all states."""

    gp: CurbedGP

    def __init__(self, config: PilcoConfig, task: TaskSpec) -> None:
        super().__init__(
            ModelConfig(kernel="rbf", integration="full", mirror=0, prior_std=None), task
        )
        kernel = self.gp.kernel
        assert isinstance(kernel, RBF), "the configuration says so"
        self.gp = CurbedGP(kernel, config, self.names)

    def moments(self, transitions: Transitions) -> GaussianDynamics:
        """The posterior given these data, as a model of Gaussian states.

        Raises:
            NotPositiveDefiniteError: no jitter makes the covariance of a GP factorisable.
        """
        posterior, kernel = self.gp.condition(*self.rows(transitions)), self.gp.kernel
        bases = Bases(
            posterior.X,
            kernel.lengthscale.detach(),
            kernel.variance.detach(),
            posterior.alpha,
            posterior.L_inv.mT @ posterior.L_inv,
        )
        A, B = torch.from_numpy(self.increment.A), torch.from_numpy(self.increment.B)
        return GaussianDynamics(bases, self.augmentation, A, B)
