# SPDX-License-Identifier: Apache-2.0
"""Scene querier: reads a built scene, its states, sensors and contacts."""

from __future__ import annotations

import torch
import warp as wp
from newton.sensors import SensorContact

from stripe_newton.assets import BoundAsset
from stripe_newton.sim.contact_probe import ContactProbe

from .scene_contents import SceneContents

__all__ = ["SceneQuerier"]


class SceneQuerier:
    """Reads a built scene. What it returns is a copy, unless said otherwise.

    Where a scene has one articulation, its name may be left out.
    """

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self._contact_sensor: SensorContact | None = None
        self._probe: ContactProbe | None = None

    def get_robot_state(self, name: str | None = None, is_relative: bool = False) -> dict[str, torch.Tensor]:
        """State of an articulation or rigid object.

        Args:
            name: Its name in the scene; by default the only articulation.
            is_relative: Positions relative to the environments' origins.

        Returns:
            ``root_pose`` (num_envs, 7), ``root_velocity`` (num_envs, 6), and for an articulation ``joint_position`` and
            ``joint_velocity`` (num_envs, num_joints); world frame, SI units.

        Raises:
            KeyError: if the scene has no asset of that name, or none is given and it has not exactly one articulation.
        """
        name = self._name(name)
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

    def get_sensor_data(self, name: str | None = None) -> dict[str, torch.Tensor]:
        """Data of a sensor by field, such as ``"net_forces_w"``; by default of all sensors, as ``"SENSOR.FIELD"``.

        Fields that the sensor does not measure are left out.

        Raises:
            KeyError: if there is no such sensor.
        """
        sensors = self._scene.sensors
        if name is None:
            return {f"{n}.{field}": value for n in sensors for field, value in self.get_sensor_data(n).items()}
        if name not in sensors:
            raise KeyError(f"no sensor '{name}'; the scene has {', '.join(sensors) or 'none'}")
        return {field: value.clone() for field, value in sensors[name].data.tensors().items()}

    def get_contact_forces(self, name: str | None = None) -> torch.Tensor:
        """Net contact force on each body of an asset, world frame [N].

        They are those of the last step where ``SimulationCfg(contact_forces=True)`` exports them in each. Otherwise a
        physics step from the present state is computed and undone.

        Args:
            name: The asset; by default the only articulation.

        Returns:
            Shape ``(num_envs, num_bodies, 3)``.

        Raises:
            KeyError: if the scene has no asset of that name, or none is given and it has not exactly one articulation.
            ValueError: if the solver reports no contact forces.
        """
        asset, sim = self._asset(self._name(name)), self._scene.sim
        if not sim.cfg.contact_forces and self._probe is None:
            self._probe = ContactProbe(sim)
        if self._contact_sensor is None:
            # One sensor of all bodies, made at the first call: it allocates, and few scenes ask for forces.
            bodies = list(range(sim.model.body_count))
            with wp.ScopedDevice(sim.device):
                self._contact_sensor = SensorContact(
                    sim.model, sensing_bodies=bodies, measure_total=True, request_contact_attributes=False
                )
        contacts, observables = sim.contacts, sim.observables
        if self._probe is not None:
            self._probe.run()
            contacts, observables = self._probe.contacts, self._probe.observables
        self._contact_sensor.update(sim.state, contacts, observables=observables)
        forces = wp.to_torch(self._contact_sensor.total_force).view(sim.num_envs, -1, 3)
        return forces[:, asset.layout.bodies].clone()

    def _name(self, name: str | None) -> str:
        """The name that was given, or that of the only articulation."""
        robots = list(self._scene.articulations)
        if name is None and len(robots) != 1:
            raise KeyError(f"the scene has {', '.join(robots) or 'no articulation'}; give the name of one asset")
        return robots[0] if name is None else name

    def _asset(self, name: str) -> BoundAsset:
        """The articulation or rigid object of a name."""
        assets: dict[str, BoundAsset] = {**self._scene.articulations, **self._scene.rigid_objects}
        if name not in assets:
            raise KeyError(f"no articulation or rigid object '{name}'; the scene has {', '.join(assets) or 'none'}")
        return assets[name]
