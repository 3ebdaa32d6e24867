# SPDX-License-Identifier: Apache-2.0
"""Frame transformer: poses of frames on bodies, relative to another frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton
import warp as wp

from stripe_kernels.sensors import frame as kernels
from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.value_types import NonNegativeInt

from . import prim_paths
from .clock import SensorClock
from .sensor_base import SensorBase, SensorBaseCfg
from .sensor_data import SensorData
from .sensor_outputs import SensorOutputs, output_problems

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["FrameCfg", "FrameTransformer", "FrameTransformerCfg"]

_NOISY_OUTPUTS = "source_pos_w", "target_pos_w", "target_pos_source"
"""Outputs that may have noise."""


@configclass
class FrameCfg:
    """A target frame, or several where ``prim_path`` is an expression that several bodies or sites match."""

    prim_path: str = MISSING
    """Body or site; the last part may be an expression."""
    name: str | None = None
    """Name of the frame; by default that of the body or site."""
    offset: prim_paths.OffsetCfg = prim_paths.OffsetCfg()
    """The frame relative to that of the body or site."""


_Target = FrameCfg  # below, FrameCfg is the attribute of the class


def _frame_transformer(cfg: FrameTransformerCfg) -> FrameTransformer:
    return FrameTransformer(cfg)


@configclass
class FrameTransformerCfg(SensorBaseCfg):
    """Poses of target frames, seen from a source frame on the body or site that ``prim_path`` names."""

    FrameCfg: ClassVar[type] = FrameCfg
    OffsetCfg: ClassVar[type] = prim_paths.OffsetCfg

    class_type: Callable[..., SensorBase] | None = _frame_transformer
    """Class that the scene makes of this config."""
    target_frames: Sequence[_Target] = MISSING
    """The target frames."""
    source_frame_offset: prim_paths.OffsetCfg = prim_paths.OffsetCfg()
    """The source frame relative to that of the body or site."""
    noise: Mapping[str, NoiseCfg | NoiseModelCfg] = {}
    """Noise by output, such as ``{"target_pos_source": GaussianNoiseCfg(std=0.01)}``; positions alone may have it. A
    noise model draws its bias at the start of an episode."""
    delay: NonNegativeInt = 0
    """Age of all outputs, in measurements."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.target_frames is not MISSING and not self.target_frames:
            yield "target_frames", "is empty, must have one frame at least"
        what = "a frame transformer"
        yield from output_problems(self.noise, self.history_length, _NOISY_OUTPUTS, what)


class FrameTransformerData(SensorData):
    """Positions [m] and quaternions (x, y, z, w), as tensors.

    Attributes:
        target_frame_names: Names of the target frames, in the order of the tensors.
    """

    target_frame_names: list[str]


class FrameTransformer(SensorBase):
    """Poses of target frames in the world and in a source frame.

    ``data`` has ``source_pos_w``, ``source_quat_w``, ``target_pos_w``, ``target_quat_w``, ``target_pos_source`` and
    ``target_quat_source``; see the struct :class:`stripe_kernels.sensors.frame.FrameTransformerData`.

    Newton's ``SensorFrameTransform`` gives the relative poses alone, in two launches, between sites that the solver
    then carries along; this gives all six in one launch.

    Attributes:
        target_frame_names: Names of the target frames, in the order of the data.
    """

    cfg: FrameTransformerCfg
    data: FrameTransformerData
    struct: kernels.FrameTransformerData

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        source = prim_paths.find_frames(template, self.cfg.prim_path, f"{where}.prim_path")
        if len(source) > 1:
            names = ", ".join(f.name for f in source)
            raise ConfigError([f"{where}.prim_path: {names} match, it must name one source frame"])
        targets = self._find_targets(template, where)
        self.target_frame_names = [f.name for f in targets]
        twice = {n for n in self.target_frame_names if self.target_frame_names.count(n) > 1}
        if twice:
            raise ConfigError([f"{where}.target_frames: {', '.join(sorted(twice))} is there twice, give each its name"])
        # The source is the first of the frames, which the kernel knows.
        self._frames = [source[0].at(self.cfg.source_frame_offset), *targets]

    def _find_targets(self, template: newton.ModelBuilder, where: str) -> list[prim_paths.Frame]:
        targets = []
        for index, cfg in enumerate(self.cfg.target_frames):
            at = f"{where}.target_frames[{index}]"
            found = prim_paths.find_frames(template, cfg.prim_path, f"{at}.prim_path")
            if cfg.name and len(found) > 1:
                names = ", ".join(f.name for f in found)
                raise ConfigError([f"{at}.name: is '{cfg.name}', but {names} match the path; leave the name out"])
            targets += [f.at(cfg.offset, cfg.name or "") for f in found]
        return targets

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        self._clock = SensorClock(sim, self.cfg.update_period, type(self).__name__)
        self._shape = shape = self.num_envs, len(self.target_frame_names)
        fields: dict[str, tuple[type, int | None]] = {"source_pos_w": (wp.vec3, None), "source_quat_w": (wp.quat, None)}
        for frame in ("w", "source"):
            fields |= {f"target_pos_{frame}": (wp.vec3, shape[1]), f"target_quat_{frame}": (wp.quat, shape[1])}
        where = f"{type(self).__name__} '{self.cfg.prim_path}'.noise"
        with wp.ScopedDevice(self.device):
            self._outputs = SensorOutputs(
                kernels.FrameTransformerData, fields, self.num_envs, self.cfg.noise, self.cfg.delay, where
            )
            self._inputs = [
                wp.array([f.body for f in self._frames], dtype=int),
                wp.array([f.pose for f in self._frames], dtype=wp.transform),
                wp.array(sim.env_origins, dtype=wp.vec3),  # as built: for sites on no body, which stay there
                wp.from_torch(sim.per_env(sim.state.body_q), dtype=wp.transform),
            ]
        self.struct = self._outputs.struct
        self.data = FrameTransformerData(self.struct)
        self.data.target_frame_names = self.target_frame_names

    @property
    def body_names(self) -> list[str]:
        """Names of the target frames: terms choose among them by ``body_names``."""
        return list(self.target_frame_names)

    @property
    def counts(self) -> dict[str, int]:
        return {"num_frames": len(self.target_frame_names)}

    @property
    def arrays(self) -> dict[str, wp.array]:
        return self._outputs.arrays | self._clock.arrays

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
        # Only environments that were reset: the others have measured this step, and a noise would be drawn twice.
        self._launch_measurement(self._clock.restarted)
        self._clock.settle()
