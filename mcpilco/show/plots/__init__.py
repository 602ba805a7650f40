"""Plots for reports, one on each Axes: the system black, the model blue, its particles grey.

Each draws on the `ax` given, or on a new figure; without a `prediction`, the system alone.
matplotlib comes with the extra `report` and is imported when the first plot is drawn.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
