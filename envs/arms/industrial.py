"""Industrial robots: a SCARA like the AdeptOne, and an arm like a UR10."""

from __future__ import annotations

from pathlib import Path

from mcpilco.bodies import Chain
from mcpilco.plant import chain_of, load_mjcf


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
    return chain_of(load_mjcf(Path(__file__).with_name("scara.xml")))


def ur10() -> Chain:
    """Six joints RRRRRR with the lengths and about the masses of a UR10 that holds 1 kg.

    The links are solid cylinders, so that this is a robot like it, not a model of one.

    Reference: thesis section 3.4.2, where the robot is a real one.
    """
    return chain_of(load_mjcf(Path(__file__).with_name("ur10.xml")))
