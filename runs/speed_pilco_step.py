"""How long one evaluation of PILCO's expected cost and its gradient takes.

    python runs/speed_pilco_step.py                    # H = 40 steps, n = 40, 80 and 120 samples

CPU seconds of one thread, median of some repeats after one for warming up. The model is of the
cart-pole: 6 regressors and 4 outputs, of random smooth samples, for only their number matters.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import torch
import tyro
from threadpoolctl import threadpool_limits

from baselines.moments import Bases, Gaussian
from baselines.pilco.rollout import GaussianDynamics, GPMean
from baselines.pilco.search import Problem
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies import cart_pole_cost

STATES, OUTPUTS, CENTRES = 4, 4, 10


@dataclass(frozen=True)
class Arguments:
    """What is timed."""

    horizon: int = 40
    """H [steps]"""
    samples: tuple[int, ...] = (40, 80, 120)
    """n, of each GP"""
    repeats: int = 9
    """evaluations that are timed"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    print("   n   value + gradient [CPU s]   value [CPU s]")
    with threadpool_limits(1):
        for samples in arguments.samples:
            dynamics, policy = model(samples), random_policy()
            start = Gaussian(torch.zeros(STATES).double(), 0.01 * torch.eye(STATES).double())
            problem = Problem(dynamics, cart_pole_cost(), start, arguments.horizon)
            both, value = (
                median_s(problem, policy, gradient, arguments.repeats) for gradient in (True, False)
            )
            print(f"{samples:4d} {both:26.3f} {value:15.3f}")


def median_s(problem: Problem, policy: GPMean, gradient: bool, repeats: int) -> float:
    """CPU time of an evaluation [s]."""

    def evaluate() -> float:
        begun = time.process_time()
        with torch.set_grad_enabled(gradient):
            total = problem.prediction(policy)[2].sum()
            if gradient:
                torch.autograd.grad(total, list(policy.parameters()))
        return time.process_time() - begun

    evaluate()
    return statistics.median(evaluate() for _ in range(repeats))


def model(samples: int) -> GaussianDynamics:
    """A posterior of smooth changes."""
    generator = torch.Generator().manual_seed(0)
    augmentation = AngleAugmentation(STATES, (2,))
    width = augmentation.width + 1
    X = torch.randn(samples, width, generator=generator, dtype=torch.float64)
    lengthscale = torch.full((OUTPUTS, width), 2.0, dtype=torch.float64)
    variance = torch.full((OUTPUTS,), 0.1, dtype=torch.float64)
    distance = (X[:, None] - X) / 2.0
    K = 0.1 * torch.exp(-0.5 * distance.square().sum(-1))
    inverse = torch.linalg.inv(K + 1e-4 * torch.eye(samples)).expand(OUTPUTS, -1, -1).contiguous()
    way = torch.randn(width, OUTPUTS, generator=generator, dtype=torch.float64)
    Y = 0.1 * torch.sin(X @ way)
    weights = (inverse @ Y.mT[..., None]).squeeze(-1)
    eye = torch.eye(STATES, dtype=torch.float64)
    bases = Bases(X, lengthscale, variance, weights, inverse)
    return GaussianDynamics(bases, augmentation, eye, eye)


def random_policy() -> GPMean:
    generator = torch.Generator().manual_seed(1)
    augmentation = AngleAugmentation(STATES, (2,))
    policy = GPMean(augmentation, [-10.0], [10.0], CENTRES)
    states = torch.randn(CENTRES, STATES, generator=generator, dtype=torch.float64)
    scales = torch.tensor([1.0, 1.0, 1.0, 0.7, 0.7], dtype=torch.float64)
    policy.randomise(states, scales, 0.5, generator)
    return policy


if __name__ == "__main__":
    main()
