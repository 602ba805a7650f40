"""Particles of many seeds at once: the rollout in torch, with its own backward sweep.

One seed in a batch of one is what takes the place of `mcpilco.search.fused` where nothing can be
compiled.
"""

from mcpilco.search.batched.engine import rollout, rollout_batch
from mcpilco.search.batched.masks import MaskBatch
from mcpilco.search.batched.model import ModelBatch
from mcpilco.search.batched.policy import PolicyBatch
from mcpilco.search.canonical import supports

__all__ = ["MaskBatch", "ModelBatch", "PolicyBatch", "rollout", "rollout_batch", "supports"]
