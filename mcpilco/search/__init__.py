"""The policy search: particle rollouts, plain and compiled, and descent along their gradient."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
