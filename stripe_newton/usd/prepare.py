# SPDX-License-Identifier: Apache-2.0
"""Preparation of a stage for Newton's importer: edits where the importer would differ from UsdPhysics.

The given stage is never changed: the edits are made in the session layer of a second stage on the same root layer.
"""

from __future__ import annotations

from collections.abc import Iterable

from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from .attribute_checks import mistyped_values
from .checks import outer_prims
from .ignored_rows import Ignored
from .loose_joints import articulate_loose_joints
from .material_bindings import inherited_materials, lost_materials, unapplied_bindings
from .mesh_approximations import replaced_approximations
from .mesh_checks import mesh_reason, normals_reason
from .point_instancers import expand_point_instancers
from .scaled_shapes import bake_shape, scaled_shapes
from .stage_access import stage_name, walk
from .stage_overlay import StageOverlay
from .static_joint_frames import joints_to_world
from .units import mixed_units, stage_units, to_si
from .untapered_shapes import untapered, write_untapered

__all__ = ["converted", "prepare", "schema_typed"]


def prepare(
    stage: Usd.Stage, root_path: str = "/", ignore: Iterable[str] = (), static_triangles: bool = False
) -> tuple[Usd.Stage, Ignored]:
    """Edit a stage so that Newton reads it as UsdPhysics defines it.

    * Instances of point instancers become prims (:func:`expand_point_instancers`).
    * Numbers of another type than their schema has, such as a double for a float, are converted: UsdPhysics would take
      its default.
    * Units other than metres and kilograms are converted (:func:`to_si`).
    * A rigid body that is not enabled becomes static geometry (Newton would let it fall).
    * Joints on static colliders become joints on the world (:func:`joints_to_world`).
    * Colliders get the physics materials that are bound above them (UsdPhysics reads those bound to a collider alone).
    * Shapes that a scale makes another kind of become meshes (:func:`scaled_shapes`).
    * Approximations of meshes that would be another shape are taken off (:func:`replaced_approximations`).
    * Visible meshes without a shape are left out, and bindings to materials that do not resolve.
    * Targets of ``physics:filteredGroups`` that do not exist are dropped (OpenUSD takes them for the group itself, and
      its members would pass through each other).
    * Joints outside every articulation get one. Its root is at the joint to the world, otherwise at the first body
      that is no joint's child. Joints that close a loop are excluded from the tree and kept as constraints.

    Args:
        stage: The stage.
        root_path: Prim below which it is edited.
        ignore: Regular expressions of paths that are left out.
        static_triangles: Whether static meshes collide by their triangles.

    Returns:
        The edited stage, and rows that say what was changed.
    """
    name, rows = stage_name(stage), list[tuple[str, str, str]]()
    edit = _converted(stage, root_path, tuple(ignore), rows)
    edit.drop_damaged_meshes()
    edit.drop_wrong_normals()
    edit.apply_binding_schema()
    edit.clear_lost_materials()
    edit.apply_inherited_materials()
    edit.make_disabled_bodies_static()
    edit.put_joints_on_the_world()
    edit.bake_scaled_shapes()
    edit.replace_approximations(static_triangles)
    edit.drop_dangling_groups()
    articulate_loose_joints(edit.overlay, root_path, tuple(ignore), rows, name)
    return edit.overlay.stage, rows


def converted(stage: Usd.Stage) -> tuple[Usd.Stage, Ignored]:
    """A stage in SI, to copy prims of it into another: the first three edits of :func:`prepare`, and their rows.

    Raises:
        StageError: a point instancer does not fit together.
    """
    rows: Ignored = []
    return _converted(stage, "/", (), rows).overlay.stage, rows


def _converted(stage: Usd.Stage, root_path: str, ignore: tuple[str, ...], rows: Ignored) -> _Edit:
    """Instances of point instancers as prims, numbers in the types of their schemas, units in SI."""
    metres, kilograms = stage_units(stage)
    rows.extend(mixed_units(stage))
    typed = _Edit(stage, root_path, ignore, rows)
    expand_point_instancers(typed.overlay, root_path, ignore, rows, stage_name(stage))
    typed.convert_types()
    in_si = to_si(typed.overlay.stage)
    if in_si is typed.overlay.stage:
        return typed
    rows.append(("/", "units", f"converted to SI from {metres:g} m and {kilograms:g} kg a unit"))
    return _Edit(in_si, root_path, ignore, rows)


def schema_typed(stage: Usd.Stage) -> Usd.Stage:
    """The stage with each number in the type of its schema: itself, or a second one on the same layers."""
    edit = _Edit(stage, "/", (), [])
    edit.convert_types()
    return edit.overlay.stage


