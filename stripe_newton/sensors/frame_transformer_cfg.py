# SPDX-License-Identifier: Apache-2.0
"""Config of the frame transformer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from . import prims
from .frame_transformer import NOISY_OUTPUTS, FrameTransformer
from .outputs import output_problems
from .sensor_base import SensorBaseCfg

__all__ = ["FrameCfg", "FrameTransformerCfg"]


@configclass
class FrameCfg:
    """A target frame, or several where ``prim_path`` is an expression that several bodies or sites match."""

    prim_path: str = MISSING
    """Body or site; the last part may be an expression."""
    name: str | None = None
    """What it is called; by default as the body or site."""
    offset: prims.OffsetCfg = prims.OffsetCfg()
    """The frame relative to that of the body or site."""


_Target = FrameCfg


@configclass
class FrameTransformerCfg(SensorBaseCfg):
    """Poses of target frames, seen from a source frame on the body or site that ``prim_path`` names."""

    FrameCfg: ClassVar[type] = FrameCfg
    OffsetCfg: ClassVar[type] = prims.OffsetCfg

    class_type: Callable[..., Any] | None = FrameTransformer
    target_frames: Sequence[_Target] = MISSING
    """The target frames."""
    source_frame_offset: prims.OffsetCfg = prims.OffsetCfg()
    """The source frame relative to that of the body or site."""
    noise: Mapping[str, NoiseCfg | NoiseModelCfg] = {}
    """Noise by output, such as ``{"target_pos_source": GaussianNoiseCfg(std=0.01)}``; positions alone may have it. A
    noise model draws its bias at the start of an episode."""
    delay: int = 0
    """How many measurements old all outputs are."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.target_frames is not MISSING and not self.target_frames:
            yield "target_frames", "is empty, must have one frame at least"
        yield from output_problems(self, NOISY_OUTPUTS, "a frame transformer")
