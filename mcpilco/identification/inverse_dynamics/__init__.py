"""Inverse dynamics learned from data: the torques that a motion takes (thesis chapter 3).

`fit_inverse_dynamics` learns an `InverseDynamics` model from `mcpilco.recordings.JointData`, by one
of six `ESTIMATORS`. Such a model has forward dynamics too (`inertia`, `accelerations`), and a
`FeedForward` controller uses it on a robot. `save_inverse_dynamics` and `load_inverse_dynamics`
keep it as a file of plain arrays.

Read `model`, then `gaussian` (priors of the thesis, one Gaussian process a joint), then
`estimators`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
