# SPDX-License-Identifier: Apache-2.0
"""Forest gallery: draw three seeds of the forest at three densities, and one picture of each other scene.

python tools/pictures/forest_gallery.py docs/images
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from stripe_newton.specifications import SceneSpec
from stripe_newton.specifications.scene_pictures import ScenePictures
from stripe_tasks.forest import ClearingSpec, ForestSpec, PathSpec, RavineSpec
from stripe_tasks.rubble import RubbleSpec

SIZE, PICTURE = (96.0, 96.0), (360, 203)


def eye_level(spec: SceneSpec, seed: int) -> np.ndarray:
    """Picture of a scene at eye level with a white rim, uint8 ``(height, width, 3)``."""
    frame = ScenePictures(spec.create(seed), resolution=PICTURE).eye_level()
    return np.pad(frame, ((3, 3), (3, 3), (0, 0)), constant_values=255)


def save(path: Path, frame: np.ndarray) -> None:
    """Write a picture as JPEG: with so many details a PNG would be large."""
    Image.fromarray(frame).save(path, quality=70, optimize=True)


def main() -> None:
    """Write ``forest.jpg`` and ``scenes.jpg`` into the named folder."""
    out = Path(sys.argv[1])
    rows = []
    for density in (200.0, 500.0, 900.0):  # stems per hectare
        spec = ForestSpec(SIZE, density=density, undergrowth=2.0)
        rows.append(np.hstack([eye_level(spec, seed) for seed in (1, 2, 3)]))
    save(out / "forest.jpg", np.vstack(rows))
    specs = [
        ClearingSpec(SIZE, undergrowth=2.0), PathSpec(SIZE, undergrowth=2.0),
        RavineSpec(SIZE, undergrowth=2.0), RubbleSpec(),
    ]  # fmt: skip
    pictures = [eye_level(spec, 1) for spec in specs]
    save(out / "scenes.jpg", np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])]))


if __name__ == "__main__":
    main()
