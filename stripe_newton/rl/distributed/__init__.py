# SPDX-License-Identifier: Apache-2.0
"""Training in several processes, one on each GPU: the ranks, and the launcher that starts them on one host."""

from __future__ import annotations

from .ranks import (
    LAUNCHER,
    LostRankError,
    World,
    as_rank,
    exchange,
    gather,
    join,
    rank_device,
    send_to_launcher,
    stop_asked,
    world,
)

__all__ = [
    "LAUNCHER",
    "LostRankError",
    "World",
    "as_rank",
    "exchange",
    "gather",
    "join",
    "rank_device",
    "send_to_launcher",
    "stop_asked",
    "world",
]
