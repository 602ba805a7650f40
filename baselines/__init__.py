"""Other agents on the same protocol; importing this package registers their algorithms.

import baselines
from mcpilco.agent.algorithms import find

PILCO = find("pilco")
"""

from __future__ import annotations

from mcpilco.agent import algorithms

# named only, so that torch is loaded where it is used
algorithms.register("pilco", "baselines.pilco.agent:PILCO")
algorithms.register("sac", "baselines.sb3.agent:SACAgent")
algorithms.register("tqc", "baselines.sb3.agent:TQCAgent")
algorithms.register("ppo", "baselines.sb3.agent:PPOAgent")
