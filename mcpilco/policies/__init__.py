"""Policies, the costs that judge them, and costs that are learned from rewards."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
