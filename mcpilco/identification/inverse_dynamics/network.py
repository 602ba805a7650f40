"""The thesis's neural network: two hidden layers of sigmoids, for all joints together."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from mcpilco.identification.inverse_dynamics.model import Fitted, InverseDynamics
from mcpilco.identification.report import Report
from mcpilco.recordings import JointData

UNITS = 400
"""of each hidden layer; the thesis takes 600 for six joints"""
EPOCHS = 80
BATCH = 200
RATE = 3e-3
"""of Adam at first; it falls to 0 along a cosine"""


class NetworkInverseDynamics(InverseDynamics):
    """Torques of standardised motions, through two layers of sigmoids.

    Reference: thesis section 3.4.1.
    """

    def __init__(self, fitted: Fitted, layers: nn.Sequential, scales: dict[str, Tensor]) -> None:
        super().__init__(fitted)
        self.layers, self.scales = layers, scales
        layers.requires_grad_(False)

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        s = self.scales
        return s["tau_mean"] + s["tau_std"] * self.layers((motion - s["x_mean"]) / s["x_std"])

    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        weights = {name: value.numpy() for name, value in self.layers.state_dict().items()}
        scales = {name: value.numpy() for name, value in self.scales.items()}
        return {"layers": weights, "scales": scales}


def network(joints: int, units: int) -> nn.Sequential:
    """The layers, in double precision."""
    sizes = (3 * joints, units, units)
    hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.Sigmoid())]
    return nn.Sequential(*hidden, nn.Linear(units, joints)).double()


def fit_network(
    data: JointData, units: int = UNITS, epochs: int = EPOCHS, seed: int = 0, **built: Any
) -> NetworkInverseDynamics:
    """A network of the least squared error on standardised torques, by Adam.

    Differs: the thesis leaves batches, rates and epochs to its source code; `BATCH`, `RATE` and
    `EPOCHS` are ours.
    """
    tau = torch.as_tensor(data.tau, dtype=torch.float64)
    X = data.motion
    scales = {
        "x_mean": X.mean(0),
        "x_std": X.std(0).clamp_min(1e-12),
        "tau_mean": tau.mean(0),
        "tau_std": tau.std(0),
    }
    inputs = ((X - scales["x_mean"]) / scales["x_std"]).float()
    targets = ((tau - scales["tau_mean"]) / scales["tau_std"]).float()
    generator = torch.Generator().manual_seed(seed)
    layers = network(len(data.joints), units).float()
    _initialise(layers, generator)
    _descend(layers, inputs, targets, epochs, generator)
    report = Report(converged=True, iterations=epochs * -(-len(X) // BATCH))
    fitted = Fitted.to("nn", data, report, units=units, **built)
    return NetworkInverseDynamics(fitted, layers.double(), scales)


def _initialise(layers: nn.Sequential, generator: torch.Generator) -> None:
    """Glorot's weights, from the generator."""
    for layer in layers:
        if isinstance(layer, nn.Linear):
            nn.init.xavier_normal_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)


def _descend(
    layers: nn.Sequential, X: Tensor, Y: Tensor, epochs: int, generator: torch.Generator
) -> None:
    adam = torch.optim.Adam(layers.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, epochs)
    for _ in range(epochs):
        for rows in torch.randperm(len(X), generator=generator).split(BATCH):
            adam.zero_grad()
            (layers(X[rows]) - Y[rows]).square().mean().backward()
            adam.step()
        schedule.step()