class _Edit:
    """Edits of a stage, each with a row of the report."""

    def __init__(self, stage: Usd.Stage, root_path: str, ignore: tuple[str, ...], rows: Ignored):
        self.overlay = StageOverlay(stage)
        self._root, self._ignore, self._rows = root_path, ignore, rows

    def _prims(self) -> list[Usd.Prim]:
        return list(walk(self.overlay.stage, self._root, self._ignore))

    def convert_types(self) -> None:
        """Convert numbers to the types of their schemas, and shapes to older types that Newton reads."""
        prims = self._prims()
        # Values first: the first edit opens another stage.
        found = [
            (p.GetPath(), *row) for p in [*prims, *outer_prims(self.overlay.stage, prims)] for row in mistyped_values(p)
        ]
        for path, name, value, why in found:
            self.overlay.prim(path).GetAttribute(name).Set(value)
            self._rows.append((str(path), name, why))
        for path in [prim.GetPath() for prim in prims if untapered(prim)]:
            write_untapered(self.overlay.prim(path))

    def drop_damaged_meshes(self) -> None:
        """Leave out visible meshes that have no shape; the renderer would read beyond their arrays."""
        found = [(p.GetPath(), reason) for p in self._prims() if p.IsA(UsdGeom.Mesh) and (reason := mesh_reason(p))]
        for path, reason in found:
            self.overlay.prim(path).SetTypeName("Xform")  # what stands below it stays
            self._rows.append((str(path), "visible mesh", f"is left out: it is a mesh {reason}"))

    def drop_wrong_normals(self) -> None:
        """Block normals whose number fits nothing, for which Newton would refuse the mesh."""
        meshes = [p for p in self._prims() if p.IsA(UsdGeom.Mesh)]
        for path, reason in [(p.GetPath(), reason) for p in meshes if (reason := normals_reason(p))]:
            self.overlay.prim(path).GetAttribute("normals").Block()
            self._rows.append((str(path), "normals", f"left out: {reason}"))

    def apply_binding_schema(self) -> None:
        """Apply MaterialBindingAPI where a material is bound without it; UsdPhysics would not read the binding."""
        paths = unapplied_bindings(self._prims())
        for path in paths:
            UsdShade.MaterialBindingAPI.Apply(self.overlay.prim(path))
        if paths:
            more = f" (+{len(paths) - 1} more)" if len(paths) > 1 else ""
            self._rows.append(
                (paths[0] + more, "material binding", "MaterialBindingAPI is not applied: taken as if it were")
            )

    def apply_inherited_materials(self) -> None:
        """Apply MaterialBindingAPI on colliders whose material is bound above them; UsdPhysics would not look there."""
        for path in inherited_materials(self._prims()):
            UsdShade.MaterialBindingAPI.Apply(self.overlay.prim(path))

    def clear_lost_materials(self) -> None:
        """Clear bindings to materials that Newton could not read, which would refuse the whole stage."""
        for lost in lost_materials(self._prims()):
            for owner, relationship in dict.fromkeys(lost.bindings):
                self.overlay.prim(owner).GetRelationship(relationship).SetTargets([])
            more = f" (+{len(lost.colliders) - 1} more)" if len(lost.colliders) > 1 else ""
            why = f"{lost.path} {lost.why}: default friction and restitution are used"
            self._rows.append((lost.colliders[0] + more, "physics material", why))

    def make_disabled_bodies_static(self) -> None:
        """Take the rigid body from prims whose body is not enabled."""
        bodies = [p.GetPath() for p in self._prims() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
        for path in bodies:
            body = UsdPhysics.RigidBodyAPI(self.overlay.stage.GetPrimAtPath(path))
            if body.GetRigidBodyEnabledAttr().Get() is False:
                self.overlay.prim(path).RemoveAPI(UsdPhysics.RigidBodyAPI)
                self._rows.append(
                    (str(path), "rigid body", "rigidBodyEnabled is false: its shapes are static geometry")
                )

    def put_joints_on_the_world(self) -> None:
        """Let joints on static colliders be on the world; after bodies are known to be static."""
        joints_to_world(self.overlay, self._prims())

    def bake_scaled_shapes(self) -> None:
        """Replace shapes that Newton would read as others by meshes; after bodies are known to be static."""
        for path, what, why_not in scaled_shapes(self._prims()):
            kind = self.overlay.stage.GetPrimAtPath(path).GetTypeName()
            if why_not:
                why = f"is not read, as {why_not}; bake it into a mesh, or scale all axes alike"
            else:
                bake_shape(self.overlay, path)
                why = "is baked into its points"
                if kind != "Mesh":
                    why = f"is not one of a {kind}: it becomes a mesh, to 1 mm"
            self._rows.append((str(path), what, why))

    def replace_approximations(self, static_triangles: bool) -> None:
        """Author ``none`` where an approximation would be another shape; after bodies are known to be static."""
        meshes = [prim for prim in self._prims() if prim.HasAPI(UsdPhysics.MeshCollisionAPI)]
        kinds = {prim.GetPath(): UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() for prim in meshes}
        for path, kind, why in list(replaced_approximations(meshes, static_triangles)):
            UsdPhysics.MeshCollisionAPI(self.overlay.prim(path)).GetApproximationAttr().Set(UsdPhysics.Tokens.none)
            kinds[path] = UsdPhysics.Tokens.none
            self._rows.append((str(path), f"approximation {kind}", why))
        # An edit of a prim reaches those that refer to it, such as the colliders of bodies that keep theirs.
        for path, kind in kinds.items():
            if UsdPhysics.MeshCollisionAPI(self.overlay.stage.GetPrimAtPath(path)).GetApproximationAttr().Get() != kind:
                UsdPhysics.MeshCollisionAPI(self.overlay.prim(path)).GetApproximationAttr().Set(kind)

    def drop_dangling_groups(self) -> None:
        """Drop targets of collision groups that do not exist."""
        stage = self.overlay.stage
        for path in [p.GetPath() for p in stage.Traverse() if p.IsA(UsdPhysics.CollisionGroup)]:
            targets = self._group(path).GetFilteredGroupsRel().GetTargets()
            if path in targets:
                self._rows.append((str(path), "collision group", "filters itself: its members pass through each other"))
            missing = [t for t in targets if not self._group(t)]
            if missing:
                relation = UsdPhysics.CollisionGroup(self.overlay.prim(path)).GetFilteredGroupsRel()
                relation.SetTargets([t for t in targets if t not in missing])
                why = f"no such collision group: {', '.join(map(str, missing))}"
                self._rows.append((str(path), "filteredGroups", why))

    def _group(self, path: Sdf.Path) -> UsdPhysics.CollisionGroup:
        return UsdPhysics.CollisionGroup(self.overlay.stage.GetPrimAtPath(path))
