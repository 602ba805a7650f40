"""Gaussian-process regression: exact posteriors, evidence, sparse subsets, weight space.

A `GP` is a kernel with noise for E outputs at once: `fit` maximises the marginal likelihood, and
`condition` returns the posterior given data. Read `gp` first, then `evidence` (the derivatives of
the likelihood), `sparse` (many samples through few) and `weight_space` (kernels of few features).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
