"""A few steps of training on one batch, to see whether a network learns at all."""

from __future__ import annotations

import torch


def losses_of(network, batch: dict[str, torch.Tensor], steps: int, rate: float) -> list[float]:
    """The loss before each of so many steps of Adam on the same batch."""
    optimiser = torch.optim.Adam(network.parameters(), rate)
    losses = []
    for _ in range(steps):
        loss = network.loss(batch, 0)["loss"].mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    return losses
