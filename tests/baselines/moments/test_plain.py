"""The public entries refuse what they cannot understand, in a sentence."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from baselines.moments import (
    gaussian_through_gp,
    gaussian_through_squash,
    gaussian_through_trig,
)
from mcpilco.typing import InputError
from tests.baselines.moments.random_gps import random_case

CASE = random_case(np.random.default_rng(0))._asdict()


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"y": np.zeros((9, 2))}, r"y must have shape \(10, 2\) as the samples say"),
        ({"lengthscale": np.ones((2, 2))}, r"lengthscale must have shape \(2, 3\)"),
        ({"noise_std": np.zeros(2)}, "noise_std must be positive"),
        ({"mean": np.zeros(4)}, "mean and cov must have shapes"),
        ({"cov": np.full((3, 3), np.nan)}, "cov must be finite"),
        ({"x": "text"}, "x must be an array of numbers"),
        ({"x": np.zeros(3)}, "x must have 2 axes"),
    ],
)
def test_arguments_that_do_not_fit_are_named(wrong, sentence):
    with pytest.raises(InputError, match=sentence):
        gaussian_through_gp(**(CASE | wrong))


@pytest.mark.usefixtures("unchecked_shapes")
def test_an_angle_that_is_not_there_is_named():
    with pytest.raises(InputError, match=r"within 0\.\.1, got \[2\]"):
        gaussian_through_trig(np.zeros(2), np.eye(2), [2])


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_limit_of_another_width_is_named():
    with pytest.raises(InputError, match="limit must be one number or 2"):
        gaussian_through_squash(np.zeros(2), np.eye(2), np.ones(3))


def test_arrays_give_arrays_and_tensors_tensors():
    for kind, convert in ((np.ndarray, np.asarray), (torch.Tensor, torch.from_numpy)):
        found = gaussian_through_gp(**{name: convert(value) for name, value in CASE.items()})
        assert all(isinstance(part, kind) for part in found)
