"""A pack does in each lane what a number does, whatever the other lanes hold."""

import math

import numpy as np
import pytest
from numba import njit

from mcpilco.bodies import (
    LANES,
    anywhere,
    as_packs,
    count,
    everywhere,
    lane,
    lanes_of,
    where,
    with_lane,
)

X, Y = np.random.default_rng(0).normal(size=(2, LANES))
TWO = [np.add, np.subtract, np.multiply, np.divide, np.minimum, np.maximum, np.copysign]
ORDERS = [np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal]
ONE = [np.abs, np.negative, np.floor, np.sqrt, np.exp, np.log, np.sin, np.cos]


@njit
def two(a, b, rows):
    rows[0], rows[1], rows[2], rows[3] = a + b, a - b, a * b, a / b
    rows[4], rows[5], rows[6] = min(a, b), max(a, b), math.copysign(a, b)


@njit
def compared(a, b, rows):
    rows[0], rows[1], rows[2] = where(a < b, a, 7.0), where(a <= b, a, 7.0), where(a > b, a, 7.0)
    rows[3], rows[4], rows[5] = where(a >= b, a, 7.0), where(a == b, a, 7.0), where(a != b, a, 7.0)


@njit
def of_one(a, rows):
    rows[0], rows[1], rows[2], rows[3] = abs(a), -a, math.floor(a), math.sqrt(a)
    rows[4], rows[5], rows[6], rows[7] = math.exp(a), math.log(a), math.sin(a), math.cos(a)
    rows[8] = a**-0.2


@njit
def mixed(a, b, rows):
    rows[0] = where((a > 0.0) & (b > 0.0), 1.0, 0.0)
    rows[1] = where((a > 0.0) | (b > 0.0), 1.0, 0.0)
    rows[2], rows[3], rows[4] = count(a > 0.0), 1.0 * anywhere(a > 0.0), 1.0 * everywhere(a > 0.0)
    for k in range(lanes_of(a)):
        a = with_lane(a, k, k + lane(b, lanes_of(b) - 1 - k))
    rows[5] = a


@njit
def run(arrays):
    packs, of_two, of_first, of_second, orders, ones, more = as_packs(arrays)
    two(packs[0], packs[1], of_two)
    two(packs[0], 0.3, of_first)
    two(-2.0, packs[1], of_second)
    compared(packs[0], packs[1], orders)
    of_one(packs[0], ones)
    mixed(packs[0], packs[1], more)


def of_packs(x=X, y=Y):
    rows = tuple(np.full((n, LANES), 99.0) for n in (7, 7, 7, 6, 9, 6))
    run((np.array([x, y]), *rows))
    return rows


@pytest.mark.one_in(4)
@pytest.mark.parametrize("n", range(len(TWO)))
def test_arithmetic_is_that_of_each_lane(n):
    both, first, second, *_ = of_packs()
    np.testing.assert_array_equal(both[n], TWO[n](X, Y))
    np.testing.assert_array_equal(first[n], TWO[n](X, 0.3))
    np.testing.assert_array_equal(second[n], TWO[n](-2.0, Y))


@pytest.mark.parametrize("n", range(len(ORDERS)))
def test_a_choice_is_made_in_each_lane(n):
    x = np.where(np.arange(LANES) % 3 == 0, Y, X)
    x[5] = np.nan
    np.testing.assert_array_equal(of_packs(x)[3][n], np.where(ORDERS[n](x, Y), x, 7.0))


def test_choices_are_joined():
    both, either, *_ = of_packs()[5]
    np.testing.assert_array_equal(both, (X > 0.0) & (Y > 0.0))
    np.testing.assert_array_equal(either, (X > 0.0) | (Y > 0.0))


@pytest.mark.parametrize("positive", [0, 1, LANES - 1, LANES])
def test_lanes_are_counted(positive):
    x = np.where(np.arange(LANES) < positive, 1.0, -1.0)[::-1]
    some = of_packs(x)[5][2:5, 0]
    np.testing.assert_array_equal(some, [positive, positive > 0, positive == LANES])


def test_a_lane_is_read_and_written():
    np.testing.assert_array_equal(of_packs()[5][5], np.arange(LANES) + Y[::-1])


def test_a_number_has_one_lane():
    both = njit(lambda x: (lanes_of(x), with_lane(x, 0, 2.0 * lane(x, 0)), where(x > 1.0, x, 0.0)))
    assert both(3.0) == (1, 6.0, 3.0)


@pytest.mark.parametrize("size", [1e-300, 1e-8, 1e-3, 1.0, 30.0, 700.0, 1e4, 1e9, 1e300])
@pytest.mark.parametrize("n", range(len(ONE)))
def test_functions_are_those_of_the_library_to_rounding(n, size):
    with np.errstate(over="ignore"):
        x = size * np.linspace(0.6, 1.6, LANES)
        found, known = of_packs(x)[4][n], ONE[n](x)
    known = np.where(np.isinf(known), found, known)  # another test has the end of exp
    atol = 3e-16 if ONE[n] in (np.sin, np.cos) else 0.0
    np.testing.assert_allclose(found, known, rtol=4e-16, atol=atol)


def test_a_lane_that_is_far_leaves_the_others_as_they_are():
    """Where a formula of sine and cosine does not reach."""
    x = np.where(np.arange(LANES) == 2, 1e12, X)
    found, near = of_packs(x)[4][6:8], of_packs()[4][6:8]
    np.testing.assert_array_equal(np.delete(found, 2, axis=1), np.delete(near, 2, axis=1))
    np.testing.assert_allclose(found[:, 2], [np.sin(1e12), np.cos(1e12)], rtol=1e-15)


def test_exp_ends_where_numbers_do():
    ends = np.resize([-1e300, -np.inf, 0.0, np.nan, 1e300, np.inf], LANES)
    found = of_packs(ends)[4][4]
    assert (found[:2] < 1e-307).all()
    assert found[2] == 1.0
    assert np.isnan(found[3])
    assert (found[4:6] > 1e307).all()


def test_a_power_is_that_of_the_library_nearly():
    x = 10.0 ** np.linspace(-10.0, 30.0, LANES)
    np.testing.assert_allclose(of_packs(x)[4][8], x**-0.2, rtol=1e-14)


def test_arrays_of_packs_are_indexed_like_arrays():
    @njit
    def change(arrays):
        (a, rest), whole = as_packs(arrays)
        row = a[1]
        row[0] += a[0, 1] * whole[0]
        rest[0] = 1.5
        return len(a)

    a, rest = np.arange(4.0 * LANES).reshape(2, 2, LANES), np.zeros((1, LANES))
    before = a.copy()
    assert change(((a, rest), np.array([3, 4]))) == 2
    before[1, 0] += 3.0 * before[0, 1]
    np.testing.assert_array_equal(a, before)
    np.testing.assert_array_equal(rest, 1.5)
