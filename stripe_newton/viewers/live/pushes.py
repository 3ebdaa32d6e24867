# SPDX-License-Identifier: Apache-2.0
"""Pushes: forces on bodies that somebody drags, and kicks to the robot of the chosen environment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp

from stripe_newton.viewers.poses import rotate

from .camera_control import CameraControl
from .inbox import Inbox
from .live_scene import LiveScene, ShapeBatch
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["Drag", "Pushes"]

_KEY = "cmd/ctrl"
_DAMPING = 1.0
"""Damping of the spring, as a share of the critical one."""


@dataclass
class Drag:
    """A body that is dragged."""

    env_id: int
    body: int
    """Its row among the bodies of its environment."""
    anchor: np.ndarray
    """Where it is held, in its frame [m], shape ``(3,)``."""
    target: np.ndarray
    """Where to, in the world frame [m], shape ``(3,)``."""


class Pushes:
    """Ctrl and the left button drag a body by a spring; a button kicks the robot.

    Args:
        gui: Where the inputs go.
        inbox: Carries events to the simulation's thread.
        env: The environment.
        camera: Says where the world is in the scene.
        chosen: The environment by number that is kicked.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        inbox: Inbox,
        env: ViewedEnv,
        camera: CameraControl,
        chosen: Callable[[], int],
    ):
        self._inbox, self._env, self._camera, self._chosen = inbox, env, camera, chosen
        self._sim: Any = env.sim
        self._drag: Drag | None = None
        self._generator = np.random.default_rng(0)
        with gui.add_folder("Pushes"):
            gui.add_markdown("Hold **Ctrl** (or Cmd) and drag a body.")
            self.strength = gui.add_slider(
                "Strength", 1, 400, 1, initial_value=60, hint="Stiffness of the spring by the robot's mass [1/s^2]"
            )
            has_robot = self._robot() is not None
            self.kick_speed = gui.add_slider(
                "Kick", 0.1, 5.0, 0.1, initial_value=1.0, hint="Change of velocity [m/s]", visible=has_robot
            )
            self.kick_button = gui.add_button(
                "Kick", icon="shoe", hint="In a random level direction", visible=has_robot
            )
        inbox.on_click(self.kick_button, self.kick)

    # -- dragging

    @property
    def is_dragging(self) -> bool:
        """Whether somebody drags a body now; the camera then stands still, as the target is where the pointer is."""
        return self._drag is not None

    def attach(self, scene: LiveScene) -> None:
        """Let the moving shapes of a scene be dragged."""
        self._scene = scene
        for batch in scene.batches:
            if (batch.bodies >= 0).any():
                self._attach(batch)

    def _attach(self, batch: ShapeBatch) -> None:
        async def dragged(event: viser.SceneNodeDragEvent[Any]) -> None:  # in order, which plain functions are not
            body = int(batch.bodies[event.instance_index or 0])
            start, end = np.array(event.start_position), np.array(event.end_position)
            self._inbox.put(lambda: self._handle(event.phase, body, start, end))

        batch.handle.on_drag("left", modifier=_KEY)(dragged)

    def _handle(self, phase: str, display_body: int, start: np.ndarray, end: np.ndarray) -> None:
        """Begin, move or end a drag; points are in the scene."""
        env_id, body = self._scene.body_of(display_body)
        if phase == "end" or env_id < 0:
            self.end_drag()
            return
        if phase == "start" or self._drag is None:
            pose = self._scene.body_q[display_body]
            back = rotate((pose[None, 3:] * (-1.0, -1.0, -1.0, 1.0)), (self._camera.to_world(start) - pose[:3])[None])
            self.begin_drag(env_id, body, back[0], self._camera.to_world(end))
        self._drag.target = self._camera.to_world(end)  # type: ignore[union-attr]  # which began above

    def begin_drag(self, env_id: int, body: int, anchor: np.ndarray, target: np.ndarray) -> None:
        """Drag a body.

        Args:
            env_id: Its environment.
            body: Its row among the bodies of the environment.
            anchor: Where it is held, in its frame [m], shape ``(3,)``.
            target: Where it is dragged to, in the world frame [m], shape ``(3,)``.
        """
        self.end_drag()
        self._sim.enable_external_wrench()
        self._drag = Drag(env_id, body, np.asarray(anchor, dtype=float), np.asarray(target, dtype=float))
        self.before_step()

    def end_drag(self) -> None:
        """Let go of the body."""
        drag, self._drag = self._drag, None
        if drag is not None:
            self._write(drag, np.zeros(6))

    def before_step(self) -> None:
        """Compute the spring's force for the next step."""
        if (drag := self._drag) is None:
            return
        row, model = self._row(drag), self._sim.model
        pose = self._sim.state.body_q[row : row + 1].numpy()[0].astype(float)
        speed = self._sim.state.body_qd[row : row + 1].numpy()[0].astype(float)
        com = rotate(pose[None, 3:], model.body_com[row : row + 1].numpy().astype(float))[0]
        arm = rotate(pose[None, 3:], drag.anchor[None])[0] - com
        stretch = drag.target - (pose[:3] + com + arm)
        velocity = speed[:3] + np.cross(speed[3:], arm)
        stiffness = float(self.strength.value)
        mass = self._mass(drag)
        force = mass * (stiffness * stretch - _DAMPING * math.sqrt(stiffness) * velocity)
        if np.isfinite(force).all():
            self._write(drag, np.concatenate([force, np.cross(arm, force)]))

    def _row(self, drag: Drag) -> int:
        """Row of a body in the arrays of the model."""
        return drag.env_id * int(self._sim.template.body_count) + drag.body

    def _mass(self, drag: Drag) -> float:
        """Mass of all that moves in the environment: a spring that moves a robot's foot moves the robot, too [kg]."""
        first = self._row(drag) - drag.body
        return float(self._sim.model.body_mass[first : first + self._sim.template.body_count].numpy().sum())

    def _write(self, drag: Drag, wrench: np.ndarray) -> None:
        """Set the wrench on a body about its centre of mass, in the world frame."""
        row = self._row(drag)
        self._sim.external_wrench[row : row + 1].assign(wrench[None].astype(np.float32))
        in_world: wp.array = self._sim.wrench_in_world
        in_world[row : row + 1].fill_(True)

    # -- kicks

    @torch.no_grad()
    def kick(self) -> None:
        """Change the velocity of the chosen environment's robot in a random level direction."""
        robot = self._robot()
        if robot is None:
            return
        angle, env_id = self._generator.uniform(0.0, 2.0 * math.pi), self._chosen()
        velocity = robot.data.root_vel_w[env_id : env_id + 1].clone()
        velocity[0, 0] += float(self.kick_speed.value) * math.cos(angle)
        velocity[0, 1] += float(self.kick_speed.value) * math.sin(angle)
        robot.write_root_velocity_to_sim(velocity, env_ids=[env_id])

    def _robot(self) -> Any:
        """The first articulation of the scene that is not fixed; None if there is none."""
        robots = getattr(getattr(self._env, "scene", None), "articulations", {})
        return next((robot for robot in robots.values() if not robot.is_fixed_base), None)
