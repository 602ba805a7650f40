"""Agents that learn by trials: MC-PILCO, its loop, its model, its episodes, its files.

`TrialAgent.learn` is the loop (thesis, Algorithm 1): record first inputs; then in each trial fit
the model, search a policy in it, try it on the system. `ModelBasedAgent` has the steps of a trial,
and `MCPILCO` says which model, policy and search; `Model` turns recorded transitions into dynamics
for the particles. On the system a policy acts through a `Controller`, behind the estimator that it
was learned with; `write_policy` exports both, and `NumpyPolicy` acts from that file alone;
`write_c` and `write_onnx` do so for machines without Python.

Read `trial_agent`, `model_based`, `agent`, `model`, `controller`, `episode`; then `agent_file` and
`policy_file`, `policy_code`. `contract`, `guess`, `inspection` and `predictability` say what of a
foreign env fits, `task_file` reads a user's task, and `algorithms` finds an agent by its name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
