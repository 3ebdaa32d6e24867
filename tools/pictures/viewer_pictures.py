# SPDX-License-Identifier: Apache-2.0
"""Viewer pictures: screenshots of the live view for the docs, from a real browser without a display.

    python tools/pictures/viewer_pictures.py [--out docs/images] [--only NAME ...]

Needs ``pip install stripe-newton[browser]`` and Chromium. A few minutes on a CPU, without a trained policy.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import torch
from PIL import Image

from stripe_newton.cli.run_configs import load_configs
from stripe_newton.cli.tasks import make_env
from stripe_newton.envs import RLEnv
from stripe_newton.viewers import LiveViewer, ViewerCfg
from stripe_newton.viewers.camera_framing import camera_axes
from stripe_tasks.robots import QUADRUPED_CFG
from tools.pictures.headless_browser import LivePage, open_page

SIZE = 1280, 800
"""Window [px]."""
BESIDE = ViewerCfg(origin_type="asset_root", asset_name="Robot", eye=(1.5, 2.3, 0.9), lookat=(0.2, 0.0, 0.3), fov=42.0)
"""A camera beside a robot."""


class Show:
    """An environment with actions of zero, its viewer and the page that shows it."""

    def __init__(self, task: str, num_envs: int, noise: float = 0.0, cfg: ViewerCfg | None = None):
        configs = load_configs(task, None, agent=False)
        configs.env.scene.num_envs, configs.env.seed = num_envs, 3
        configs.env.sim.device = "cpu"
        env = make_env(task, configs.env, None).unwrapped
        assert isinstance(env, RLEnv)  # all tasks of this package are
        self.env = env
        self.env.reset()
        self.viewer = LiveViewer(self.env, cfg=cfg, title=task, port=18700)
        self._noise = noise
        self._shape = self.env.action_space.shape

    def serve(self) -> None:
        """Take a step if one is due, and draw."""
        self.viewer._serve_page()
        if self.viewer.time.takes_step():
            self.env.step(self._noise * torch.randn(self._shape))
            self.viewer.after_step()

    def pixel_of_robot(self) -> tuple[float, float]:
        """Where the chosen environment's robot is on the page, as long as nobody has turned the camera [px]."""
        viewer = self.viewer
        root = viewer.scene.root_of(viewer.envs.chosen)
        camera = next(iter(viewer.server.get_clients().values())).camera
        point = viewer.camera.to_scene(viewer.scene.body_q[root, :3])
        x, y, z = camera_axes(camera.position, camera.look_at).T @ (point - camera.position)
        scale = 0.5 * camera.image_height / math.tan(0.5 * camera.fov)
        return 0.5 * camera.image_width - scale * x / z, 0.5 * camera.image_height + scale * y / z


def forest(page: LivePage, show: Show, save: Callable[[str], None]) -> None:
    """A robot between trees."""
    page.wait(12.0)
    save("viewer_forest.jpg")


def push(page: LivePage, show: Show, save: Callable[[str], None]) -> None:
    """A command by hand, with its arrow, and a body that is dragged."""
    page.click(page.tab("Act"))
    page.type_number("lin_vel_x", 0.8)
    page.type_number("lin_vel_y", -0.3)
    page.wait(2.0)
    held = show.pixel_of_robot()
    page.drag(held, (held[0] + 130.0, held[1] - 190.0))
    page.wait(2.5)
    save("viewer_push.jpg")
    page.release()


def plots(page: LivePage, show: Show, save: Callable[[str], None]) -> None:
    """Rewards by term, and the positions of the joints."""
    show.viewer.envs.way.value = "this one"
    panel = show.viewer.plots
    assert panel is not None  # it is an environment
    panel.plots[1].choice.value = next(name for name in panel.names if name.startswith("contact force"))
    page.click(page.tab("Plots"))
    page.wait(14.0)
    save("viewer_plots.jpg")


