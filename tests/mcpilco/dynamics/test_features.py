from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.dynamics.features import AngleAugmentation, JointPolynomials, friction
from mcpilco.typing import InputError


def test_augmented_state_is_plain_entries_then_cosines_then_sines():
    augment = AngleAugmentation(4, (1, 2))
    states = torch.tensor([[7.0, 0.0, math.pi / 2, 9.0]]).double()
    expected = torch.tensor([[7.0, 9.0, 1.0, 0.0, 0.0, 1.0]]).double()
    torch.testing.assert_close(augment(states), expected)
    assert augment.width == 6
    assert augment.plain == (0, 3)


def test_state_without_angles_stays_as_it_is():
    states = torch.randn(3, 2, dtype=torch.float64)
    augment = AngleAugmentation(2, ())
    assert augment.width == 2
    torch.testing.assert_close(augment(states), states)


@given(turns=st.integers(-5, 5), angle=st.floats(-math.pi, math.pi))
def test_full_turns_look_alike(turns: int, angle: float):
    augment = AngleAugmentation(2, (1,))
    one = torch.tensor([0.3, angle], dtype=torch.float64)
    other = torch.tensor([0.3, angle + 2 * math.pi * turns], dtype=torch.float64)
    torch.testing.assert_close(augment(one), augment(other), rtol=0, atol=1e-12)


def test_regressors_are_the_augmented_state_and_the_input():
    augment = AngleAugmentation(4, (2,))
    states = torch.randn(5, 6, 4, dtype=torch.float64)
    inputs = torch.randn(5, 6, 1, dtype=torch.float64)
    regressors = augment.regressors(states, inputs)
    assert regressors.shape == (5, 6, 6)
    torch.testing.assert_close(regressors[..., :5], augment(states))
    torch.testing.assert_close(regressors[..., 5:], inputs)


def test_augmentation_is_differentiable():
    augment = AngleAugmentation(3, (0,))
    assert torch.autograd.gradcheck(augment, torch.randn(4, 3).double().requires_grad_())


@pytest.mark.parametrize("angles", [(4,), (-1,), (1, 1)])
def test_angles_outside_the_state_are_refused(angles: tuple[int, ...]):
    with pytest.raises(InputError, match=r"different indices within 0\.\.3"):
        AngleAugmentation(4, angles)


def test_joint_polynomials_are_those_of_the_thesis():
    """[cos, sin, slides, q'_1 q'_1, q'_1 q'_2, q'_2 q'_2, q'']"""
    z = JointPolynomials(("slide", "hinge"))
    motion = torch.tensor([0.5, math.pi / 2, 2.0, 3.0, 7.0, 8.0]).double()
    expected = torch.tensor([0.0, 1.0, 0.5, 4.0, 6.0, 9.0, 7.0, 8.0]).double()
    torch.testing.assert_close(z(motion), expected)
    assert z.width == 8


def test_friction_is_viscous_and_dry():
    found = friction(torch.tensor([-0.5, 0.0, 2.0]).double())
    expected = torch.tensor([[-0.5, -1.0], [0.0, 0.0], [2.0, 1.0]]).double()
    torch.testing.assert_close(found, expected)
