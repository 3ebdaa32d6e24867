# SPDX-License-Identifier: Apache-2.0
"""Scene querier: reads a built scene, its states, sensors and contacts."""

from __future__ import annotations

import torch
import warp as wp
from newton.sensors import SensorContact

from stripe_newton.assets import BoundAsset
from stripe_newton.sensors.sensor_data import SensorData

from .scene_contents import SceneContents

__all__ = ["SceneQuerier"]


class SceneQuerier:
    """Reads a built scene. What it returns is a copy, unless said otherwise."""

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self._contact_sensor: SensorContact | None = None

    def get_robot_state(self, name: str, is_relative: bool = False) -> dict[str, torch.Tensor]:
        """State of an articulation or rigid object.

        Args:
            name: Its name in the scene.
            is_relative: Positions relative to the environments' origins.

        Returns:
            ``root_pose`` (num_envs, 7), ``root_velocity`` (num_envs, 6), and for an articulation ``joint_position`` and
            ``joint_velocity`` (num_envs, num_joints); world frame, SI units.
        """
        data = self._asset(name).native_data
        state = {"root_pose": data.root_pose_w.clone(), "root_velocity": data.root_vel_w.clone()}
        if is_relative:
            state["root_pose"][:, :3] -= self._scene.env_origins
        if name in self._scene.articulations:
            joints = self._scene.articulations[name].native_data
            state["joint_position"] = joints.joint_pos.clone()
            state["joint_velocity"] = joints.joint_vel.clone()
        return state

    def get_state(self, is_relative: bool = False) -> dict[str, dict[str, dict[str, torch.Tensor]]]:
        """States of all assets: ``{"articulation" | "rigid_object": {name: get_robot_state(name)}}``.

        Args:
            is_relative: Positions relative to the environments' origins.
        """
        return {
            "articulation": {n: self.get_robot_state(n, is_relative) for n in self._scene.articulations},
            "rigid_object": {n: self.get_robot_state(n, is_relative) for n in self._scene.rigid_objects},
        }

    def get_sensor_data(self, name: str) -> SensorData:
        """Data of a sensor, as the sensor hands it out.

        Raises:
            KeyError: if there is no such sensor.
        """
        if name not in self._scene.sensors:
            raise KeyError(f"no sensor '{name}'; the scene has {', '.join(self._scene.sensors) or 'none'}")
        return self._scene.sensors[name].data

    def get_contact_forces(self, name: str) -> torch.Tensor:
        """Net contact force on each body of an asset after the last step, world frame [N].

        Needs ``SimulationCfg(contact_forces=True)``.

        Returns:
            Shape ``(num_envs, num_bodies, 3)``.

        Raises:
            RuntimeError: if contact forces are not exported.
        """
        sim = self._scene.sim
        if not sim.cfg.contact_forces:
            raise RuntimeError("contact forces are not exported: set 'contact_forces=True' in SimulationCfg")
        if self._contact_sensor is None:
            # One sensor of all bodies, made at the first call: it allocates, and few scenes ask for forces.
            bodies = list(range(sim.model.body_count))
            with wp.ScopedDevice(sim.device):
                self._contact_sensor = SensorContact(
                    sim.model, sensing_bodies=bodies, measure_total=True, request_contact_attributes=False
                )
        # Newton sums the contacts of the last step: it has to be asked after each step that one wants to know of.
        self._contact_sensor.update(sim.state, sim.contacts, observables=sim.observables)
        forces = wp.to_torch(self._contact_sensor.total_force).view(sim.num_envs, -1, 3)
        return forces[:, self._asset(name).layout.bodies].clone()

    def _asset(self, name: str) -> BoundAsset:
        assets: dict[str, BoundAsset] = {**self._scene.articulations, **self._scene.rigid_objects}
        if name not in assets:
            raise KeyError(f"no articulation or rigid object '{name}'; the scene has {', '.join(assets) or 'none'}")
        return assets[name]