def sensors(page: LivePage, show: Show, save: Callable[[str], None]) -> None:
    """A height scan, contact forces and a command on rough ground."""
    page.click(page.tab("Act"))
    page.type_number("lin_vel_x", 0.9)
    page.click(page.tab("View"))
    for name, box in show.viewer.overlays.boxes.items():
        box.value = not name.startswith("markers")
    page.wait_for(lambda: page.page.get_by_label("rays: height_scanner").is_checked(), "the checkboxes")
    page.wait(8.0)
    save("viewer_sensors.jpg")


SCENES: dict[str, tuple[Callable[[], Show], Callable[[LivePage, Show, Callable[[str], None]], None]]] = {
    "push": (lambda: Show("Stripe-Velocity-Flat-Quadruped-v0", 4), push),
    "plots": (lambda: Show("Stripe-Velocity-Flat-Quadruped-v0", 4, noise=0.8), plots),
    "forest": (lambda: Show("Stripe-Forest-Walk-Quadruped-Play-v0", 1, cfg=BESIDE), forest),
    "sensors": (lambda: Show("Stripe-Velocity-Rough-Quadruped-v0", 4), sensors),
}
"""What is built, and what is shown of it, by name."""


# -- the panels of four commands, side by side

PANEL = 388, 780
"""Width and height of a panel, at the right of the window [px]."""
TRAINED = "Stripe-Cartpole-v0"


@contextlib.contextmanager
def command(folder: str, *words: str) -> Iterator[LivePage]:
    """The page of a command that shows something; the command ends with it."""
    args = [sys.executable, "-m", "stripe_newton", *words, "--viewer", "viser", "--port", "18750"]
    with subprocess.Popen(args, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None  # it is a pipe
            url = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
            with open_page(url, lambda: None, SIZE) as page:
                yield page
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate()


def panel(page: LivePage) -> Image.Image:
    """What the page has at its right."""
    picture = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
    return picture.crop((picture.width - PANEL[0], 0, picture.width, PANEL[1]))


def four_panels(out: Path) -> None:
    """Joints of a robot's file, a camera, a training and the checkpoints that it wrote."""
    parts: list[Image.Image] = []
    with tempfile.TemporaryDirectory() as folder:
        with command(folder, "inspect", str(Path(QUADRUPED_CFG.spawn.usd_path).resolve())) as page:
            page.click(page.tab("Joints"))
            page.wait(2.0)
            parts.append(panel(page))
        with command(folder, "play", "Stripe-Cartpole-Camera-Direct-v0", "--agent", "zero", "--num-envs", "4") as page:
            page.wait(4.0)
            parts.append(panel(page))
        train = "train", TRAINED, "--num-envs", "64", "--agent.save-interval", "50", "--max-iterations", "400"
        with command(folder, *train) as page:
            page.click(page.tab("Plots"))
            page.wait(30.0)
            parts.append(panel(page))
        run = str(next(Path(folder, "logs").glob("*/*")))
        with command(folder, "play", TRAINED, "--checkpoint", run, "--num-envs", "4") as page:
            page.click(page.tab("Policy"))
            page.click(page.page.get_by_label("Checkpoint", exact=True))
            page.wait(2.0)
            parts.append(panel(page))
    size = 304, round(304 * PANEL[1] / PANEL[0])
    picture = Image.new("RGB", (size[0] * len(parts), size[1]))
    for number, part in enumerate(parts):
        picture.paste(part.resize(size, Image.Resampling.LANCZOS), (number * size[0], 0))
    picture.save(out / "viewer_panels.jpg", quality=80)


def save(page: LivePage, folder: Path, file: str) -> None:
    """Write a screenshot."""
    page.save(folder / file, quality=72)


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the pictures")
    names = [*SCENES, "panels"]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="scenes, by default all")
    args = parser.parse_args()
    for name in args.only:
        if name == "panels":
            four_panels(args.out)
            continue
        build, scene = SCENES[name]
        show = build()
        try:
            with open_page(show.viewer.url, show.serve, SIZE) as page:
                scene(page, show, partial(save, page, args.out))
        finally:
            show.viewer.close()
            show.env.close()
        print(name, flush=True)


if __name__ == "__main__":
    main()
