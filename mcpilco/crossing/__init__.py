"""Whether a policy crosses the gap: what the simulation it was trained in promised, what came."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
