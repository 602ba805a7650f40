"""Pages in HTML that need nothing beside them: of a run, of a gap, of a crossing.

A run's page reads the run folder alone: no environment is made, no policy is run on one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
