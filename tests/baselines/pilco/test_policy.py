"""The mean of a GP as a policy."""

from __future__ import annotations

import torch

from baselines.moments import through_bases, through_squash
from tests.baselines.pilco.models import random_dynamics, random_policy


def test_inputs_stay_within_their_bounds():
    policy = random_policy(random_dynamics(inputs=2), inputs=2)
    states = 10 * torch.randn(500, 4, generator=torch.Generator().manual_seed(0)).double()
    with torch.no_grad():
        policy.targets.mul_(100.0)
        inputs = policy(states)
    assert inputs.shape == (500, 2)
    assert bool(((inputs >= -1.0) & (inputs <= 3.0)).all())


def test_at_its_centres_the_mean_is_nearly_the_target():
    policy = random_policy(random_dynamics())
    bases = policy.bases()
    with torch.no_grad():
        at = through_bases(bases, policy.centres, torch.zeros(6, 5, 5).double())
    assert torch.allclose(at.mean, policy.targets, atol=1e-2)


def test_moments_of_a_certain_state_are_the_answer():
    policy = random_policy(random_dynamics())
    state = torch.tensor([0.3, -0.2, 2.0, 1.0]).double()
    z, nothing = policy.augmentation(state), torch.zeros(5, 5).double()
    with torch.no_grad():
        a = through_bases(policy.bases(), z, nothing)
        u = through_squash(a.mean, a.cov, policy.squash.half_range)
        assert torch.allclose(policy.squash.centre + u.mean, policy(state), atol=1e-12)


def test_ten_centres_of_a_cart_pole_are_sixty_five_numbers():
    policy = random_policy(random_dynamics(), centres=10)
    assert sum(parameter.numel() for parameter in policy.parameters()) == 65
