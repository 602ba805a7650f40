"""What a policy is told of the state: filters, smoothers, predictors and their noise."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
