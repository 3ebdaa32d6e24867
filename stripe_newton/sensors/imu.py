# SPDX-License-Identifier: Apache-2.0
"""IMU: pose, velocities and accelerations of a frame on a body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar

import newton
import warp as wp

from stripe_kernels.sensors import imu as kernels
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.value_types import NonNegativeInt

from . import prim_paths
from .clock import SensorClock
from .sensor_base import SensorBase, SensorBaseCfg
from .sensor_data import SensorData
from .sensor_outputs import SensorOutputs, output_problems

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["Imu", "ImuCfg"]

_FIELDS = {
    "pos_w": wp.vec3,
    "quat_w": wp.quat,
    "lin_vel_b": wp.vec3,
    "ang_vel_b": wp.vec3,
    "lin_acc_b": wp.vec3,
    "ang_acc_b": wp.vec3,
    "projected_gravity_b": wp.vec3,
}
_NOISY_OUTPUTS = tuple(name for name in _FIELDS if name != "quat_w")
"""Outputs that may have noise: added to its components it would leave no rotation."""


def _imu(cfg: ImuCfg) -> Imu:
    return Imu(cfg)


@configclass
class ImuCfg(SensorBaseCfg):
    """An IMU on a body; ``prim_path`` names the body, or a site on it."""

    OffsetCfg: ClassVar[type] = prim_paths.OffsetCfg

    class_type: Callable[..., SensorBase] | None = _imu
    """Class that the scene makes of this config."""
    offset: prim_paths.OffsetCfg = prim_paths.OffsetCfg()
    """The IMU's frame relative to that of the body or site."""
    gravity_bias: tuple[float, float, float] = (0.0, 0.0, 9.81)
    """Added to the acceleration, in the world frame [m/s^2]: an accelerometer at rest reads the reaction to gravity.
    Zeros give the acceleration alone."""
    substeps: bool = True
    """Accelerations over the last physics step, as an accelerometer reads them, at a launch for each physics step.
    Otherwise they are means over the environment's step, at one launch."""
    noise: Mapping[str, NoiseCfg | NoiseModelCfg] = {}
    """Noise by output, such as ``{"ang_vel_b": GaussianNoiseCfg(std=0.02)}``; a noise model draws its bias at the start
    of an episode."""
    delay: NonNegativeInt = 0
    """Age of all outputs, in measurements."""
    debug_vis: bool = False
    """Ignored: an IMU is not drawn."""
    IGNORED: ClassVar[dict[str, str]] = {"debug_vis": "an IMU is not drawn"}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        yield from output_problems(self.noise, self.history_length, _NOISY_OUTPUTS, "an IMU")


class Imu(SensorBase):
    """Pose, velocities and accelerations of a frame that is fixed to a body, ``(num_envs, ...)`` each.

    ``data`` has ``pos_w``, ``quat_w``, ``lin_vel_b``, ``ang_vel_b``, ``lin_acc_b``, ``ang_acc_b`` and
    ``projected_gravity_b``; see the struct :class:`stripe_kernels.sensors.imu.ImuData`.

    Accelerations are differences of velocities, as in Isaac Lab. Newton's ``SensorIMU`` reads the solver's ``body_qdd``
    instead and gives two of the seven outputs. MuJoCo Warp computes ``body_qdd`` by a pass over the whole tree in every
    physics step, some solvers do not report it, and after a reset it is of the old episode.
    """

    cfg: ImuCfg
    struct: kernels.ImuData

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        where = f"{type(self).__name__} '{self.cfg.prim_path}'.prim_path"
        frames = prim_paths.find_frames(template, self.cfg.prim_path, where)
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
            self._outputs = SensorOutputs(kernels.ImuData, fields, self.num_envs, self.cfg.noise, self.cfg.delay, where)
            # On the device: a script's update(dt) changes it under a kernel that may be part of a graph.
            self._elapsed = wp.full(1, value=step, dtype=float)
            self._previous = wp.zeros(self.num_envs, dtype=wp.spatial_vector)
        self.struct = self._outputs.struct
        self.data = SensorData(self.struct)
        model, state, bias = sim.model, sim.state, wp.vec3(*self.cfg.gravity_bias)
        self._mounted = [self._frame.body, self._frame.pose, bias]
        # Views of the model and the state: randomised centres of mass and gravity are read as they are.
        self._state = [
            wp.from_torch(sim.per_env(model.body_com), dtype=wp.vec3),
            model.gravity,
            wp.from_torch(sim.per_env(state.body_q), dtype=wp.transform),
            wp.from_torch(sim.per_env(state.body_qd), dtype=wp.spatial_vector),
        ]

    @property
    def body_names(self) -> list[str]:
        return [self._frame.name]

    @property
    def arrays(self) -> dict[str, wp.array]:
        return {"previous": self._previous} | self._outputs.arrays | self._clock.arrays

    def _launch_measurement(self) -> None:
        inputs = [self._clock.due, *self._mounted, self._elapsed, *self._state]
        wp.launch(kernels.measure_imu, dim=self.num_envs, inputs=inputs, outputs=[self._previous, self._outputs.raw])

    def launch_substep(self) -> None:
        self._launch_measurement()

    def launch_measured(self) -> None:
        if not self.every_substep:
            self._launch_measurement()
        # Noise and delay once a step, however many physics steps were measured.
        self._outputs.launch(self._clock.due)
        self._clock.advance()

    def launch_reset(self, env_mask: wp.array) -> None:
        self._clock.restart(env_mask)
        self._outputs.restart(env_mask)

    def launch_observed(self) -> None:
        # The velocities before the reset were of the old episode: no difference with them is an acceleration.
        began = self._clock.restarted
        inputs = [began, *self._mounted, *self._state]
        wp.launch(kernels.restart_imu, dim=self.num_envs, inputs=inputs, outputs=[self._previous, self._outputs.raw])
        self._outputs.launch(began)
        self._clock.settle()

    def update(self, dt: float) -> None:
        if not self.every_substep:
            self._elapsed.fill_(dt)
        super().update(dt)
