"""From recordings of a system to a policy that was trained in a corrected simulation of it.

`Workflow` (`workflow.py`) is the whole: record the system (`rollouts.py`), find what its simulation
lacks (`mcpilco.gap`), train in the nominal and in the corrected simulation, and try the best policy
of each on the system. `Crossing` (`outcomes.py`) holds the outcomes of one policy in both places,
and `prior.py` says what MC-PILCO's model takes over from a corrected simulation.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
