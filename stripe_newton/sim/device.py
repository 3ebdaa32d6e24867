# SPDX-License-Identifier: Apache-2.0
"""Device: from the name in a config to a device of this machine."""

from __future__ import annotations

import warp as wp

__all__ = ["resolve_device"]


def resolve_device(name: str | None) -> str:
    """``"cpu"`` or ``"cuda:N"`` for a device as a config names it.

    Raises:
        ValueError: for a device that this machine does not have.
    """
    count = wp.get_cuda_device_count()
    if name is None:
        return "cuda:0" if count else "cpu"
    if name == "cpu":
        return name
    index = int(name.partition(":")[2] or 0)
    if index >= count:
        have = ", ".join(["cpu", *(f"cuda:{i}" for i in range(count))])
        raise ValueError(f"device '{name}': this machine has {have}")
    return f"cuda:{index}"
