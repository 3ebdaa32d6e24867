# SPDX-License-Identifier: Apache-2.0
"""Film overlay: task, iteration, reward and velocity command, written into the frames of a video."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

if TYPE_CHECKING:
    from stripe_newton.assets import Articulation
    from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["FilmOverlay"]

_LINES = 26
"""Lines of small text that would fill the height of a frame."""
_COMMANDED, _REACHED = (255, 140, 40), (70, 200, 120)
_TEXT, _QUIET, _BOX = (255, 255, 255), (205, 212, 220), (18, 24, 32, 150)
_SECONDS_AHEAD = 0.7
"""An arrow reaches as far as the robot would get in this time [s]."""
_WIDTH = 0.05
"""Width of an arrow [m]."""
_OVERSAMPLING = 3
"""Samples along each side of a pixel of an arrow."""


class FilmOverlay:
    """Writes into frames what a viewer wants to know of the first environment that they show.

    Above: the task and a note, such as the iteration. Below: time, reward of the last step and return of the episode.
    If the task has a velocity command, two arrows over the robot show the commanded and the actual velocity.

    Attributes:
        has_numbers: Whether time, reward and return are written.

    Args:
        env: The wrapped environment.
        task: Name of the task.
        note: A second line.
        env_index: Environment whose numbers are shown. None: the one of its config's ``viewer``.
    """

    def __init__(self, env: RslRlVecEnvWrapper, task: str, note: str = "", env_index: int | None = None):
        self._env, self.task, self.note, self.has_numbers = env, task, note, True
        if env_index is None:
            env_index = getattr(getattr(getattr(env.unwrapped, "cfg", None), "viewer", None), "env_index", 0)
        self._index, self._command = env_index, _velocity_command(env.unwrapped)
        self.restart()

    def restart(self) -> None:
        """Begin an episode: time and return are 0."""
        self._steps, self._reward, self._return = 0, 0.0, 0.0

    def after_step(self, rewards: torch.Tensor, dones: torch.Tensor) -> None:
        """Take note of a step.

        Args:
            rewards: Shape ``(num_envs,)``.
            dones: Whether an episode ended, shape ``(num_envs,)``.
        """
        self._reward = float(rewards[self._index])
        self._return, self._steps = self._return + self._reward, self._steps + 1
        if bool(dones[self._index]):
            self._steps, self._return = 0, 0.0

    def draw(self, frame: np.ndarray) -> np.ndarray:
        """A copy of a frame, uint8 (height, width, 3), with the overlay."""
        picture = Image.fromarray(frame)
        if self._command is not None:
            self._draw_arrows(picture, self._command)
        height = picture.height
        font, bold = _font(height, 1.0), _font(height, 1.3)
        line, margin = height // _LINES, height // 36
        head = [(self.task, bold, _TEXT)] + ([(self.note, font, _QUIET)] if self.note else [])
        _write(picture, head, margin, margin, line)
        if self.has_numbers:
            self._write_numbers(picture, font, margin, line)
        if self._command is not None:
            command, reached = (float(torch.linalg.vector_norm(v[:2])) for v in self._command.read(self._index))
            lines = [
                (f"command {command:.2f} m/s", font, _COMMANDED),
                (f"velocity {reached:.2f} m/s", font, _REACHED),
            ]
            width = max(int(font.getlength(text)) for text, *_ in lines)
            _write(picture, lines, picture.width - margin - width - line, height - margin - int(3.2 * line), line)
        return np.asarray(picture)

    def _write_numbers(self, picture: Image.Image, font: ImageFont.FreeTypeFont, margin: int, line: int) -> None:
        seconds = self._steps * float(self._env.unwrapped.step_dt)
        state = f"{seconds:.1f} s  |  reward {self._reward:.2f}  |  return {self._return:.1f}"
        _write(picture, [(state, font, _TEXT)], margin, picture.height - margin - int(1.9 * line), line)

    def _draw_arrows(self, picture: Image.Image, command: _VelocityCommand) -> None:
        renderer = getattr(self._env.unwrapped, "renderer", None)
        # An environment that draws in another way, or whose picture has arrows by `debug_vis`.
        if renderer is None or not hasattr(renderer, "project") or command.is_in_picture:
            return
        start = command.position(self._index)
        wanted, reached = (v.numpy() for v in command.read(self._index))
        for velocity, color in ((reached, _REACHED), (wanted, _COMMANDED)):
            ahead = _SECONDS_AHEAD * np.array([velocity[0], velocity[1], 0.0])
            shape = _arrow(ahead)
            if shape is not None:
                seen = renderer.project(start + shape)
                if np.isfinite(seen).all():
                    _fill(picture, seen, color)


@dataclass
class _VelocityCommand:
    """Commanded and actual velocity of a robot in the world.

    Attributes:
        command: Commands in the robots' frames, shape ``(num_envs, 3)`` [m/s, m/s, rad/s].
        robot: The robot.
        is_in_picture: Whether the picture has arrows of it, as its config's ``debug_vis`` asks for.
    """

    command: torch.Tensor
    robot: Articulation
    is_in_picture: bool = False

    def position(self, index: int) -> np.ndarray:
        """Where arrows begin: above the root [m], shape ``(3,)``."""
        return self.robot.data.root_pose_w[index, :3].cpu().numpy().astype(float) + [0.0, 0.0, 0.14]

    def read(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Commanded and actual velocity, world frame, shape ``(2,)`` [m/s]."""
        x, y, z, w = self.robot.data.root_pose_w[index, 3:7].tolist()
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left, _ = self.command[index].tolist()
        wanted = torch.tensor([c * ahead - s * left, s * ahead + c * left])
        return wanted, self.robot.data.root_lin_vel_w[index, :2].cpu()


