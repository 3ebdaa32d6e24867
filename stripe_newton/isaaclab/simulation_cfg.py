# SPDX-License-Identifier: Apache-2.0
"""Configs of the Isaac Lab dialect with fields that only PhysX and Isaac Sim's renderer know.

Such a field is taken, and one warning says that it has no effect.
"""

from __future__ import annotations

from typing import ClassVar

from stripe_newton import sim as native
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.viewers import ViewerCfg as NativeViewerCfg

from .stand_ins import StandIn

__all__ = ["GlassMdlCfg", "MdlFileCfg", "PhysxCfg", "RenderCfg", "RigidBodyMaterialCfg", "SimulationCfg", "ViewerCfg"]

_NOT_PHYSX = "physics is Newton's, see SimulationCfg.solver"
_ONE_PROCESS = "there is no Isaac Sim beside the simulation"


class _Settings(StandIn):
    """Settings without effect; equal where the same fields are set."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]  # it can be changed


class PhysxCfg(_Settings):
    """Settings of PhysX, which is not the solver here."""


class RenderCfg(_Settings):
    """Settings of Isaac Sim's renderer, which is not the one here."""


@configclass
class RigidBodyMaterialCfg(native.RigidBodyMaterialCfg):
    """:class:`stripe_newton.sim.RigidBodyMaterialCfg` with PhysX's compliance."""

    compliant_contact_stiffness: float = 0.0
    compliant_contact_damping: float = 0.0

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("compliant_contact_stiffness", "compliant_contact_damping"), "contacts have the solver's compliance"
    )


@configclass
class SimulationCfg(native.SimulationCfg):
    """:class:`stripe_newton.sim.SimulationCfg` with Isaac Lab's other fields."""

    physics_material: native.RigidBodyMaterialCfg = RigidBodyMaterialCfg()
    physx: PhysxCfg = PhysxCfg()
    render: RenderCfg = RenderCfg()
    physics_prim_path: str = "/physicsScene"
    enable_scene_query_support: bool = False
    use_fabric: bool = True
    create_stage_in_memory: bool = False
    disable_contact_processing: bool = False
    logging_level: str = "WARNING"
    save_logs_to_file: bool = True
    log_dir: str | None = None

    IGNORED: ClassVar[dict[str, str]] = {
        "physx": _NOT_PHYSX,
        "render": "pictures are drawn by Newton's renderer, see ViewerCfg",
        "physics_prim_path": "the stage needs no prim for the physics",
        "enable_scene_query_support": _NOT_PHYSX,
        "use_fabric": "states are Newton's arrays",
        "create_stage_in_memory": "the stage is always in memory",
        "disable_contact_processing": "it is a field of Isaac Lab 2.0; contacts of every body can be sensed",
        **dict.fromkeys(("logging_level", "save_logs_to_file", "log_dir"), _ONE_PROCESS),
    }


@configclass
class MdlFileCfg(native.PreviewSurfaceCfg):
    """A material of an MDL file, which is drawn in one colour: MDL is a language of NVIDIA's renderer."""

    mdl_path: str = MISSING
    project_uvw: bool | None = None
    albedo_brightness: float | None = None
    texture_scale: tuple[float, float] | None = None

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("mdl_path", "project_uvw", "albedo_brightness", "texture_scale"), "MDL materials are drawn in one colour"
    )


@configclass
class GlassMdlCfg(native.PreviewSurfaceCfg):
    """Glass of NVIDIA's renderer, which is drawn in its colour, half transparent."""

    opacity: float = 0.5
    mdl_path: str = "OmniGlass.mdl"
    glass_color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    frosting_roughness: float = 0.0
    thin_walled: bool = False
    glass_ior: float = 1.491

    IGNORED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("mdl_path", "frosting_roughness", "thin_walled", "glass_ior"), "glass is drawn in one colour"
    )

    def __post_init__(self) -> None:
        self.diffuse_color = self.glass_color


@configclass
class ViewerCfg(NativeViewerCfg):
    """:class:`stripe_newton.viewers.ViewerCfg` with the camera of Isaac Lab: each of its points has a default."""

    eye: tuple[float, float, float] | None = (7.5, 7.5, 7.5)
    lookat: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    origin_type: str = "world"
    cam_prim_path: str = "/OmniverseKit_Persp"

    IGNORED: ClassVar[dict[str, str]] = {"cam_prim_path": "there is one camera"}
