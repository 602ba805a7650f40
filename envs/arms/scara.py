"""A SCARA of the size of the AdeptOne: two hinges, a slide and a hinge, all of them upright."""

from __future__ import annotations

from mcpilco.bodies import HINGE, SLIDE, Body, Chain, Matrix

_ACROSS: Matrix = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
"""the quill looks down: z of the last two frames does"""


def scara() -> Chain:
    """Four joints RRPR; arms of 425 mm and 375 mm, a quill of 2 kg, a load of 2 kg off its axis.

    | joint | kind | unit | moves |
    |---|---|---|---|
    | shoulder | hinge | rad | the inner arm about the column |
    | elbow | hinge | rad | the outer arm |
    | quill | slide | m | the quill, down |
    | tool | hinge | rad | the load about the quill |

    The lengths are those of the AdeptOne; masses and inertias are of bodies of such a size.

    Reference: thesis section 3.4.1, whose dynamic parameters are not given.
    """
    return Chain(
        (
            Body(
                name="inner_arm",
                joint="shoulder",
                kind=HINGE,
                axis=(0.0, 0.0, 1.0),
                origin=(0.0, 0.0, 0.877),
                mass=15.0,
                center=(0.2, 0.0, 0.03),
                inertia=_box(15.0, 0.5, 0.2, 0.15),
            ),
            Body(
                name="outer_arm",
                joint="elbow",
                kind=HINGE,
                axis=(0.0, 0.0, 1.0),
                parent=0,
                origin=(0.425, 0.0, 0.0),
                mass=10.0,
                center=(0.18, 0.01, 0.05),
                inertia=_box(10.0, 0.45, 0.15, 0.15),
            ),
            Body(
                name="quill",
                joint="quill",
                kind=SLIDE,
                axis=(0.0, 0.0, 1.0),
                parent=1,
                origin=(0.375, 0.0, 0.0),
                rotation=_ACROSS,
                mass=2.0,
                center=(0.0, 0.0, -0.1),
                inertia=_box(2.0, 0.03, 0.03, 0.4),
            ),
            Body(
                name="load",
                joint="tool",
                kind=HINGE,
                axis=(0.0, 0.0, 1.0),
                parent=2,
                mass=2.0,
                center=(0.08, 0.02, 0.06),
                inertia=_box(2.0, 0.12, 0.06, 0.08),
            ),
        ),
        gravity=(0.0, 0.0, -9.81),
    )


def _box(mass: float, x: float, y: float, z: float) -> Matrix:
    """Inertia of a solid box of these edges about its center [kg m^2]."""
    c = mass / 12.0
    return (
        (c * (y * y + z * z), 0.0, 0.0),
        (0.0, c * (x * x + z * z), 0.0),
        (0.0, 0.0, c * (x * x + y * y)),
    )
