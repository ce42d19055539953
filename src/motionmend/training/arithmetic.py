"""In which arithmetic this machine trains faster: measured, as flags do not tell."""

from __future__ import annotations

import time
from functools import cache

import torch

SECONDS = 0.25  # for each kind
TOKENS, WIDTH, INSIDE = 2048, 192, 576


@cache
def faster(device: torch.device) -> str:
    """ "bf16" or "fp32": which of them multiplies a block's matrices, and goes back through them, in less time."""
    if device.type == "cuda":
        return "bf16" if torch.cuda.get_device_capability(device) >= (8, 0) else "fp32"
    return "bf16" if _pace(torch.bfloat16) > _pace(torch.float32) else "fp32"


def _pace(dtype: torch.dtype) -> float:
    """Products a second in a type, the way there and back; it counts what a slow machine manages in the time."""
    x = torch.randn(TOKENS, WIDTH).to(dtype).requires_grad_()
    into = torch.randn(INSIDE, WIDTH).to(dtype).requires_grad_()
    (x @ into.T).sum().backward()  # to warm up
    done, began = 0, time.perf_counter()
    while done < 1 or time.perf_counter() - began < SECONDS:
        (x @ into.T).sum().backward()
        done += 1
    return done / (time.perf_counter() - began)
