# SPDX-License-Identifier: Apache-2.0
"""An inertial measurement unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from stripe_kernels.sensors import imu as kernels
from stripe_newton.configclass import ConfigError

from .clock import SensorClock
from .outputs import Outputs
from .prims import find_frames
from .sensor_base import SensorBase
from .sensor_data import SensorData

if TYPE_CHECKING:
    import newton

    from stripe_newton.sim import Simulation

    from .imu_cfg import ImuCfg

__all__ = ["NOISY_OUTPUTS", "Imu"]

_FIELDS = {
    "pos_w": wp.vec3,
    "quat_w": wp.quat,
    "lin_vel_b": wp.vec3,
    "ang_vel_b": wp.vec3,
    "lin_acc_b": wp.vec3,
    "ang_acc_b": wp.vec3,
    "projected_gravity_b": wp.vec3,
}
NOISY_OUTPUTS = tuple(name for name in _FIELDS if name != "quat_w")
"""Outputs that may have noise."""


class Imu(SensorBase):
    """Pose, velocities and accelerations of a frame that is fixed to a body, ``(num_envs, ...)`` each.

    ``data`` has ``pos_w``, ``quat_w``, ``lin_vel_b``, ``ang_vel_b``, ``lin_acc_b``, ``ang_acc_b`` and
    ``projected_gravity_b``; see the struct :class:`stripe_kernels.sensors.imu.ImuData`.

    Accelerations are differences of velocities, as Isaac Lab has them. Newton's ``SensorIMU`` reads the solver's
    ``body_qdd`` instead, for which MuJoCo Warp passes over the whole tree in every physics step, which some solvers do
    not report, and which is of the old episode after a reset; it gives two of the seven outputs.

    Attributes:
        cfg: The config.
        struct: What terms read.
    """

    cfg: ImuCfg
    struct: Any

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        where = f"{type(self).__name__} '{self.cfg.prim_path}'.prim_path"
        frames = find_frames(template, self.cfg.prim_path, where)
        if len(frames) > 1:
            raise ConfigError([f"{where}: {', '.join(f.name for f in frames)} match, it must name one"])
        if frames[0].body < 0:
            raise ConfigError([f"{where}: the site is on no body, it would measure nothing"])
        self._frame = frames[0].at(self.cfg.offset)
        self.every_substep = self.cfg.substeps

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        name = type(self).__name__
        self._clock = SensorClock(sim, self.cfg.update_period, name)
        step = sim.physics_dt * (1 if self.every_substep else sim.decimation)
        with wp.ScopedDevice(self.device):
            where = f"{name} '{self.cfg.prim_path}'.noise"
            fields = {field: (kind, None) for field, kind in _FIELDS.items()}
            self._outputs = Outputs(kernels.ImuData, fields, self.num_envs, self.cfg.noise, self.cfg.delay, where)
            self._elapsed = wp.full(1, value=step, dtype=float)
            self._previous = wp.zeros(self.num_envs, dtype=wp.spatial_vector)
        self.struct = self._outputs.struct
        self._data = SensorData(self.struct)
        model, state, bias = sim.model, sim.state, wp.vec3(*self.cfg.gravity_bias)
        self._mounted = [self._frame.body, self._frame.pose, bias]
        self._state = [
            wp.from_torch(sim.per_env(model.body_com), dtype=wp.vec3),
            model.gravity,
            wp.from_torch(sim.per_env(state.body_q), dtype=wp.transform),
            wp.from_torch(sim.per_env(state.body_qd), dtype=wp.spatial_vector),
        ]

    @property
    def data(self) -> Any:
        """What it measures, as tensors."""
        return self._data

    @property
    def body_names(self) -> list[str]:
        return [self._frame.name]

    def _launch_measurement(self) -> None:
        inputs = [self._clock.due, *self._mounted, self._elapsed, *self._state]
        wp.launch(kernels.measure_imu, dim=self.num_envs, inputs=inputs, outputs=[self._previous, self._outputs.raw])

    def launch_substep(self) -> None:
        self._launch_measurement()

    def launch_measured(self) -> None:
        if not self.every_substep:
            self._launch_measurement()
        self._outputs.launch(self._clock.due)
        self._clock.advance()

    def launch_reset(self, env_mask: wp.array) -> None:
        self._clock.restart(env_mask)
        self._outputs.restart(env_mask)

    def launch_observed(self) -> None:
        began = self._clock.restarted
        inputs = [began, *self._mounted, *self._state]
        wp.launch(kernels.restart_imu, dim=self.num_envs, inputs=inputs, outputs=[self._previous, self._outputs.raw])
        self._outputs.launch(began)
        self._clock.settle()

    def update(self, dt: float) -> None:
        """Measure, after ``dt`` seconds of physics; for scripts and environments with torch hooks."""
        if not self.every_substep:
            self._elapsed.fill_(dt)
        super().update(dt)

    @property
    def arrays(self) -> dict[str, wp.array]:
        """What lasts from step to step, by name."""
        return {"previous": self._previous} | self._outputs.arrays | self._clock.arrays
