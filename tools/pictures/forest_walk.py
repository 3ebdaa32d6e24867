# SPDX-License-Identifier: Apache-2.0
"""Picture of the quadruped in the woods of its task: ``python tools/pictures/forest_walk.py [FILE]``.

No training is needed: the robot stands, and the camera is the task's own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import gymnasium
import torch
from PIL import Image

import stripe_tasks  # noqa: F401 (registers the tasks)
from stripe_newton.configclass import resolve_name

TASK, SEED, STEPS = "Stripe-Forest-Walk-Quadruped-Play-v0", 3, 25
SIZE, OVERSAMPLING = (960, 540), 2


def main(path: Path) -> None:
    """Draw the picture."""
    cfg = resolve_name(gymnasium.spec(TASK).kwargs["env_cfg_entry_point"])()
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = 4, "cpu", SEED
    cfg.viewer.resolution = (SIZE[0] * OVERSAMPLING, SIZE[1] * OVERSAMPLING)
    cfg.viewer.shadow_resolution = 1024
    env = gymnasium.make_vec(TASK, cfg=cfg, render_mode="rgb_array")
    env.reset(seed=SEED)
    for _ in range(STEPS):
        env.step(torch.zeros(4, *env.unwrapped.single_action_space.shape))
    picture = env.render()
    env.close()
    frame = picture[0] if isinstance(picture, (list, tuple)) else picture
    Image.fromarray(frame).resize(SIZE, Image.Resampling.BOX).save(path, quality=80, optimize=True)
    print(f"{path}: {path.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/forest_walk.jpg"))
