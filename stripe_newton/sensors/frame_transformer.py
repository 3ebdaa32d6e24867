# SPDX-License-Identifier: Apache-2.0
"""Poses of frames on bodies, relative to another frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from stripe_kernels.sensors import frame as kernels
from stripe_newton.configclass import ConfigError

from .clock import SensorClock
from .outputs import Outputs
from .prims import find_frames
from .sensor_base import SensorBase
from .sensor_data import SensorData

if TYPE_CHECKING:
    import newton

    from stripe_newton.sim import Simulation

    from .frame_transformer_cfg import FrameTransformerCfg

__all__ = ["NOISY_OUTPUTS", "FrameTransformer"]

NOISY_OUTPUTS = "source_pos_w", "target_pos_w", "target_pos_source"
"""Outputs that may have noise."""


class FrameTransformer(SensorBase):
    """Poses of target frames in the world and in a source frame.

    ``data`` has ``source_pos_w``, ``source_quat_w``, ``target_pos_w``, ``target_quat_w``, ``target_pos_source`` and
    ``target_quat_source``; see the struct :class:`stripe_kernels.sensors.frame.FrameTransformerData`.

    Newton's ``SensorFrameTransform`` gives the relative poses alone, in two launches, between sites that the solver
    then carries along; this gives all six in one launch.

    Attributes:
        cfg: The config.
        struct: What terms read.
        target_frame_names: Names of the target frames, in the order of the data.
    """

    cfg: FrameTransformerCfg
    struct: Any

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        source = find_frames(template, self.cfg.prim_path, f"{where}.prim_path")
        if len(source) > 1:
            names = ", ".join(f.name for f in source)
            raise ConfigError([f"{where}.prim_path: {names} match, it must name one source frame"])
        targets = []
        for index, cfg in enumerate(self.cfg.target_frames):
            at = f"{where}.target_frames[{index}]"
            found = find_frames(template, cfg.prim_path, f"{at}.prim_path")
            if cfg.name and len(found) > 1:
                names = ", ".join(f.name for f in found)
                raise ConfigError([f"{at}.name: is '{cfg.name}', but {names} match the path; leave the name out"])
            targets += [f.at(cfg.offset, cfg.name or "") for f in found]
        self.target_frame_names = [f.name for f in targets]
        twice = {n for n in self.target_frame_names if self.target_frame_names.count(n) > 1}
        if twice:
            raise ConfigError([f"{where}.target_frames: {', '.join(sorted(twice))} is there twice, give each its name"])
        self._frames = [source[0].at(self.cfg.source_frame_offset), *targets]

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        self._clock = SensorClock(sim, self.cfg.update_period, type(self).__name__)
        self._shape = shape = self.num_envs, len(self.target_frame_names)
        fields: dict[str, tuple[Any, int | None]] = {"source_pos_w": (wp.vec3, None), "source_quat_w": (wp.quat, None)}
        for frame in ("w", "source"):
            fields |= {f"target_pos_{frame}": (wp.vec3, shape[1]), f"target_quat_{frame}": (wp.quat, shape[1])}
        where = f"{type(self).__name__} '{self.cfg.prim_path}'.noise"
        with wp.ScopedDevice(self.device):
            self._outputs = Outputs(
                kernels.FrameTransformerData, fields, self.num_envs, self.cfg.noise, self.cfg.delay, where
            )
            self._inputs = [
                wp.array([f.body for f in self._frames], dtype=int),
                wp.array([f.pose for f in self._frames], dtype=wp.transform),
                wp.array(sim.env_origins, dtype=wp.vec3),
                wp.from_torch(sim.per_env(sim.state.body_q), dtype=wp.transform),
            ]
        self.struct = self._outputs.struct
        self._data = _Data(self.struct)
        self._data.target_frame_names = self.target_frame_names

    @property
    def data(self) -> Any:
        """Positions [m] and quaternions (x, y, z, w), as tensors, and ``target_frame_names``."""
        return self._data

    @property
    def body_names(self) -> list[str]:
        """Names of the target frames: terms choose among them by ``body_names``."""
        return list(self.target_frame_names)

    @property
    def counts(self) -> dict[str, int]:
        return {"num_frames": len(self.target_frame_names)}

    def _launch_measurement(self, where: wp.array) -> None:
        wp.launch(kernels.measure_frames, dim=self._shape, inputs=[where, *self._inputs], outputs=[self._outputs.raw])
        self._outputs.launch(where)

    def launch_measured(self) -> None:
        self._launch_measurement(self._clock.due)
        self._clock.advance()

    def launch_reset(self, env_mask: wp.array) -> None:
        self._clock.restart(env_mask)
        self._outputs.restart(env_mask)

    def launch_observed(self) -> None:
        self._launch_measurement(self._clock.restarted)
        self._clock.settle()

    @property
    def arrays(self) -> dict[str, wp.array]:
        """What lasts from step to step, by name."""
        return self._outputs.arrays | self._clock.arrays


class _Data(SensorData):
    target_frame_names: list[str]
