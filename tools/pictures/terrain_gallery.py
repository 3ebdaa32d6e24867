# SPDX-License-Identifier: Apache-2.0
"""Terrain gallery: draw a tile of every kind of sub-terrain.

python tools/pictures/terrain_gallery.py [docs/images/terrains.png]
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import newton
import numpy as np
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from stripe_newton import terrains
from stripe_newton.terrains import SubTerrainBaseCfg, TerrainGenerator, TerrainGeneratorCfg
from stripe_newton.viewers import SceneRenderer, ViewerCfg

WIDTH, HEIGHT, COLUMNS, OVERSAMPLING, LABEL = 300, 200, 5, 2, 26
TILE, DIFFICULTY = 8.0, 0.8

KINDS: list[SubTerrainBaseCfg] = [
    terrains.HfRandomUniformTerrainCfg(
        noise_range=(0.0, 0.25), noise_step=0.01, downsampled_scale=0.4, border_width=0.3
    ),
    terrains.HfPyramidSlopedTerrainCfg(slope_range=(0.0, 0.6), platform_width=2.0, border_width=0.5),
    terrains.HfInvertedPyramidSlopedTerrainCfg(slope_range=(0.0, 0.6), platform_width=2.0, border_width=0.5),
    terrains.HfPyramidStairsTerrainCfg(step_height_range=(0.05, 0.25), step_width=0.4, platform_width=2.0),
    terrains.HfInvertedPyramidStairsTerrainCfg(step_height_range=(0.05, 0.25), step_width=0.4, platform_width=2.0),
    terrains.HfDiscreteObstaclesTerrainCfg(
        obstacle_width_range=(0.4, 1.2), obstacle_height_range=(0.1, 0.5), num_obstacles=50, platform_width=2.0
    ),
    terrains.HfWaveTerrainCfg(amplitude_range=(0.1, 0.7), num_waves=4),
    terrains.HfSteppingStonesTerrainCfg(
        stone_height_max=0.05,
        stone_width_range=(0.4, 1.2),
        stone_distance_range=(0.1, 0.4),
        holes_depth=-1.0,
        platform_width=1.5,
        border_width=0.4,
    ),
    terrains.HfPerlinTerrainCfg(amplitude_range=(0.1, 1.2), wavelength=3.0),
    terrains.MeshPlaneTerrainCfg(),
    terrains.MeshPyramidStairsTerrainCfg(
        step_height_range=(0.05, 0.25), step_width=0.3, platform_width=2.0, border_width=1.0
    ),
    terrains.MeshInvertedPyramidStairsTerrainCfg(
        step_height_range=(0.05, 0.25), step_width=0.3, platform_width=2.0, border_width=1.0
    ),
    terrains.MeshRandomGridTerrainCfg(grid_width=0.5, grid_height_range=(0.05, 0.3), platform_width=2.0),
    terrains.MeshRailsTerrainCfg(rail_thickness_range=(0.1, 0.3), rail_height_range=(0.1, 0.4), platform_width=2.0),
    terrains.MeshPitTerrainCfg(pit_depth_range=(0.2, 1.0), platform_width=3.0, double_pit=True),
    terrains.MeshBoxTerrainCfg(box_height_range=(0.2, 1.0), platform_width=3.0, double_box=True),
    terrains.MeshGapTerrainCfg(gap_width_range=(0.3, 1.0), platform_width=3.0),
    terrains.MeshStarTerrainCfg(
        num_bars=8, bar_width_range=(0.3, 0.8), bar_height_range=(0.3, 1.0), platform_width=2.0
    ),
]


def draw(kind: SubTerrainBaseCfg) -> Image.Image:
    """A tile of a kind, seen from above a corner."""
    cfg = TerrainGeneratorCfg(
        size=(TILE, TILE),
        border_width=0.5,
        horizontal_scale=0.05,
        sub_terrains={"tile": kind},
        difficulty_range=(DIFFICULTY, DIFFICULTY),
    )
    ground = TerrainGenerator(cfg).ground
    static = newton.ModelBuilder()
    static.add_shape_heightfield(heightfield=ground.source)
    device = wp.get_preferred_device().alias
    sim = SimpleNamespace(
        template=newton.ModelBuilder(), static=static, env_origins=np.zeros((1, 3)), env_origin=None, num_envs=1,
        device=device, lights=[], state=None, markers=(), body_choices=(),
    )  # fmt: skip
    resolution = (WIDTH * OVERSAMPLING, HEIGHT * OVERSAMPLING)
    # Natural: the tile casts shadows on itself, ray by ray. Its edges are to be seen, and no ground around.
    view = ViewerCfg(resolution=resolution, natural=True, horizon=False, haze=0.0, anti_aliasing=False)
    renderer = SceneRenderer(sim, view)
    renderer.look((8.0, -10.8, 9.0), (0.0, 0.0, -0.8))
    picture = Image.fromarray(renderer.render())
    renderer.close()
    return picture.resize((WIDTH, HEIGHT), Image.Resampling.BOX)


def main(path: Path) -> None:
    """Write the sheet."""
    rows = -(-len(KINDS) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * WIDTH, rows * (HEIGHT + LABEL)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for i, kind in enumerate(KINDS):
        x, y = i % COLUMNS * WIDTH, i // COLUMNS * (HEIGHT + LABEL)
        sheet.paste(draw(kind), (x, y))
        name = type(kind).__name__.removesuffix("Cfg").removesuffix("Terrain")
        pen.text((x + WIDTH // 2, y + HEIGHT + LABEL // 2), name, fill="black", font=font, anchor="mm")
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(128).save(path, optimize=True)  # grey on grey: a third of the size
    print(f"{path}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/terrains.png"))
