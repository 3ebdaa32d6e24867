# SPDX-License-Identifier: Apache-2.0
"""Edits, on a layer of our own, of what Newton's importer would read otherwise than UsdPhysics means it.

The given stage is never changed: the edits stand in a session layer of a second stage on the same root layer.
"""

from __future__ import annotations

from collections.abc import Iterable

from pxr import Sdf, Usd, UsdPhysics

from .stage import StageError, api_schemas, stage_name, walk
from .units import mixed_units, stage_units, to_si

__all__ = ["Ignored", "prepare"]

Ignored = list[tuple[str, str, str]]
"""Rows ``(prim path, what, why)``."""

_JOINT_TYPES = ("FixedJoint", "RevoluteJoint", "PrismaticJoint", "SphericalJoint", "D6Joint", "DistanceJoint")
_EQUALITIES = {"MjcEqualityConnectAPI", "MjcEqualityWeldAPI"}


def prepare(stage: Usd.Stage, root_path: str = "/", ignore: Iterable[str] = ()) -> tuple[Usd.Stage, Ignored]:
    """A stage that Newton reads as UsdPhysics means it, and what was changed for that.

    * other units than metres and kilograms: converted (:func:`to_si`);
    * a rigid body that is not enabled becomes static geometry (Newton would let it fall);
    * targets of ``physics:filteredGroups`` that do not exist are dropped (OpenUSD takes them for the group itself, and
      its members would pass through each other);
    * joints outside every articulation get one: a root at the joint to the world, else at the first body that is
      nobody's child. Joints that close a loop are excluded from the tree and kept as constraints.
    """
    name, ignore = stage_name(stage), tuple(ignore)
    metres, kilograms = stage_units(stage)
    rows: Ignored = mixed_units(stage)
    converted = to_si(stage)
    if converted is not stage:
        rows.append(("/", "units", f"converted to SI from {metres:g} m and {kilograms:g} kg a unit"))
        stage = converted
    edit = _Overlay(stage)
    _disabled_bodies(edit, root_path, ignore, rows)
    _dangling_groups(edit, rows)
    _loose_joints(edit, root_path, ignore, rows, name)
    return edit.stage, rows


class _Overlay:
    """A stage that is opened a second time, with a session layer of our own, at the first edit."""

    def __init__(self, stage: Usd.Stage):
        self.stage = stage
        self._own = False

    def prim(self, path: Sdf.Path | str) -> Usd.Prim:
        """The prim to edit; the instance it may stand in is made editable."""
        if not self._own:
            self._open()
        prim = self.stage.GetPrimAtPath(path)
        while prim.IsInstanceProxy():
            instance = prim
            while not instance.IsInstance():
                instance = instance.GetParent()
            instance.SetInstanceable(False)
            prim = self.stage.GetPrimAtPath(path)
        return prim

    def _open(self) -> None:
        base, session = self.stage, Sdf.Layer.CreateAnonymous("stripe-newton.usda")
        if base.GetSessionLayer() is not None:
            session.subLayerPaths.append(base.GetSessionLayer().identifier)
        arguments = (base.GetRootLayer(), session, base.GetPathResolverContext())
        self.stage = Usd.Stage.OpenMasked(*arguments, base.GetPopulationMask(), Usd.Stage.LoadAll)
        self.stage.SetLoadRules(base.GetLoadRules())
        self.stage.MuteAndUnmuteLayers(base.GetMutedLayers(), [])
        self.stage.SetEditTarget(session)
        self._base, self._own = base, True  # the base keeps its session layer alive


