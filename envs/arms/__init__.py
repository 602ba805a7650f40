"""Robot arms for identification: their models, what moves them, and what their sensors see."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
