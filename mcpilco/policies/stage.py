"""Formulas of state and commands that stand between a policy's commands and the inputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from mcpilco.plant import Program, features_of


class Stage(nn.Module, ABC):
    """From states and commands to inputs: one formula, for torch, compiled loops and exports."""

    width: int
    """X, entries of a state, past inputs included"""
    bounds: Float[np.ndarray, "2 U"]
    """lowest and highest input, in its unit"""

    @property
    @abstractmethod
    def acts(self) -> bool:
        """Whether it changes any command."""

    @abstractmethod
    def rows(self, given: Sequence[Any]) -> list[Any]:
        """The U inputs of [state, commands], X + U numbers of any kind."""

    def forward(
        self, states: Float[Tensor, "*b X"], commands: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b U"]:
        """The inputs, in the env's unit."""
        if not self.acts:
            return commands
        return torch.stack(self.rows([*states.unbind(-1), *commands.unbind(-1)]), -1)

    @property
    def program(self) -> Program | None:
        """The formula as a program of [state, commands]; None where it changes nothing."""
        return program_of([self] if self.acts else [])


def program_of(stages: Sequence[Stage]) -> Program | None:
    """The program of [state, commands] of stages, one behind the other; None where there is none.

    They are of the same states and inputs.
    """
    if not stages:
        return None
    width = stages[0].width

    def rows(given: Sequence[Any]) -> list[Any]:
        inputs = list(given[width:])
        for stage in stages:
            inputs = stage.rows([*given[:width], *inputs])
        return inputs

    return features_of(width + stages[0].bounds.shape[1], [rows])[0]
