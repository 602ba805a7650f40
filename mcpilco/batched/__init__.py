"""Particles of many seeds at once: `mcpilco.rollout.rollout` in torch, with its own backward sweep.

One seed in a batch of one is what takes the place of `mcpilco.fused` where nothing can be compiled.
"""

from mcpilco.batched.engine import rollout, rollout_batch
from mcpilco.batched.masks import MaskBatch
from mcpilco.batched.model import ModelBatch
from mcpilco.batched.policy import PolicyBatch
from mcpilco.canonical import supports

__all__ = ["MaskBatch", "ModelBatch", "PolicyBatch", "rollout", "rollout_batch", "supports"]
