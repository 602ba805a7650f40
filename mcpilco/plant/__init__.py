"""Plants: what a machine is made of, the effects that may act on it, and its simulation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
