# SPDX-License-Identifier: Apache-2.0
"""Library of the rubble's pieces: a few of each kind, made once and used in every scene."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .concrete import beam, chunk, column, rebar, slab
from .masonry import brick, debris, pipe, wall
from .resting import Piece

__all__ = ["kinds"]


@lru_cache(maxsize=1)
def kinds() -> dict[str, list[Piece]]:
    """All pieces by kind: the same ones in every scene, which places, turns and scales them."""
    rng = np.random.default_rng(20)  # one stream: the order of the kinds below is part of their form
    slabs = [
        (1.9, 1.0, 0.26),
        (1.5, 0.75, 0.22),
        (1.25, 0.8, 0.22),
        (1.0, 0.7, 0.2),
        (1.6, 0.6, 0.2),
        (0.8, 0.65, 0.18),
        (0.65, 0.5, 0.18),
    ]
    beams = [(3.2, 0.26, 0.34), (2.6, 0.3, 0.3), (2.1, 0.24, 0.3), (1.5, 0.28, 0.28)]
    courses = [(1,), (1,), (1,), (1,), (2, 1), (2, 2, 1), (3, 2), (2, 2, 2)]
    pipes = [(2.6, 0.055), (1.8, 0.08), (1.6, 0.14), (2.2, 0.04)]
    return {
        "slab": [slab(f"slab_{i}", *s, rng) for i, s in enumerate(slabs * 2)],
        "beam": [beam(f"beam_{i}", *s, rng) for i, s in enumerate(beams)],
        "column": [column(f"column_{i}", h, 0.32, rng) for i, h in enumerate((0.9, 1.6, 2.3, 2.8))],
        "brick": [brick(f"brick_{i}", c, rng) for i, c in enumerate(courses)],
        "pipe": [pipe(f"pipe_{i}", *s, rng) for i, s in enumerate(pipes)],
        "rebar": [
            rebar(f"rebar_{i}", rng.uniform(0.45, 0.95), b, rng) for i, b in enumerate((0.3, 0.8, 1.3, 1.9, 0.6, 1.1))
        ],
        "wall": [wall(f"wall_{i}", *s, rng) for i, s in enumerate([(5.2, 3.2), (4.6, 5.0), (3.8, 2.8), (5.0, 4.4)])],
        "chunk": [chunk(f"chunk_{i}", r, rng) for i, r in enumerate((0.1, 0.14, 0.18, 0.23, 0.28, 0.16))],
        "debris": [debris(f"debris_{i}", 0.6, rng) for i in range(8)],
    }
