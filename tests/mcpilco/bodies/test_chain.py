"""What a chain of rigid bodies may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.bodies import HINGE, SLIDE, Body, Chain, distinct_rows, stack
from mcpilco.typing import InputError

CART = Body(name="cart", joint="rail", kind=SLIDE, axis=(1.0, 0.0, 0.0), mass=1.0)
POLE = Body(name="pole", joint="hinge", kind=HINGE, axis=(0.0, -1.0, 0.0), mass=0.5, parent=0)


def test_joints_are_named_in_the_order_of_q():
    assert Chain((CART, POLE)).joints == ("rail", "hinge")


@pytest.mark.parametrize("parent", [1, 2, -2])
def test_a_body_comes_after_its_parent(parent):
    with pytest.raises(InputError, match="'pole' must come after its parent, got parent"):
        Chain((CART, replace(POLE, parent=parent)))


def test_an_axis_has_length_1():
    with pytest.raises(InputError, match="'rail' must have length 1, got "):
        Chain((replace(CART, axis=(1.0, 0.1, 0.0)),))


def test_stacked_chains_differ_in_numbers_only():
    heavy = Chain((replace(CART, mass=3.0), POLE), gravity=(0.0, 0.0, -1.0))
    chains = stack([Chain((CART, POLE)), heavy])
    np.testing.assert_array_equal(chains.mass, [[1.0, 0.5], [3.0, 0.5]])
    np.testing.assert_array_equal(chains.gravity[:, 2], [-9.82, -1.0])


def test_rows_that_differ_make_up_all_rows():
    rows = np.array([[2.0, 1.0], [0.0, 3.0], [2.0, 1.0], [0.0, 4.0]])
    different, which = distinct_rows(rows)
    np.testing.assert_array_equal(different, rows[[0, 1, 3]])
    np.testing.assert_array_equal(different[which], rows)


def test_systems_that_share_their_bodies_are_stacked_by_number():
    chains = stack(
        [Chain((CART, POLE)), Chain((replace(CART, mass=3.0), POLE))], np.array([1, 0, 1])
    )
    np.testing.assert_array_equal(chains.mass, [[3.0, 0.5], [1.0, 0.5], [3.0, 0.5]])
    chains.mass[0, 0] = 7.0
    np.testing.assert_array_equal(chains.mass[2], [3.0, 0.5])


@pytest.mark.parametrize(
    "other", [(replace(CART, kind=HINGE), POLE), (CART,), (CART, replace(POLE, parent=-1))]
)
def test_chains_of_other_joints_are_not_stacked(other):
    with pytest.raises(InputError, match="these differ"):
        stack([Chain((CART, POLE)), Chain(other)])


@pytest.mark.parametrize(
    ("change", "planar"),
    [
        ({}, 1),
        ({"axis": (0.0, 1.0, 0.0)}, 1),
        ({"axis": (0.0, 0.6, 0.8)}, 0),
        ({"kind": SLIDE}, 0),
        ({"rotation": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))}, 0),
        ({"rotation": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))}, 1),
    ],
)
def test_a_chain_is_planar_where_nothing_leaves_the_plane_of_x_and_z(change, planar):
    assert stack([Chain((CART, replace(POLE, **change)))]).planar[0] == planar
