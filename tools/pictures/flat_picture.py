# SPDX-License-Identifier: Apache-2.0
"""Picture of robots in an imported flat: ``python tools/pictures/flat_picture.py [docs/images/flat.jpg]``.

The flat is the one of ``tools/authoring/author_flat.py``; sixteen quadrupeds stand at places that were found in it.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import torch
from PIL import Image

from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg

sys.path.insert(0, str(Path(__file__).parents[1] / "authoring"))

from author_flat import author_flat

SIZE, OVERSAMPLING, ROBOTS = (960, 600), 2, 16


def main(path: Path) -> None:
    """Draw the picture."""
    with tempfile.TemporaryDirectory() as folder:
        cfg = QuadrupedFlatEnvCfg()
        cfg.scene.num_envs, cfg.seed, cfg.events.push_robot = ROBOTS, 0, None
        cfg.scene.scenery = str(author_flat(Path(folder) / "flat.usda", bodies=True))
        # One place for each robot: with more, two of them might draw the same.
        cfg.scene.scenery_options.start.num_spots = ROBOTS
        env = ManagerBasedRLEnv(cfg)
        env.reset()
        for i, spot in enumerate(env.scene.terrain.spots):
            pose = env.scene["robot"].data.root_pose_w[i : i + 1].clone()
            pose[:, :3] = spot + torch.tensor([0.0, 0.0, 0.34], device=env.device)
            env.scene["robot"].write_root_pose_to_sim(pose, [i])
        for _ in range(50):
            env.step(torch.zeros(ROBOTS, env.action_manager.total_action_dim, device=env.device))
        resolution = (SIZE[0] * OVERSAMPLING, SIZE[1] * OVERSAMPLING)
        # A fine shadow map: the posts of the railing are 3 cm wide.
        look = {"eye": (-10.7, -10.7, 13.8), "lookat": (0.2, 0.2, 0.3), "origin_type": "world"}
        view = ViewerCfg(**look, resolution=resolution, shadow_resolution=2048)
        picture = SceneRenderer(env.sim, view, range(ROBOTS)).render()
        env.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).resize(SIZE, Image.Resampling.BOX).save(path, quality=82, optimize=True)
    print(f"{path}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/flat.jpg"))
