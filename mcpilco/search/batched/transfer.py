"""Arrays that move to a device together."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor


@dataclass(frozen=True)
class Movable:
    """A dataclass of tensors, and of others like itself."""

    def to(self, device: torch.device | str, dtype: torch.dtype = torch.float64) -> Self:
        """The same on another device; numbers in another precision, indices as they are."""
        moved: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Movable):
                moved[field.name] = value.to(device, dtype)
            elif isinstance(value, Tensor):
                kind = dtype if value.is_floating_point() else value.dtype
                moved[field.name] = value.to(device, kind)
        return dataclasses.replace(self, **moved)
