"""Covariance functions: one class and one formula each, with an algebra of sums and products.

`Kernel` is the base class; a subclass needs the formula only. `RBF`, `Linear` and `MPK` are those
of the default models, `SEDMPK` and the `Volterra...` kernels see past inputs, `Kinematic` and `GIP`
know the joints of a robot. `Sum`, `Product`, `Scaled` and `ActiveDims` make new kernels of these.
Read `base`, `stationary`, `polynomial`, and then what you need.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