def _disabled_bodies(edit: _Overlay, root_path: str, ignore: tuple[str, ...], rows: Ignored) -> None:
    bodies = [p.GetPath() for p in walk(edit.stage, root_path, ignore) if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    for path in bodies:
        if UsdPhysics.RigidBodyAPI(edit.stage.GetPrimAtPath(path)).GetRigidBodyEnabledAttr().Get() is False:
            edit.prim(path).RemoveAPI(UsdPhysics.RigidBodyAPI)
            rows.append((str(path), "rigid body", "rigidBodyEnabled is false: its shapes are static geometry"))


def _dangling_groups(edit: _Overlay, rows: Ignored) -> None:
    for path in [p.GetPath() for p in edit.stage.Traverse() if p.IsA(UsdPhysics.CollisionGroup)]:
        targets = UsdPhysics.CollisionGroup(edit.stage.GetPrimAtPath(path)).GetFilteredGroupsRel().GetTargets()
        if path in targets:
            rows.append((str(path), "collision group", "filters itself: its members pass through each other"))
        missing = [t for t in targets if not UsdPhysics.CollisionGroup(edit.stage.GetPrimAtPath(t))]
        if missing:
            relation = UsdPhysics.CollisionGroup(edit.prim(path)).GetFilteredGroupsRel()
            relation.SetTargets([t for t in targets if t not in missing])
            rows.append((str(path), "filteredGroups", f"no such collision group: {', '.join(map(str, missing))}"))


def _loose_joints(edit: _Overlay, root_path: str, ignore: tuple[str, ...], rows: Ignored, name: str) -> None:
    kept = {str(p.GetPath()) for p in walk(edit.stage, root_path, ignore)}
    # OpenUSD 26.8 renamed the parser.
    parse = getattr(UsdPhysics, "UsdPhysicsLoadStageFromPrimRange", None) or UsdPhysics.LoadUsdPhysicsFromRange
    parsed = parse(edit.stage, [root_path])
    articulations = parsed.get(UsdPhysics.ObjectType.Articulation, ((), ()))[1]
    owned_joints = {str(p) for a in articulations for p in a.articulatedJoints}
    owned_bodies = {str(p) for a in articulations for p in a.articulatedBodies if str(p)}
    joints = []
    for kind in _JOINT_TYPES:
        for path, joint in zip(*parsed.get(getattr(UsdPhysics.ObjectType, kind), ((), ())), strict=True):
            prim = edit.stage.GetPrimAtPath(path)
            if (
                joint.jointEnabled
                and not joint.excludeFromArticulation
                and str(path) in kept - owned_joints
                and not _EQUALITIES.intersection(api_schemas(prim))
            ):
                joints.append((str(path), _body(joint.body0, kept), _body(joint.body1, kept)))
    for component in _components(joints):
        if not owned_bodies.intersection(body for _, a, b in component for body in (a, b)):
            _articulate(edit, component, rows, name)


def _body(path: Sdf.Path, kept: set[str]) -> str:
    """Path of a joint's body, ``""`` for the world."""
    return str(path) if str(path) in kept and str(path) != "/" else ""


_Joint = tuple[str, str, str]  # path, body0, body1


def _components(joints: list[_Joint]) -> list[list[_Joint]]:
    """Joints grouped by what they connect; the world connects nothing."""
    groups: list[tuple[set[str], list[_Joint]]] = []
    for joint in joints:
        bodies = {body for body in joint[1:] if body}
        members = [joint]
        rest = []
        for other, owned in groups:
            if other & bodies:
                bodies |= other
                members = owned + members
            else:
                rest.append((other, owned))
        groups = [*rest, (bodies, members)]
    return [members for _, members in groups]


def _articulate(edit: _Overlay, joints: list[_Joint], rows: Ignored, name: str) -> None:
    """Root one mechanism and take the joints that close loops out of its tree."""
    grounded = [j for j in joints if not j[1] or not j[2]]
    between = [j for j in joints if j[1] and j[2]]
    children = {j[2] for j in between}
    bodies = list(dict.fromkeys(body for j in joints for body in j[1:] if body))
    if len(bodies) == 1:
        return  # one body on joints to the world: done on the builder, OpenUSD would lose the body
    root_body = (
        (grounded[0][2] or grounded[0][1]) if grounded else next((b for b in bodies if b not in children), bodies[0])
    )
    reached, tree, growing = {root_body}, [], True
    while growing:
        growing = False
        for joint in between:
            if joint[1] in reached and joint[2] not in reached:
                reached.add(joint[2])
                tree.append(joint)
                growing = True
    lost = [j for j in between if j[1] not in reached]
    if lost:
        reason = (
            f"points from child to parent in the tree that starts at {root_body}; swap physics:body0 and physics:body1"
        )
        raise StageError(name, lost[0][0], reason)
    same_pair = {(j[1], j[2]) for j in tree} | ({grounded[0][1:]} if grounded else set())
    root = edit.prim(grounded[0][0] if grounded else root_body)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    rows.append((str(root.GetPath()), "joints without articulation", f"made one articulation of {len(bodies)} bodies"))
    for path, body0, body1 in joints:
        if (body0, body1) not in same_pair:
            UsdPhysics.Joint(edit.prim(path)).CreateExcludeFromArticulationAttr(True)
            rows.append((path, "joint closes a loop", "kept as a constraint, not a coordinate: no drive and no limit"))
