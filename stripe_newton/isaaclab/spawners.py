# SPDX-License-Identifier: Apache-2.0
"""Spawners of the Isaac Lab dialect: their functions take orientations as (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar

from pxr import Usd

from stripe_newton import sim as native
from stripe_newton.configclass import configclass

from .files import is_on_server
from .nucleus import problem_of, spawner_for

__all__ = [
    "CapsuleCfg",
    "ConeCfg",
    "CuboidCfg",
    "CylinderCfg",
    "CylinderLightCfg",
    "DiskLightCfg",
    "DistantLightCfg",
    "DomeLightCfg",
    "GroundPlaneCfg",
    "LightCfg",
    "MeshCapsuleCfg",
    "MeshConeCfg",
    "MeshCuboidCfg",
    "MeshCylinderCfg",
    "MeshSphereCfg",
    "MultiAssetSpawnerCfg",
    "MultiUsdFileCfg",
    "RigidObjectSpawnerCfg",
    "SpawnerCfg",
    "SphereCfg",
    "SphereLightCfg",
    "UsdFileCfg",
    "WxyzFunc",
    "deformable_problems",
    "spawn_from_mjcf",
    "spawn_from_urdf",
    "spawn_from_usd",
    "spawn_ground_plane",
    "spawn_light",
    "spawn_multi_asset",
    "spawn_multi_usd_file",
    "spawn_shape",
]

Vector = Sequence[float] | None
"""Position [m] or quaternion (w, x, y, z); ``None`` leaves the prim as it is."""
Spawn = Callable[..., Usd.Prim]


def _xyzw(orientation: Vector) -> Vector:
    """(w, x, y, z) as (x, y, z, w)."""
    return None if orientation is None else (*orientation[1:], orientation[0])


def _wxyz(orientation: Vector) -> Vector:
    """(x, y, z, w) as (w, x, y, z)."""
    return None if orientation is None else (orientation[3], *orientation[:3])


def spawn_from_usd(
    prim_path: str, cfg: native.UsdFileCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_from_usd` with an orientation (w, x, y, z).

    For a file of NVIDIA's asset server the robot or prop that stands for it is spawned.
    """
    if is_on_server(cfg.usd_path):
        stands = spawner_for(cfg)
        if not isinstance(stands, UsdFileCfg):
            return stands.spawn(prim_path, translation, _xyzw(orientation))
        cfg = stands  # a copy of the file that is on this machine
    return native.spawn_from_usd(prim_path, cfg, translation, _xyzw(orientation))


