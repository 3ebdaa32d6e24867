# SPDX-License-Identifier: Apache-2.0
"""Material spawners: physics and preview materials as UsdPhysics and UsdShade prims."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from pxr import Gf, Sdf, Usd, UsdPhysics, UsdShade

from stripe_newton.configclass import configclass
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, UnitFloat

__all__ = [
    "PreviewSurfaceCfg",
    "RigidBodyMaterialCfg",
    "bind_material",
    "spawn_preview_surface",
    "spawn_rigid_body_material",
]


def spawn_rigid_body_material(prim_path: str, cfg: RigidBodyMaterialCfg) -> Usd.Prim:
    """Author a ``UsdShade.Material`` with ``UsdPhysics.MaterialAPI`` at ``prim_path``."""
    material = UsdShade.Material.Define(current_stage(), authored_path(prim_path))
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateStaticFrictionAttr(cfg.static_friction)
    api.CreateDynamicFrictionAttr(cfg.dynamic_friction)
    api.CreateRestitutionAttr(cfg.restitution)
    if cfg.density is not None:
        api.CreateDensityAttr(cfg.density)
    material.GetPrim().AddAppliedSchema("PhysxMaterialAPI")
    for name, value in (
        ("frictionCombineMode", cfg.friction_combine_mode),
        ("restitutionCombineMode", cfg.restitution_combine_mode),
    ):
        material.GetPrim().CreateAttribute(f"physxMaterial:{name}", Sdf.ValueTypeNames.Token).Set(value)
    return material.GetPrim()


def spawn_preview_surface(prim_path: str, cfg: PreviewSurfaceCfg) -> Usd.Prim:
    """Author a ``UsdShade.Material`` with a ``UsdPreviewSurface`` shader at ``prim_path``."""
    path = authored_path(prim_path)
    material = UsdShade.Material.Define(current_stage(), path)
    shader = UsdShade.Shader.Define(current_stage(), f"{path}/Shader")
    shader.CreateIdAttr("UsdPreviewSurface")
    types = Sdf.ValueTypeNames
    shader.CreateInput("diffuseColor", types.Color3f).Set(Gf.Vec3f(*cfg.diffuse_color))
    shader.CreateInput("emissiveColor", types.Color3f).Set(Gf.Vec3f(*cfg.emissive_color))
    for name, value in (("roughness", cfg.roughness), ("metallic", cfg.metallic), ("opacity", cfg.opacity)):
        shader.CreateInput(name, types.Float).Set(value)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material.GetPrim()


def bind_material(prim: Usd.Prim, material: Usd.Prim, purpose: str = "") -> None:
    """Bind ``material`` to ``prim``; ``purpose`` is ``"physics"`` for a physics material."""
    api = UsdShade.MaterialBindingAPI.Apply(prim)
    # A physics material overrides those that a referenced asset binds below; a visual one does not repaint its parts.
    strength = (
        UsdShade.Tokens.strongerThanDescendants if purpose == "physics" else UsdShade.Tokens.weakerThanDescendants
    )
    api.Bind(UsdShade.Material(material), strength, purpose or UsdShade.Tokens.allPurpose)


@configclass
class RigidBodyMaterialCfg:
    """Friction and restitution of a collider."""

    func: Callable[..., Usd.Prim] = spawn_rigid_body_material
    """Function that authors the material."""
    static_friction: NonNegativeFloat = 0.5
    """Coefficient of static friction; kept in the stage. Newton's solvers have one coefficient, the dynamic one."""
    dynamic_friction: NonNegativeFloat = 0.5
    """Coefficient of friction."""
    restitution: NonNegativeFloat = 0.0
    """Coefficient of restitution; solvers without restitution (MuJoCo) ignore it."""
    density: PositiveFloat | None = None
    """Density [kg/m^3] of bodies that have no mass of their own."""
    friction_combine_mode: str = "max"
    """PhysX's rule for the friction of two colliders; kept in the stage. Newton's solvers have their own (MuJoCo: the
    larger one)."""
    restitution_combine_mode: str = "max"
    """PhysX's rule for the restitution of two colliders; kept in the stage."""

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in ("friction_combine_mode", "restitution_combine_mode"):
            if getattr(self, name) not in ("average", "min", "multiply", "max"):
                yield name, f"is '{getattr(self, name)}', must be 'average', 'min', 'multiply' or 'max'"


@configclass
class PreviewSurfaceCfg:
    """Appearance of a surface."""

    func: Callable[..., Usd.Prim] = spawn_preview_surface
    """Function that authors the material."""
    diffuse_color: tuple[float, float, float] = (0.18, 0.18, 0.18)
    """Linear RGB."""
    emissive_color: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Linear RGB."""
    roughness: UnitFloat = 0.5
    """Roughness, from 0 (mirror) to 1 (matt)."""
    metallic: UnitFloat = 0.0
    """Metalness, from 0 (dielectric) to 1 (metal)."""
    opacity: UnitFloat = 1.0
    """Opacity, from 0 (clear) to 1 (opaque)."""
