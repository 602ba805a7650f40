"""Rigid bodies on joints: open chains of hinges and slides, and their equations of motion."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
