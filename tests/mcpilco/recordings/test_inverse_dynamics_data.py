from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.identification.inverse_dynamics import JointData, check, joined
from mcpilco.typing import InputError
from tests.mcpilco.identification.inverse_dynamics.robots import measured, random_robot


@pytest.fixture
def data() -> JointData:
    rng = np.random.default_rng(0)
    return measured(random_robot(("hinge", "slide"), rng), rng, 100)


def test_good_data_pass(data):
    check(data)


def changed(array: np.ndarray, row: int, joint: int, value: float) -> np.ndarray:
    other = array.copy()
    other[row, joint] = value
    return other


def test_a_value_that_is_not_finite_is_told_by_row_and_joint(data):
    with pytest.raises(InputError, match=r"ddq of joint 'joint1' must be finite.*row 7"):
        check(replace(data, ddq=changed(data.ddq, 7, 1, np.nan)))


def test_a_joint_that_stands_still_is_refused(data):
    still = np.column_stack([np.full(100, 0.3), data.q[:, 1]])
    with pytest.raises(InputError, match=r"position of joint 'joint0' is constant \(0.3\)"):
        check(replace(data, q=still))
    silent = np.column_stack([data.tau[:, 0], np.zeros(100)])
    with pytest.raises(InputError, match="torque of joint 'joint1' is constant"):
        check(replace(data, tau=silent))


def test_too_few_samples_are_refused(data):
    with pytest.raises(InputError, match="2 joints need at least 50 samples, got 20"):
        check(data.rows(slice(0, 20)))


def test_repeated_rows_are_refused(data):
    with pytest.raises(InputError, match="100 of 200 samples are equal.*give each file once"):
        check(joined([data, data]))


def test_data_of_other_joints_are_not_joined(data):
    with pytest.raises(InputError, match="recordings of one robot"):
        joined([data, replace(data, joints=("a", "b"))])


def test_thinned_data_keep_both_ends(data):
    thin = data.thinned(10)
    assert len(thin) == 10
    np.testing.assert_array_equal(thin.q[[0, -1]], data.q[[0, -1]])
    assert data.thinned(100) is data


@pytest.mark.usefixtures("unchecked_shapes")
def test_shapes_are_checked(data):
    with pytest.raises(InputError, match=r"tau must have the shape \(100, 2\), got \(99, 2\)"):
        replace(data, tau=data.tau[1:])
