# SPDX-License-Identifier: Apache-2.0
"""Overlays: commands and measurements of sensors drawn into the live view, each with a checkbox."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch

from stripe_newton.viewers.viewed_simulation import ViewedSimulation

from .inbox import Inbox
from .live_scene import ROOT
from .marker_batches import MarkerBatches
from .poses import compose, rotate, wxyz, yaw_of
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["Overlays"]

_COMMANDED, _ACTUAL = (255, 67, 5), (15, 147, 48)
_HIT, _RAY, _FORCE = (200, 10, 4), (220, 105, 10), (185, 4, 50)
"""Linear, as browsers take them; velocities have the colours of films."""
_LIFT = 0.012
"""Height of points above the ground that they are on [m]."""
_SHORTEST = 0.08
"""Length below which an arrow is not drawn, as it would be all head [m]."""
_ABOVE = 0.35
"""Height of the arrows of velocities above the root [m]."""
_PER_WEIGHT = 0.5
"""Length of an arrow of a force as large as the robot's weight [m]."""
_GRAVITY = 9.81


class Layer(Protocol):
    """Something that is drawn, or not."""

    name: str
    is_on: bool
    """Whether it is drawn at first."""

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        """Draw it for the shown environments or the chosen one."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide it."""


class _Drawing:
    """A node of the scene that is made at its first use; its points may change in number."""

    def __init__(self, server: viser.ViserServer, name: str):
        self._server, self._path = server, f"{ROOT}/overlay/{name}"
        self._handle: Any = None
        self._count = -1

    def hide(self) -> None:
        """Take it off the scene."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None

    def arrows(self, starts: np.ndarray, ways: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw arrows from ``starts``, ``(n, 3)``, along ``ways``, ``(n, 3)`` [m]."""
        long = np.isfinite(starts).all(axis=1) & (np.linalg.norm(np.nan_to_num(ways), axis=1) > _SHORTEST)
        points = np.stack([starts[long], (starts + ways)[long]], axis=1).astype(np.float32)
        if self._needs(points):
            self._handle = self._server.scene.add_arrows(
                self._path, points, color, shaft_radius=0.012, head_radius=0.03, head_length=0.07
            )

    def points(self, points: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw points, ``(n, 3)`` [m]; those that are not finite are left out."""
        points = points[np.isfinite(points).all(axis=1)].astype(np.float32)
        if self._needs(points):
            self._handle = self._server.scene.add_point_cloud(
                self._path, points, color, point_size=0.018, point_shape="circle", precision="float32"
            )

    def lines(self, starts: np.ndarray, ends: np.ndarray, color: tuple[int, int, int]) -> None:
        """Draw lines between points, ``(n, 3)`` [m]; those that are not finite are left out."""
        fine = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
        points = np.stack([starts[fine], ends[fine]], axis=1).astype(np.float32)
        if self._needs(points):
            self._handle = self._server.scene.add_line_segments(
                self._path, points, color, thickness=1.0, thickness_units="screen"
            )

    def axes(self, poses: np.ndarray, length: float) -> None:
        """Draw frames, poses ``(n, 7)``."""
        poses = poses[np.isfinite(poses).all(axis=1)]
        if len(poses) != self._count or self._handle is None:
            self.hide()
            self._count = len(poses)
            if len(poses):
                self._handle = self._server.scene.add_batched_axes(
                    self._path, wxyz(poses[:, 3:]), poses[:, :3].astype(np.float32),
                    axes_length=length, axes_radius=0.06 * length,
                )  # fmt: skip
            return
        self._handle.batched_positions, self._handle.batched_wxyzs = poses[:, :3].astype(np.float32), wxyz(poses[:, 3:])

    def _needs(self, points: np.ndarray) -> bool:
        """Whether the node has to be made; otherwise its points are set."""
        if self._handle is None or len(points) != self._count:
            self.hide()
            self._count = len(points)
            return len(points) > 0
        if len(points):
            self._handle.points = points
        return False


class Overlays:
    """Checkboxes for all that can be drawn.

    Args:
        server: The web server.
        gui: Where the checkboxes go.
        inbox: Carries changes to the simulation's thread.
        sim: The simulation.
        env: Its environment; None for a scene without one.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        gui: viser.GuiApi,
        inbox: Inbox,
        sim: ViewedSimulation,
        env: ViewedEnv | None,
    ):
        self.layers: dict[str, Layer] = {}
        self.boxes: dict[str, viser.GuiCheckboxHandle] = {}
        for layer in (_Markers(server, sim), *_command_layers(server, env), *_sensor_layers(server, env)):
            self.layers[layer.name] = layer
        self._markers = sim.markers
        self._folder = gui.add_folder("Draw")
        with self._folder:
            for name, layer in self.layers.items():
                self.boxes[name] = gui.add_checkbox(name, initial_value=layer.is_on)
                inbox.on_change(self.boxes[name], layer.set_visible)

    def draw(self, name: str, env_ids: Sequence[int], chosen: int) -> None:
        """Draw a layer if it is switched on.

        Args:
            name: The layer.
            env_ids: The shown environments.
            chosen: The chosen one.
        """
        if name == _Markers.name:  # which may be made at any time
            self.boxes[name].visible = has_markers = len(self._markers) > 0
            self._folder.visible = has_markers or len(self.layers) > 1
        if self.boxes[name].value:
            self.layers[name].update(env_ids, chosen)