def _velocity_command(env: object) -> _VelocityCommand | None:
    """The velocity command of an environment with a command manager, or of a direct one that has ``commands``."""
    manager, scene = getattr(env, "command_manager", None), getattr(env, "scene", None)
    if manager is not None and scene is not None:
        for name in getattr(manager, "active_terms", ()):
            term = manager.get_term(name)
            if hasattr(term, "vel_command_b"):
                robot = scene[getattr(term.cfg, "asset_name", "robot")]
                return _VelocityCommand(term.vel_command_b, robot, bool(getattr(term.cfg, "debug_vis", False)))
    robot = getattr(env, "robot", None)
    for name in ("commands", "_commands"):
        command = getattr(env, name, None)
        if isinstance(command, torch.Tensor) and command.ndim == 2 and command.shape[1] == 3 and robot is not None:
            return _VelocityCommand(command, robot)
    return None


def _arrow(ahead: np.ndarray) -> np.ndarray | None:
    """Outline of a level arrow from the origin to ``ahead`` [m], shape ``(7, 3)``; None if it is too short to see."""
    length = float(np.linalg.norm(ahead))
    if not math.isfinite(length) or length < 0.06:
        return None
    along = ahead / length
    side = np.array([-along[1], along[0], 0.0])
    head, width = min(0.14, 0.5 * length), min(_WIDTH, 0.2 * length)
    corners = [(0.0, 0.5), (length - head, 0.5), (length - head, 1.3), (length, 0.0)]
    corners += [(length - head, -1.3), (length - head, -0.5), (0.0, -0.5)]
    return np.array([u * along + v * width * side for u, v in corners])


def _fill(picture: Image.Image, outline: np.ndarray, color: tuple[int, int, int]) -> None:
    """Fill a polygon, corners (n, 2) [px], with smooth edges and a dark rim."""
    low = np.maximum(np.floor(outline.min(axis=0)) - 3, 0).astype(int)
    high = np.minimum(np.ceil(outline.max(axis=0)) + 3, picture.size).astype(int)
    if (high <= low).any():
        return
    size = tuple(int(n) for n in (high - low))
    large = tuple(_OVERSAMPLING * n for n in size)
    corners = [tuple(map(float, p)) for p in (outline - low) * _OVERSAMPLING]
    for shade, rim in (((15, 18, 24), 2 * _OVERSAMPLING), (color, 0)):
        mask = Image.new("L", large)
        ImageDraw.Draw(mask).polygon(corners, fill=235, outline=200, width=max(rim, 1))
        picture.paste(shade, (int(low[0]), int(low[1])), mask.resize(size, Image.Resampling.BOX))


def _write(
    picture: Image.Image,
    lines: Sequence[tuple[str, ImageFont.FreeTypeFont, tuple[int, int, int]]],
    x: int,
    y: int,
    line: int,
) -> None:
    """Write lines of text on a dark, translucent box whose corner is ``(x, y)`` [px]."""
    box = _box(tuple(lines), line)
    picture.paste(box, (x, y), box)


@lru_cache(maxsize=8)  # most of what is written stays the same from frame to frame
def _box(lines: tuple[tuple[str, ImageFont.FreeTypeFont, tuple[int, int, int]], ...], line: int) -> Image.Image:
    """Lines of text on a dark, translucent box."""
    width = max(int(font.getlength(text)) for text, font, _ in lines) + line
    heights = [int(1.3 * font.size) for _, font, _ in lines]
    box = Image.new("RGBA", (width, sum(heights) + line // 2), _BOX)
    draw = ImageDraw.Draw(box)
    top = line // 4
    for (text, font, color), height in zip(lines, heights, strict=True):
        draw.text((line // 2, top), text, font=font, fill=color)
        top += height
    return box


@lru_cache(maxsize=8)
def _font(height: int, scale: float) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(max(9.0, scale * 0.78 * height / _LINES))
