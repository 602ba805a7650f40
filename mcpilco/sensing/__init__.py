"""State estimates that a policy acts on where it does not see the state itself.

All follow one protocol, `mcpilco.typing.Estimator`: `begin` an episode, `observe` a measurement,
and note the inputs `after` the policy has acted; the same object works on the system and in the
particles of a rollout. Two reasons need one, and `Chain` joins them: a state that is measured in
part (`LinearEstimator`: a Kalman filter or filtered differences), and an actuator that answers late
(`StateTracker` on the system, `DelayModel` in rollouts). `PastInputs` appends past inputs to the
state. `Perception` fits an agent's linear estimator to its data, and smooths recordings to learn
from.

Read `estimator`, `motion`, `perception`, which also makes states of an env's observations, then
`delay`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