class _Markers:
    """Visualization markers of the simulation."""

    name = "markers"
    is_on = True

    def __init__(self, server: viser.ViserServer, sim: ViewedSimulation):
        self._batches = MarkerBatches(server, sim)

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        self._batches.update(env_ids)

    def set_visible(self, visible: bool) -> None:
        self._batches.set_visible(visible)


class _Drawn:
    """Base of layers that consist of drawings."""

    is_on = False

    def __init__(self, server: viser.ViserServer, name: str, parts: int = 1):
        self.name = name
        node = "".join(c if c.isalnum() else "_" for c in name)
        self._drawings = [_Drawing(server, f"{node}_{part}") for part in range(parts)]

    def set_visible(self, visible: bool) -> None:
        """Hide the layer; an update shows it."""
        if not visible:
            for drawing in self._drawings:
                drawing.hide()


# -- commands


def _command_layers(server: viser.ViserServer, env: ViewedEnv | None) -> Iterator[Layer]:
    manager: Any = getattr(env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
        try:
            manager.get_command(name)
        except KeyError:  # a command without numbers
            continue
        term = manager.get_term(name)
        robot = _asset(env, getattr(term.cfg, "asset_name", ""))
        if hasattr(term, "vel_command_b") and robot is not None:
            yield _Velocities(server, name, term, robot)
        elif hasattr(term, "frame") and hasattr(term, "body_pose"):
            yield _Motion(server, name, term, env)
        elif hasattr(term, "pos_command_w"):
            yield _Places(server, name, term)
        elif hasattr(term, "pose_command_b") and robot is not None and getattr(term.cfg, "update", None) is None:
            yield _Poses(server, name, term, robot)


def _asset(env: object, name: str) -> Any:
    try:
        return env.scene[name]  # type: ignore[attr-defined]  # a scene without assets by name raises
    except (AttributeError, KeyError, TypeError):
        return None


class _Velocities(_Drawn):
    """Arrows of the commanded and the actual velocity above each robot."""

    is_on = True

    def __init__(self, server: viser.ViserServer, name: str, term: Any, robot: Any):
        super().__init__(server, f"command {name}", 2)
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


class _Poses(_Drawn):
    """Frames at the commanded poses."""

    is_on = True

    def __init__(self, server: viser.ViserServer, name: str, term: Any, robot: Any):
        super().__init__(server, f"command {name}")
        self._term, self._robot = term, robot

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        ids = list(env_ids)
        roots = np.column_stack([_host(self._robot.data, f, ids) for f in ("root_pos_w", "root_quat_w")])
        goals = compose(roots, self._term.pose_command_b[ids].cpu().numpy().astype(float))
        self._drawings[0].axes(goals, 0.12)


class _Places(_Drawn):
    """Frames at the commanded positions, x along the heading."""

    is_on = True

    def __init__(self, server: viser.ViserServer, name: str, term: Any):
        super().__init__(server, f"command {name}")
        self._term = term

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        ids = list(env_ids)
        heading = self._term.heading_command_w[ids].cpu().numpy().astype(float)
        zero = np.zeros(len(ids))
        turns = np.column_stack([zero, zero, np.sin(0.5 * heading), np.cos(0.5 * heading)])
        self._drawings[0].axes(np.column_stack([self._term.pos_command_w[ids].cpu().numpy(), turns]), 0.4)


class _Motion(_Drawn):
    """Frames of the bodies in the recorded motion."""

    def __init__(self, server: viser.ViserServer, name: str, term: Any, env: Any):
        super().__init__(server, f"command {name}")
        self._term, self._sim = term, env.sim

    def update(self, env_ids: Sequence[int], chosen: int) -> None:
        frame = int(self._term.frame[chosen])
        poses = self._term.body_pose[frame].cpu().numpy().astype(float)
        origins = self._sim.env_origins if self._sim.env_origin is None else self._sim.env_origin.numpy()
        poses[:, :3] += np.asarray(origins[chosen], dtype=float)
        self._drawings[0].axes(poses, 0.08)


# -- sensors


def _sensor_layers(server: viser.ViserServer, env: ViewedEnv | None) -> Iterator[Layer]:
    sensors = getattr(getattr(env, "scene", None), "sensors", {})
    for name, sensor in sensors.items():
        data = sensor.data
        if isinstance(getattr(data, "ray_hits_w", None), torch.Tensor):
            yield _Rays(server, name, sensor)
        elif isinstance(getattr(data, "net_forces_w", None), torch.Tensor):
            yield _Forces(server, name, sensor, env)
        elif isinstance(getattr(data, "target_pos_w", None), torch.Tensor):
            yield _Frames(server, name, sensor)


class _Rays(_Drawn):
    """Points that the rays hit, and the rays themselves where they come from one point."""

    def __init__(self, server: viser.ViserServer, name: str, sensor: Any):
        super().__init__(server, f"rays {name}", 2)
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


class _Forces(_Drawn):
    """Arrows of the contact forces."""

    def __init__(self, server: viser.ViserServer, name: str, sensor: Any, env: Any):
        super().__init__(server, f"contact forces {name}")
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


class _Frames(_Drawn):
    """Frames of a frame transformer."""

    def __init__(self, server: viser.ViserServer, name: str, sensor: Any):
        super().__init__(server, f"frames {name}")
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
