# SPDX-License-Identifier: Apache-2.0
"""Layers: commands and measurements of sensors as arrows, points, lines and frames, for pictures and the live view."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch

from .poses import compose, rotate, yaw_of

if TYPE_CHECKING:
    from .viewed_simulation import ViewedSimulation

__all__ = ["Drawing", "Drawn", "HasSimulation", "MakeDrawing", "command_layers", "sensor_layers"]

_COMMANDED, _ACTUAL = (255, 67, 5), (15, 147, 48)
_HIT, _RAY, _FORCE = (200, 10, 4), (220, 105, 10), (185, 4, 50)
"""Linear, as browsers take them; velocities have the colours of films."""
_LIFT = 0.012
"""Height of points above the ground that they are on [m]."""
_ABOVE = 0.35
"""Height of the arrows of velocities above the root [m]."""
_PER_WEIGHT = 0.5
"""Length of an arrow of a force as large as the robot's weight [m]."""
_GRAVITY = 9.81


class HasSimulation(Protocol):
    """An environment. Managers, scene and sensors are there for some only, and are asked for by name."""

    @property
    def sim(self) -> ViewedSimulation:
        """The simulation."""


class Drawing(Protocol):
    """Something that is drawn in the world frame, again and again; the number of its parts may change."""

    def hide(self) -> None:
        """Take it off the scene."""

    def arrows(self, starts: np.ndarray, ways: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw arrows from ``starts``, ``(n, 3)``, along ``ways``, ``(n, 3)`` [m]; very short ones are left out."""

    def points(self, points: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw points, ``(n, 3)`` [m]; those that are not finite are left out."""

    def lines(self, starts: np.ndarray, ends: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw lines between points, ``(n, 3)`` [m]; those that are not finite are left out."""

    def axes(self, poses: np.ndarray, length: float) -> None:
        """Draw frames, poses ``(n, 7)``, with axes of a length [m]."""


MakeDrawing = Callable[[str], Drawing]
"""Makes a drawing by name."""


class Drawn:
    """Base of layers that consist of drawings.

    Attributes:
        name: Name of the layer.
        is_asked: Whether ``debug_vis`` of its config asks for it.
    """

    is_on = False
    """Whether the live view draws it at first."""

    def __init__(self, make: MakeDrawing, name: str, cfg: object, parts: int = 1):
        self.name, self.is_asked = name, bool(getattr(cfg, "debug_vis", False))
        self.is_on = self.is_on or self.is_asked
        node = "".join(c if c.isalnum() else "_" for c in name)
        self._drawings = [make(f"{node}_{part}") for part in range(parts)]

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        """Draw it for the shown environments or the chosen one."""

    def set_visible(self, visible: bool) -> None:
        """Hide the layer; an update shows it."""
        if not visible:
            for drawing in self._drawings:
                drawing.hide()


# -- commands


def command_layers(make: MakeDrawing, env: HasSimulation | None) -> Iterator[Drawn]:
    """Layers of the commands of an environment that can be drawn.

    Args:
        make: Makes a drawing by name.
        env: The environment; None for a scene without one.
    """
    manager: Any = getattr(env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
        try:
            manager.get_command(name)
        except KeyError:  # a command without numbers
            continue
        term = manager.get_term(name)
        robot = _asset(env, getattr(term.cfg, "asset_name", ""))
        if hasattr(term, "vel_command_b") and robot is not None:
            yield _Velocities(make, name, term, robot)
        elif hasattr(term, "frame") and hasattr(term, "body_pose"):
            yield _Motion(make, name, term, env)
        elif hasattr(term, "pos_command_w"):
            yield _Places(make, name, term)
        elif hasattr(term, "pose_command_b") and robot is not None and getattr(term.cfg, "update", None) is None:
            yield _Poses(make, name, term, robot)


def _asset(env: object, name: str) -> Any:
    try:
        return env.scene[name]  # type: ignore[attr-defined]  # a scene without assets by name raises
    except (AttributeError, KeyError, TypeError):
        return None


class _Velocities(Drawn):
    """Arrows of the commanded and the actual velocity above each robot."""

    is_on = True

    def __init__(self, make: MakeDrawing, name: str, term: Any, robot: Any):
        super().__init__(make, f"command: {name}", term.cfg, 2)
        self._term, self._robot = term, robot

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        ids = list(env_ids)
        pose, velocity = (_host(self._robot.data, field, ids) for field in ("root_pos_w", "root_lin_vel_w"))
        turns = _host(self._robot.data, "root_quat_w", ids)
        yaws = np.array([yaw_of(q) for q in turns])
        command = self._term.vel_command_b[ids].cpu().numpy().astype(float)
        c, s = np.cos(yaws), np.sin(yaws)
        ways = np.column_stack(
            [c * command[:, 0] - s * command[:, 1], s * command[:, 0] + c * command[:, 1], np.zeros(len(ids))]
        )
        starts = pose + (0.0, 0.0, _ABOVE)
        self._drawings[0].arrows(starts, 0.6 * ways, _COMMANDED)
        velocity[:, 2] = 0.0
        self._drawings[1].arrows(starts - (0.0, 0.0, 0.05), 0.6 * velocity, _ACTUAL)


class _Poses(Drawn):
    """Frames at the commanded poses."""

    is_on = True

    def __init__(self, make: MakeDrawing, name: str, term: Any, robot: Any):
        super().__init__(make, f"command: {name}", term.cfg)
        self._term, self._robot = term, robot

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        ids = list(env_ids)
        roots = np.column_stack([_host(self._robot.data, f, ids) for f in ("root_pos_w", "root_quat_w")])
        goals = compose(roots, self._term.pose_command_b[ids].cpu().numpy().astype(float))
        self._drawings[0].axes(goals, 0.12)


class _Places(Drawn):
    """Frames at the commanded positions, x along the heading."""

    is_on = True

    def __init__(self, make: MakeDrawing, name: str, term: Any):
        super().__init__(make, f"command: {name}", term.cfg)
        self._term = term

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        ids = list(env_ids)
        heading = self._term.heading_command_w[ids].cpu().numpy().astype(float)
        zero = np.zeros(len(ids))
        turns = np.column_stack([zero, zero, np.sin(0.5 * heading), np.cos(0.5 * heading)])
        self._drawings[0].axes(np.column_stack([self._term.pos_command_w[ids].cpu().numpy(), turns]), 0.4)


class _Motion(Drawn):
    """Frames of the bodies in the recorded motion."""

    def __init__(self, make: MakeDrawing, name: str, term: Any, env: Any):
        super().__init__(make, f"command: {name}", term.cfg)
        self._term, self._sim = term, env.sim

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        frame = int(self._term.frame[chosen])
        poses = self._term.body_pose[frame].cpu().numpy().astype(float)
        origins = self._sim.env_origins if self._sim.env_origin is None else self._sim.env_origin.numpy()
        poses[:, :3] += np.asarray(origins[chosen], dtype=float)
        self._drawings[0].axes(poses, 0.08)


# -- sensors


def sensor_layers(make: MakeDrawing, env: HasSimulation | None) -> Iterator[Drawn]:
    """Layers of the sensors of an environment that can be drawn; arguments as for :func:`command_layers`."""
    sensors = getattr(getattr(env, "scene", None), "sensors", {})
    for name, sensor in sensors.items():
        data = sensor.data
        if isinstance(getattr(data, "ray_hits_w", None), torch.Tensor):
            yield _Rays(make, name, sensor)
        elif isinstance(getattr(data, "net_forces_w", None), torch.Tensor):
            yield _Forces(make, name, sensor, env)
        elif isinstance(getattr(data, "target_pos_w", None), torch.Tensor):
            yield _Frames(make, name, sensor)


class _Rays(Drawn):
    """Points that the rays hit, and the rays themselves where they come from one point."""

    def __init__(self, make: MakeDrawing, name: str, sensor: Any):
        super().__init__(make, f"rays: {name}", getattr(sensor, "cfg", None), 2)
        self._data = sensor.data
        # Parallel rays of a grid start far above; their lines would hide everything.
        self._has_lines = not hasattr(getattr(sensor.cfg, "pattern_cfg", None), "size")
        offset = getattr(getattr(sensor.cfg, "offset", None), "pos", (0.0, 0.0, 0.0))
        self._offset = np.asarray(offset, dtype=float)

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        hits = _host(self._data, "ray_hits_w", [chosen])[0].reshape(-1, 3)
        self._drawings[0].points(hits + (0.0, 0.0, _LIFT), _HIT)
        if self._has_lines:
            turn = _host(self._data, "quat_w", [chosen])
            start = _host(self._data, "pos_w", [chosen]) + rotate(turn, self._offset[None])
            few = hits[:: max(1, len(hits) // 512)]
            self._drawings[1].lines(np.repeat(start, len(few), axis=0), few, _RAY)


class _Forces(Drawn):
    """Arrows of the contact forces."""

    def __init__(self, make: MakeDrawing, name: str, sensor: Any, env: Any):
        super().__init__(make, f"contact forces: {name}", getattr(sensor, "cfg", None))
        self._data, self._sim = sensor.data, env.sim
        mass = float(np.sum(env.sim.template.body_mass)) or 1.0
        self._scale = _PER_WEIGHT / (mass * _GRAVITY)
        self._bodies = _rows_of(env.sim.template.body_label, sensor.body_names, sensor.parent_path)

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        forces = _host(self._data, "net_forces_w", [chosen])[0].reshape(-1, 3)
        count = self._sim.template.body_count
        starts = self._sim.state.body_q[chosen * count : (chosen + 1) * count].numpy()[self._bodies, :3].astype(float)
        ways = self._scale * forces
        length = np.linalg.norm(ways, axis=1, keepdims=True)
        self._drawings[0].arrows(starts, ways * np.minimum(1.0, 1.5 / np.maximum(length, 1e-9)), _FORCE)


class _Frames(Drawn):
    """Frames of a frame transformer."""

    def __init__(self, make: MakeDrawing, name: str, sensor: Any):
        super().__init__(make, f"frames: {name}", getattr(sensor, "cfg", None))
        self._data = sensor.data

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        fields = ("target_pos_w", "target_quat_w")
        self._drawings[0].axes(np.column_stack([_host(self._data, f, [chosen])[0] for f in fields]), 0.1)


def _rows_of(labels: Sequence[str], names: Sequence[str], parent: str) -> list[int]:
    """Bodies of an environment by name; among those of one name, the first below ``parent``, a prim path."""
    owner = parent.rpartition("/")[2]
    rows = []
    for name in names:
        found = [i for i, label in enumerate(labels) if str(label).rpartition("/")[2] == name]
        below = [i for i in found if owner in str(labels[i]).split("/")]
        rows.append((below or found or [0])[0])
    return rows


def _host(data: Any, field: str, ids: list[int]) -> np.ndarray:
    """Rows of a field of some data on the host, float64."""
    return getattr(data, field)[ids].detach().cpu().numpy().astype(float)
