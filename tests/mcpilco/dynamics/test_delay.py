"""Commands that act late: which they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.dynamics.delay import Delay
from mcpilco.typing import InputError


@given(st.integers(0, 40), st.floats(0.0, 0.999), st.floats(0.001, 2.0))
def test_a_delay_is_told_in_sampling_times(whole, part, dt):
    delay = Delay.of((whole + part) * dt, dt)
    assert delay.whole + delay.part == pytest.approx(whole + part, abs=2e-6)
    assert 0 <= delay.part < 1
    assert delay.memory == math.ceil(delay.whole + delay.part)


def test_what_is_nearly_a_whole_number_of_samples_is_one():
    assert Delay.of(0.3, 0.1) == Delay(3, 0.0)
    assert Delay.of(0.1 + 0.2, 0.1) == Delay(3, 0.0)
    with pytest.raises(InputError, match="at most 100 sampling times of 0.01 s, got 2 s"):
        Delay.of(2.0, 0.01)


@given(st.integers(0, 3), st.sampled_from([0.0, 0.25, 0.5, 0.9]))
def test_the_command_that_acts_is_the_one_of_then(whole, part):
    commands = torch.tensor([5.0, -3.0, 2.0, 7.0, 1.0]).double()
    acting, turned = Delay(whole, part).acting(commands[: whole + (part > 0) + 1, None])
    grid = (np.arange(1000) + 0.5) / 1000  # of the step, in which the older one acts first
    ago = np.where(grid < part, whole + 1, whole)
    assert float(acting) == pytest.approx(float(commands[ago].mean()))
    assert float(turned) == (float(commands[whole] - commands[whole + 1]) if part else 0.0)
