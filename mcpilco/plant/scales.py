"""The usual motion and force at each target of a plant, and the priors of its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects.base import Scale
from mcpilco.plant.plant import Plant
from mcpilco.plant.simulation.layout import GAIN
from mcpilco.typing import InputError


def scales_of(
    plant: Plant,
    y: Float[np.ndarray, "W X T"],
    commands: Float[np.ndarray, "W T_all U"],
    driven: Float[np.ndarray, "W T U"],
    dt: float,
) -> dict[str, Scale]:
    """The usual motion and force at each target of a plant, in some windows of recordings.

    Args:
        plant: nominal.
        y: measured states, dt [s] apart; NaN where there is no measurement.
        commands: all of them, the past included.
        driven: the mean of them from each sample to the next.
        dt: sampling time [s].
    """
    layout = plant.layout
    J = len(layout.joints)
    scales = {}
    y = y.copy()
    for j in range(J):  # velocities that were not measured
        v = np.gradient(y[:, 2 * j], dt, axis=-1)
        y[:, 2 * j + 1] = np.where(np.isfinite(y[:, 2 * j + 1]), y[:, 2 * j + 1], v)
    q, v = (y[:, part::2].transpose(0, 2, 1).reshape(-1, J) for part in (0, 1))
    fine = np.isfinite(q).all(axis=1) & np.isfinite(v).all(axis=1)
    q, v = q[fine], v[fine]
    inertias = plant.mass_matrix(q[:200]).mean(axis=0)
    weights = plant.weights(q)
    gains = plant.tables(plant.nominal[None]).actuators[0, :, GAIN]
    commands = np.abs(gains * commands).reshape(-1, commands.shape[-1])
    acting = plant.actuation(q, v, driven.reshape(len(fine), -1)[fine])
    names = (*layout.joints, *layout.bodies, *layout.actuators, *layout.states, *layout.contacts)
    for target in dict.fromkeys(names):
        j = layout.joint_of(target)
        mass, length = plant.mass_and_length(target)
        inputs = [u for u, joint in enumerate(layout.drives) if joint == j] or [0]
        u = layout.actuators.index(target) if target in layout.actuators else inputs[0]
        gain = commands[:, u].std() + commands[:, u].mean()
        usual = gain if j in layout.drives else 0.0
        if acting is not None:
            usual = np.abs(acting[:, j]).mean() + acting[:, j].std()
        velocity = np.sqrt(np.mean(v[:, j] ** 2))
        signal = y[:, layout.states.index(target)] if target in layout.states else q[:, j]
        inertia = float(inertias[j, j])
        force = max(usual, np.sqrt(np.mean(weights[:, j] ** 2)), 0.1 * inertia * velocity / 0.1)
        scales[target] = Scale(
            position=float(np.abs(q[:, j]).max()) + 1e-9,
            velocity=float(velocity) + 1e-9,
            force=float(force) + 1e-12,
            command=float(commands[:, u].max()) + 1e-12,
            signal=float(np.sqrt(np.nanmean(signal**2))) + 1e-9,
            inertia=inertia,
            mass=mass,
            length=length,
            dt=dt,
        )
    return scales


def priors_of(
    plant: Plant, uncertainty: float | Mapping[str, float], free: Sequence[str], usual: float
) -> dict[str, float]:
    """Relative prior std of each uncertain parameter; inf frees it.

    Args:
        plant: nominal.
        uncertainty: one for all, or by name [-].
        free: names of those of which nothing is known; `all` for all.
        usual: of those that `uncertainty` does not name [-].

    Raises:
        InputError: the plant has no such parameter.
    """
    names = [parameter.name for parameter in plant.parameters]
    by_name = uncertainty if isinstance(uncertainty, Mapping) else {}
    unknown = sorted({*by_name, *free} - {*names, "all"})
    if unknown:
        raise InputError(
            f"{plant.name} has no parameter {', '.join(unknown)}; it has {', '.join(names)}."
        )
    rest = usual if isinstance(uncertainty, Mapping) else uncertainty
    priors = {
        parameter.name: float(by_name.get(parameter.name, rest))
        for parameter in plant.parameters
        if (parameter.uncertain or parameter.name in by_name) and parameter.value != 0.0
    }
    freed = [n for n in priors if "all" in free or n in free]
    freed += [name for name in free if name != "all" and name not in priors]
    priors |= dict.fromkeys(freed, np.inf)
    return {name: std for name, std in priors.items() if std > 0.0}
