from __future__ import annotations

import numpy as np
import pytest

from mcpilco.bodies import generalised_forces, mass_matrix


def test_the_nominal_plant_is_the_authors_model(run):
    """Mass matrix and weights of their equations, with inertias about the joints."""
    published = run.Published()
    (m1, m2), (c1, c2), (I1, I2) = published.masses, published.centers, published.inertias
    plant, l1, g = run.nominal(), published.lengths[0], published.gravity
    q = 0.7
    coupling = m2 * l1 * c2 * np.cos(q)
    M = [[I1 + I2 + m2 * l1**2 + 2 * coupling, I2 + coupling], [I2 + coupling, I2]]
    still = np.zeros((1, 2))
    np.testing.assert_allclose(mass_matrix(plant.chain, np.array([[0.3, q]]))[0], M, rtol=1e-9)
    weight = generalised_forces(plant.chain, np.array([[0.3, q]]), still, still)[0]
    lower = m2 * g * c2 * np.sin(0.3 + q)
    upper = (m1 * c1 + m2 * l1) * g * np.sin(0.3)
    np.testing.assert_allclose(weight, [upper + lower, lower], rtol=1e-9)


@pytest.mark.slow
def test_dry_friction_of_both_joints_of_a_real_double_pendulum_is_named(run, data):
    gap = run.find(data / "dfki_double_pendulum")
    assert gap.verdict == "named"
    dry = {named.target for named in gap.named if named.name == "coulomb_friction"}
    assert dry == {"shoulder", "elbow"}
    assert gap.comparison is not None
    assert gap.comparison.corrected < 0.25 * gap.comparison.refit
