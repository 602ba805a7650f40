"""Masses, centres of mass, inertias and friction of a robot from its motions and joint forces.

A `RigidBody` is an open chain whose forces are linear in its parameters, tau = Y theta;
`base_parameters` says on which sums of them the forces depend. `identify` leads from stretches of a
log to an `Identified` robot: filtered motions (`JointMotion` of `mcpilco.recordings`) give weighted
`Rows`, a `Recipe` names the regression and the projection on parameters of bodies that can exist,
and `check_links` says link by link which cannot. `write_identified_mjcf` writes an MJCF.

Read `body`, `rows`, `projection`, then `identified`; `robot_model` is needed for MJCF files and for
simulated instruments.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
