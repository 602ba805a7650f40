"""Laws of the methods that are compared: one face, and what each of them promises."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from mcpilco.identification import METHODS
from mcpilco.identification.noisy_inputs import methods
from mcpilco.identification.noisy_inputs.methods import lasso, least_squares, ridge, stepwise


def sparse_data(rng, N=400, D=12):
    b = np.zeros(D)
    b[[1, 4, 7]] = 3.0, -2.0, 1.0
    X = rng.normal(size=(N, D)) * 10.0 ** rng.uniform(-1.0, 1.0, D)
    y = X @ b
    return X, y + 0.3 * y.std() * rng.normal(size=N), b


@pytest.mark.parametrize("name", METHODS)
def test_every_method_finds_what_clean_data_say(name):
    rng = np.random.default_rng(0)
    X, b = rng.normal(size=(300, 5)), np.array([1.0, -2.0, 3.0, 2.0, -1.0])
    found = METHODS[name](X, X @ b + 1e-3 * rng.normal(size=300), 0)
    assert found.converged
    np.testing.assert_allclose(found.b, b, atol=0.02)


@pytest.mark.parametrize("name", ["OLS", "PLS", "LASSO"])
def test_equal_seeds_give_equal_coefficients(name):
    X, y, _ = sparse_data(np.random.default_rng(1))
    np.testing.assert_array_equal(METHODS[name](X, y, 3).b, METHODS[name](X, y, 3).b)


def test_stepwise_and_lasso_leave_inputs_out():
    X, y, b = sparse_data(np.random.default_rng(2))
    chosen = stepwise(X, y, 0).b
    assert (chosen[b != 0.0] != 0.0).all()
    assert (chosen[b == 0.0] != 0.0).sum() <= 2
    assert 3 <= (lasso(X, y, 0).b != 0.0).sum() < 12


def test_stepwise_takes_no_input_that_is_a_sum_of_others():
    rng = np.random.default_rng(3)
    X = rng.normal(size=(200, 3))
    X = np.column_stack([X, X.sum(axis=1)])
    found = stepwise(X, X[:, 0] + X[:, 1] + X[:, 2] + 0.01 * rng.normal(size=200), 0).b
    assert 1 <= (found != 0.0).sum() <= 3


def test_least_squares_of_redundant_columns_is_the_smallest():
    rng = np.random.default_rng(4)
    X = np.repeat(rng.normal(size=(100, 2)), 2, axis=1)
    y = X @ np.array([1.0, 1.0, 2.0, 2.0])
    np.testing.assert_allclose(least_squares(X, y, 0).b, [1.0, 1.0, 2.0, 2.0], rtol=1e-9)


def test_ridge_shrinks_more_where_there_is_more_noise():
    rng = np.random.default_rng(5)
    X, b = rng.normal(size=(60, 30)), np.full(30, 0.3)
    sizes = []
    for noise in (0.01, 10.0):
        y = X @ b + noise * rng.normal(size=60)
        sizes.append(np.linalg.norm(ridge(X, y, 0).b) / np.linalg.norm(least_squares(X, y, 0).b))
    assert sizes[0] == pytest.approx(1.0, abs=0.01)
    assert sizes[1] < 0.8


def test_a_descent_that_is_cut_short_says_so(monkeypatch):
    X, y, _ = sparse_data(np.random.default_rng(6))
    X[:, 0] += X[:, 4]
    assert lasso(X, y, 0).converged
    monkeypatch.setattr(methods, "MOST_ITERATIONS", 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scikit-learn's own
        assert not lasso(X, y, 0).converged


def test_stepwise_regression_that_runs_in_circles_says_so():
    """What enters at any p value leaves at once."""
    X, y, _ = sparse_data(np.random.default_rng(7))
    assert stepwise(X, y, 0).converged
    assert not stepwise(X, y, 0, enter=1.0, leave=0.5).converged
