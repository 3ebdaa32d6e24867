# SPDX-License-Identifier: Apache-2.0
"""Ground cover: colours of the forest floor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .darts import sample_map
from .fractal import gradient_noise

__all__ = ["ground_colors"]

# linear RGB
LITTER, SOIL, MOSS = (0.085, 0.052, 0.026), (0.045, 0.030, 0.018), (0.045, 0.075, 0.020)
MEADOW, ROCK, PATH = (0.075, 0.105, 0.030), (0.14, 0.13, 0.12), (0.17, 0.125, 0.080)


def ground_colors(
    maps: Mapping[str, np.ndarray], shape: tuple[int, ...], size: tuple[float, float], seed: int
) -> np.ndarray:
    """Linear RGB at each vertex, float32 ``(nrow, ncol, 3)``.

    Litter and moss in patches, more moss on wet ground; spots of bare soil; grass in the open, rock on steep ground,
    sand on ``trodden`` ground.

    Args:
        maps: ``slope`` [rad], ``moisture``, ``open`` and ``trodden`` in [0, 1], the last one if there is a path.
        shape: Rows and columns of the heights.
        size: Extent in x and y [m].
        seed: Seed of the patches.
    """
    x = np.linspace(-0.5 * size[0], 0.5 * size[0], shape[1])[None, :]
    y = np.linspace(-0.5 * size[1], 0.5 * size[1], shape[0])[:, None]
    patch, spot, grain = (
        gradient_noise(x, y, length, (seed, i))
        for i, length in enumerate((7.0, 2.2, max(0.6, 3.0 * (x[0, 1] - x[0, 0]))))
    )
    grid = np.stack(np.broadcast_arrays(x, y), axis=-1)

    def share(name: str) -> np.ndarray:
        # maps may be coarser than the heights
        values = maps.get(name)
        if values is None:
            return np.zeros(shape, dtype=np.float32)
        if values.shape == shape:
            return values
        return np.asarray(sample_map(values, size, grid), dtype=np.float32)

    colors = np.broadcast_to(np.array(LITTER, dtype=np.float32), (*shape, 3)).copy()

    def cover(color: tuple[float, float, float], weight: np.ndarray) -> None:
        part = np.clip(weight, 0.0, 1.0)[..., None].astype(np.float32)
        np.add(colors, part * (np.array(color, dtype=np.float32) - colors), out=colors)

    cover(SOIL, 0.5 * spot + 0.1)
    cover(MOSS, 0.55 * patch + 0.9 * share("moisture") + 0.25 * spot - 0.25)
    cover(MEADOW, 0.85 * share("open") + 0.2 * patch * share("open"))
    cover(ROCK, (share("slope") - 0.7) / 0.3 + 0.2 * grain)
    cover(PATH, share("trodden"))
    return np.asarray(colors * (1.0 + 0.16 * np.clip(grain, -2.0, 2.0))[..., None], dtype=np.float32)