def spawn_from_urdf(
    prim_path: str, cfg: native.UrdfFileCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_from_urdf` with an orientation (w, x, y, z)."""
    return native.spawn_from_urdf(prim_path, cfg, translation, _xyzw(orientation))


def spawn_from_mjcf(
    prim_path: str, cfg: native.MjcfFileCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_from_mjcf` with an orientation (w, x, y, z)."""
    return native.spawn_from_mjcf(prim_path, cfg, translation, _xyzw(orientation))


def spawn_ground_plane(
    prim_path: str, cfg: native.GroundPlaneCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_ground_plane` with an orientation (w, x, y, z)."""
    return native.spawn_ground_plane(prim_path, cfg, translation, _xyzw(orientation))


def spawn_shape(
    prim_path: str, cfg: native.ShapeCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_shape` with an orientation (w, x, y, z)."""
    return native.spawn_shape(prim_path, cfg, translation, _xyzw(orientation))


def spawn_light(
    prim_path: str, cfg: native.LightCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_light` with an orientation (w, x, y, z)."""
    return native.spawn_light(prim_path, cfg, translation, _xyzw(orientation))


def spawn_multi_asset(
    prim_path: str, cfg: native.MultiAssetSpawnerCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_multi_asset` with an orientation (w, x, y, z)."""
    return native.spawn_multi_asset(prim_path, cfg, translation, _xyzw(orientation))


def spawn_multi_usd_file(
    prim_path: str, cfg: native.MultiUsdFileCfg, translation: Vector = None, orientation: Vector = None
) -> Usd.Prim:
    """:func:`stripe_newton.sim.spawn_multi_usd_file` with an orientation (w, x, y, z)."""
    return native.spawn_multi_usd_file(prim_path, cfg, translation, _xyzw(orientation))


def deformable_problems(props: object) -> Iterator[tuple[str, str]]:
    """The problem of a config with properties of deformable bodies."""
    if props is not None:
        yield "deformable_props", "is set, but deformable bodies are not simulated; use rigid_props"


class WxyzFunc:
    """A spawner whose ``func`` takes (w, x, y, z), also one that the user wrote."""

    func: Spawn

    def spawn(self, prim_path: str, translation: Vector = None, orientation: Vector = None) -> Usd.Prim:
        """Author the prim; ``orientation`` is (x, y, z, w), as the package calls it."""
        return self.func(prim_path, self, translation, _wxyz(orientation))


@configclass
class SpawnerCfg(WxyzFunc, native.SpawnerCfg):
    """Base of a user's spawners; ``func`` takes an orientation (w, x, y, z)."""


@configclass
class RigidObjectSpawnerCfg(WxyzFunc, native.RigidObjectSpawnerCfg):
    """Base of a user's spawners of rigid bodies; ``func`` takes an orientation (w, x, y, z)."""


@configclass
class UsdFileCfg(WxyzFunc, native.UsdFileCfg):
    """:class:`stripe_newton.sim.UsdFileCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_from_usd
    fixed_tendons_props: object = None
    spatial_tendons_props: object = None
    deformable_props: object = None

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("fixed_tendons_props", "spatial_tendons_props"), "tendons are those of the file"
    )

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (isinstance(self.usd_path, str) and is_on_server(self.usd_path)):
            yield from native.UsdFileCfg.problems(self)
        elif (problem := problem_of(self.usd_path)) is not None:
            yield "usd_path", problem
        yield from deformable_problems(self.deformable_props)


@configclass
class MultiUsdFileCfg(WxyzFunc, native.MultiUsdFileCfg):
    """:class:`stripe_newton.sim.MultiUsdFileCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    FILE_CFG: ClassVar[type[native.UsdFileCfg]] = UsdFileCfg

    func: Spawn = spawn_multi_usd_file
    fixed_tendons_props: object = None
    spatial_tendons_props: object = None
    deformable_props: object = None

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("fixed_tendons_props", "spatial_tendons_props"), "tendons are those of the file"
    )


@configclass
class MultiAssetSpawnerCfg(WxyzFunc, native.MultiAssetSpawnerCfg):
    """:class:`stripe_newton.sim.MultiAssetSpawnerCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_multi_asset
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MultiAssetSpawnerCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class GroundPlaneCfg(WxyzFunc, native.GroundPlaneCfg):
    """:class:`stripe_newton.sim.GroundPlaneCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_ground_plane


@configclass
class CapsuleCfg(WxyzFunc, native.CapsuleCfg):
    """:class:`stripe_newton.sim.CapsuleCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape


@configclass
class ConeCfg(WxyzFunc, native.ConeCfg):
    """:class:`stripe_newton.sim.ConeCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape


@configclass
class CuboidCfg(WxyzFunc, native.CuboidCfg):
    """:class:`stripe_newton.sim.CuboidCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape


@configclass
class CylinderCfg(WxyzFunc, native.CylinderCfg):
    """:class:`stripe_newton.sim.CylinderCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape


@configclass
class SphereCfg(WxyzFunc, native.SphereCfg):
    """:class:`stripe_newton.sim.SphereCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape


@configclass
class MeshCapsuleCfg(WxyzFunc, native.MeshCapsuleCfg):
    """:class:`stripe_newton.sim.MeshCapsuleCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshCapsuleCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class MeshConeCfg(WxyzFunc, native.MeshConeCfg):
    """:class:`stripe_newton.sim.MeshConeCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshConeCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class MeshCuboidCfg(WxyzFunc, native.MeshCuboidCfg):
    """:class:`stripe_newton.sim.MeshCuboidCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshCuboidCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class MeshCylinderCfg(WxyzFunc, native.MeshCylinderCfg):
    """:class:`stripe_newton.sim.MeshCylinderCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshCylinderCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class MeshSphereCfg(WxyzFunc, native.MeshSphereCfg):
    """:class:`stripe_newton.sim.MeshSphereCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_shape
    deformable_props: object = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshSphereCfg.problems(self)
        yield from deformable_problems(self.deformable_props)


@configclass
class LightCfg(WxyzFunc, native.LightCfg):
    """:class:`stripe_newton.sim.LightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light


@configclass
class CylinderLightCfg(WxyzFunc, native.CylinderLightCfg):
    """:class:`stripe_newton.sim.CylinderLightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light


@configclass
class DiskLightCfg(WxyzFunc, native.DiskLightCfg):
    """:class:`stripe_newton.sim.DiskLightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light


@configclass
class DistantLightCfg(WxyzFunc, native.DistantLightCfg):
    """:class:`stripe_newton.sim.DistantLightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light


@configclass
class DomeLightCfg(WxyzFunc, native.DomeLightCfg):
    """:class:`stripe_newton.sim.DomeLightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light


@configclass
class SphereLightCfg(WxyzFunc, native.SphereLightCfg):
    """:class:`stripe_newton.sim.SphereLightCfg` whose ``func`` takes an orientation (w, x, y, z)."""

    func: Spawn = spawn_light
