"""SAC, TQC and PPO of stable-baselines3, as agents of this package with presets for its envs.

from baselines.sb3 import make_learner

agent = make_learner("sac", "mcpilco/CartPoleSwingUp-v0", seed=0)
agent.learn(600)  # steps of the env
action, _ = agent.predict(observation)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
