"""Products in tiles equal numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from mcpilco.search.fused import tiles

pytestmark = pytest.mark.xdist_group("search/test_tiles")  # what they call is compiled once
RTOL = {np.float32: 1e-5, np.float64: 1e-13}


@njit
def multiply(kind, packed, right, out):
    if kind == 0:
        tiles.multiply(packed, right, out)
    elif kind == 1:
        tiles.multiply_lower(packed, right, out)
    else:
        tiles.multiply_upper(packed, right, out)


@njit
def add_product(left, right, out):
    tiles.add_product(left, right, out)


KINDS = {"full": (0, lambda m: m), "lower": (1, np.tril), "upper": (2, np.triu)}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("dtype", sorted(RTOL, key=str))
@pytest.mark.parametrize("rows", [1, 4, 12, 30, 61])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_product_with_a_packed_matrix(kind: str, rows: int, dtype: type) -> None:
    number, part = KINDS[kind]
    rng = np.random.default_rng(rows)
    left = part(rng.standard_normal((rows, rows))).astype(dtype)
    right = rng.standard_normal((rows, 3 * tiles.strip(dtype))).astype(dtype)
    packed = tiles.pack(left)
    height = packed.shape[2]
    out = np.full((-(-rows // height) * height, right.shape[1]), np.nan, dtype)
    multiply(number, packed, right, out)
    np.testing.assert_allclose(out[:rows], left @ right, rtol=RTOL[dtype], atol=10 * RTOL[dtype])
    assert (out[rows:] == 0).all()


@pytest.mark.parametrize("dtype", sorted(RTOL, key=str))
def test_product_is_added_to_what_is_there(dtype: type) -> None:
    rng = np.random.default_rng(0)
    left = rng.standard_normal((2 * tiles.TALL, 7)).astype(dtype)
    right = rng.standard_normal((7, 2 * tiles.strip(dtype))).astype(dtype)
    before = rng.standard_normal((len(left), right.shape[1])).astype(dtype)
    out = before.copy()
    add_product(left, right, out)
    np.testing.assert_allclose(out, before + left @ right, rtol=RTOL[dtype], atol=10 * RTOL[dtype])


def test_tall_tiles_are_taken_unless_they_waste_much() -> None:
    chosen = [
        tiles.height_for(rows) for rows in (1, tiles.TALL + 1, tiles.TALL, 10 * tiles.TALL - 1)
    ]
    assert chosen == [tiles.LOW, tiles.LOW, tiles.TALL, tiles.TALL]
