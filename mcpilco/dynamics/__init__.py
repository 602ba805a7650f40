"""Models of what comes next: Gaussian-process increments, physics as mean, memory, delay."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
