"""Gaussians through functions, in closed form: what moment-matching PILCO predicts with.

from baselines.moments import gaussian_through_gp, gaussian_through_trig, gaussian_through_squash
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
