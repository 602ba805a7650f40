"""Rigid bodies on joints: open chains of hinges and slides, and their equations of motion.

A `Chain` of `Body` (`chain`) has its mass matrix and bias forces in `compiled`, for callers that
are compiled too, and its accelerations in `planar`, faster where it stays in a plane. Both take
numbers, or packs of them, of many motions at once (`packs`, `pack_functions`, `pack_arrays`).
`motion` has forward and inverse dynamics and the regressor of batches of motions, `differentiable`
the regressor in torch. Read them in this order.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
