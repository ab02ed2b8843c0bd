"""What all sensors share: biases that drift, and samples at their own rate."""

from __future__ import annotations

import math

from usv_kernel.jit import kernel

__all__ = ["drift", "is_due"]


@kernel
def drift(value: float, sd: float, decay: float, normal: float) -> float:
    """Return a first-order Gauss-Markov bias one step later."""
    return decay * value + sd * math.sqrt(1.0 - decay * decay) * normal


@kernel
def is_due(count: int, share: float) -> bool:
    """Return whether a sample falls on this control step, ``share`` of them having one."""
    # 1e-9: tolerance for rounding where count * share is a whole number
    return share >= 1.0 or math.floor(count * share + 1e-9) > math.floor((count - 1) * share + 1e-9)
