"""Agents that learn by trials: MC-PILCO, its model, its episodes, its files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
