# SPDX-License-Identifier: Apache-2.0
"""Ray-caster cameras and ray casters over several meshes of the Isaac Lab dialect.

A ray-caster camera is a camera that sees the prims of ``mesh_prim_paths`` alone. A ray caster hits several meshes
anyway. A link stands for its ``visuals`` and ``collisions``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar, TypeVar

from stripe_newton import sensors as native
from stripe_newton.configclass import MISSING, configclass

from .sensors import Camera, CameraCfg, PinholeCameraCfg, RayCaster, RayCasterCfg

__all__ = [
    "MultiMeshRayCaster",
    "MultiMeshRayCasterCamera",
    "MultiMeshRayCasterCameraCfg",
    "MultiMeshRayCasterCfg",
    "RayCasterCamera",
    "RayCasterCameraCfg",
]

_DEPTHS = ("distance_to_image_plane", "distance_to_camera", "normals")
_ONE_TREE = "all shapes are in one tree, which follows those that move"
_LENS = ("focal_length", "horizontal_aperture", "vertical_aperture", "horizontal_aperture_offset",
         "vertical_aperture_offset")  # fmt: skip
C = TypeVar("C", bound="RayCasterCfg | RayCasterCameraCfg")


@configclass
class RaycastTargetCfg:
    """Prims that rays hit."""

    prim_expr: str = MISSING
    """Their path; expressions are allowed."""
    is_shared: bool = False
    merge_prim_meshes: bool = True
    track_mesh_transforms: bool = True

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("is_shared", "merge_prim_meshes", "track_mesh_transforms"), _ONE_TREE
    )


_Target = RaycastTargetCfg  # below, RaycastTargetCfg is the attribute of the classes


_PARTS = re.compile("/(visuals(_xform)?|collisions)$")
"""Prims below a link of NVIDIA's files that hold its meshes. Other files of the same robot have none."""


def _with_paths(cfg: C) -> C:
    """A copy of a config whose targets are paths."""
    made = cfg.copy()
    made.mesh_prim_paths = [_PARTS.sub("", p.prim_expr if isinstance(p, _Target) else p) for p in cfg.mesh_prim_paths]
    return made


# -- rays


class MultiMeshRayCaster(RayCaster):
    """A :class:`RayCaster`, which hits all prims that its config names, those that move among them."""

    def __init__(self, cfg: MultiMeshRayCasterCfg):
        # Parts of the asset that carries it are hit if they are named.
        super().__init__(_with_paths(cfg).replace(exclude_own=False))


@configclass
class MultiMeshRayCasterCfg(RayCasterCfg):
    """Rays that hit several meshes."""

    RaycastTargetCfg: ClassVar[type] = _Target

    class_type: Callable[..., native.SensorBase] | None = MultiMeshRayCaster
    mesh_prim_paths: Sequence[str | _Target] = MISSING
    """Prims that the rays hit: paths or targets."""
    update_mesh_ids: bool = False
    reference_meshes: bool = True

    IGNORED: ClassVar[dict[str, str]] = {"reference_meshes": _ONE_TREE}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.RayCasterCfg.problems(_with_paths(self))
        if self.update_mesh_ids:
            yield "update_mesh_ids", "is True, but hits have no numbers of meshes; set it to False"


# -- cameras


class RayCasterCamera(Camera):
    """A :class:`Camera` that sees the prims that its config names."""

    def __init__(self, cfg: RayCasterCameraCfg):
        cfg.validate()
        super().__init__(cfg.as_camera())


@configclass
class RayCasterCameraCfg(CameraCfg):
    """A camera that sees some prims alone; its lens and its pixels are those of ``pattern_cfg``."""

    class_type: Callable[..., native.SensorBase] | None = RayCasterCamera
    mesh_prim_paths: Sequence[str] = MISSING
    """Prims that are seen."""
    pattern_cfg: native.PinholeCameraPatternCfg = MISSING
    """Lens and pixels."""
    max_distance: float = 1.0e6
    """Largest depth that is seen [m]."""
    data_types: Sequence[str] = ("distance_to_image_plane",)
    width: int = 1
    height: int = 1
    ray_alignment: str = "base"
    attach_yaw_only: bool | None = None
    drift_range: tuple[float, float] = (0.0, 0.0)
    ray_cast_drift_range: Mapping[str, tuple[float, float]] = {}
    visualizer_cfg: object = None

    IGNORED: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("ray_alignment", "attach_yaw_only"), "a camera turns with its body"),
        **dict.fromkeys(("drift_range", "ray_cast_drift_range"), "cameras do not drift"),
        "visualizer_cfg": "sensors draw no markers",
    }

    def as_camera(self) -> RayCasterCameraCfg:
        """A copy with the lens and the pixels of the pattern."""
        made, pattern = _with_paths(self), self.pattern_cfg
        made.width, made.height = pattern.width, pattern.height
        lens = {name: getattr(pattern, name) for name in _LENS}
        made.spawn = PinholeCameraCfg(**lens, clipping_range=(0.0, self.max_distance))
        return made

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.CameraCfg.problems(_with_paths(self))
        wrong = [t for t in self.data_types if t not in _DEPTHS]
        if wrong:
            yield "data_types", f"has {', '.join(map(repr, wrong))}, must be of {', '.join(_DEPTHS)}"


class MultiMeshRayCasterCamera(RayCasterCamera):
    """A :class:`RayCasterCamera`, which sees all prims that its config names, those that move among them."""


@configclass
class MultiMeshRayCasterCameraCfg(RayCasterCameraCfg):
    """A :class:`RayCasterCameraCfg` whose prims may be targets."""

    RaycastTargetCfg: ClassVar[type] = _Target

    class_type: Callable[..., native.SensorBase] | None = MultiMeshRayCasterCamera
    mesh_prim_paths: Sequence[str | _Target] = MISSING
    """Prims that are seen: paths or targets."""
    update_mesh_ids: bool = False
    reference_meshes: bool = True

    IGNORED: ClassVar[dict[str, str]] = {"reference_meshes": _ONE_TREE}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.update_mesh_ids:
            yield "update_mesh_ids", "is True, but pictures have no numbers of meshes; set it to False"
