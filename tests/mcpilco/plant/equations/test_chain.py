"""The equations for numbers of any kind are those of the compiled loops."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mcpilco.bodies import Chain, generalised_forces, stack
from mcpilco.bodies import accelerations as compiled
from mcpilco.mjcf.models import chain_of
from mcpilco.plant.equations.chain import accelerations, inverse_dynamics
from tests.mcpilco.random_chains import random_mjcf, random_planar_chain

mujoco = pytest.importorskip("mujoco")


def spatial(rng: np.random.Generator) -> Chain:
    return chain_of(mujoco.MjModel.from_xml_string(random_mjcf(rng, 4)))


def system(chain: Chain) -> SimpleNamespace:
    chains = stack([chain])
    shared = {name: getattr(chains, name) for name in ("parent", "slides", "axis", "rotation")}
    names = ("origin", "mass", "center", "inertia", "armature", "gravity")
    arrays = shared | {name: getattr(chains, name)[0] for name in names}
    return SimpleNamespace(**{name: array.tolist() for name, array in arrays.items()})


@pytest.mark.parametrize("make", [lambda rng: random_planar_chain(rng, 3), spatial])
def test_equations_agree_with_the_compiled_ones(make):
    rng = np.random.default_rng(5)
    chain = make(rng)
    q, v, tau = rng.normal(size=(3, 6, len(chain.joints)))
    expected, forces = compiled(chain, q, v, tau), generalised_forces(chain, q, v, tau)
    known = system(chain)
    for n in range(len(q)):
        row = q[n].tolist(), v[n].tolist(), tau[n].tolist()
        np.testing.assert_allclose(accelerations(known, *row), expected[n], rtol=1e-8)
        found = inverse_dynamics(known, *row, known.gravity)
        np.testing.assert_allclose(found, forces[n], rtol=1e-8, atol=1e-10)
