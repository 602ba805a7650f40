"""Contacts: how a machine touches the ground and itself, as only MuJoCo simulates it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects.base import Effect, Probe, Scale, Symbol, sizes
from mcpilco.plant.simulation.layout import Layout, Tables
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.mjcf import EditedModel

LEAST, MOST = 0.02, 50.0
"""times the nominal value that friction, stiffness and damping may be [-]"""


class ContactEffect(Effect):
    """A number of all contacts, which differs from the model's."""

    place = "contact"
    symbols = (Symbol("k", "-", 1.0, LEAST, MOST),)

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.contacts

    def in_equations(self) -> bool:
        return False

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        raise InputError(f"equations have no {self.name}: they know no contacts.")

    def probes(self, scale: Scale) -> list[Probe]:
        return [
            Probe(np.array([[0.8]]), proportional=False),
            Probe(np.array([[1.25]]), proportional=False),
        ]


class ContactFriction(ContactEffect):
    """The sliding friction of all contacts is k times the model's."""

    name = "contact_friction"

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.scale_contacts(friction=values[0])


class ContactStiffness(ContactEffect):
    """The stiffness of all contacts is k times the model's, their damping the same."""

    name = "contact_stiffness"

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.scale_contacts(stiffness=values[0])


class ContactDamping(ContactEffect):
    """The damping of all contacts is k times the model's, their stiffness the same."""

    name = "contact_damping"

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.scale_contacts(damping=values[0])


class GroundHeight(ContactEffect):
    """All that never moves is z_d higher."""

    name = "ground_height"
    symbols = (Symbol("z_d", "m"),)

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(0.002)]

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.array([0.5])

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> None:
        model.raise_ground(values[0])
