# SPDX-License-Identifier: Apache-2.0
"""Loose joints: mechanisms whose joints belong to no articulation get one."""

from __future__ import annotations

from typing import NamedTuple

from pxr import Sdf, Usd, UsdPhysics

from .ignored_rows import Ignored
from .stage_access import StageError, api_schemas, walk
from .stage_overlay import StageOverlay

__all__ = ["articulate_loose_joints"]

_JOINT_TYPES = ("FixedJoint", "RevoluteJoint", "PrismaticJoint", "SphericalJoint", "D6Joint", "DistanceJoint")
_EQUALITIES = {"MjcEqualityConnectAPI", "MjcEqualityWeldAPI"}


class _Joint(NamedTuple):
    """A joint and its bodies by path; ``""`` is the world."""

    path: str
    body0: str
    body1: str


def articulate_loose_joints(
    edit: StageOverlay, root_path: str, ignore: tuple[str, ...], rows: Ignored, name: str
) -> None:
    """Make articulations of the mechanisms whose joints belong to none."""
    # OpenUSD 26.8 renamed the parser.
    parse = getattr(UsdPhysics, "UsdPhysicsLoadStageFromPrimRange", None) or UsdPhysics.LoadUsdPhysicsFromRange
    parsed = parse(edit.stage, [root_path])
    articulations = parsed.get(UsdPhysics.ObjectType.Articulation, ((), ()))[1]
    owned_bodies = {str(p) for a in articulations for p in a.articulatedBodies if str(p)}
    owned_joints = {str(p) for a in articulations for p in a.articulatedJoints}
    kept = {str(p.GetPath()) for p in walk(edit.stage, root_path, ignore)}
    loose = kept - owned_joints
    joints = [
        _Joint(str(path), _body(joint.body0, kept), _body(joint.body1, kept))
        for kind in _JOINT_TYPES
        for path, joint in zip(*parsed.get(getattr(UsdPhysics.ObjectType, kind), ((), ())), strict=True)
        if str(path) in loose and _belongs_in_a_tree(edit.stage.GetPrimAtPath(path), joint)
    ]
    for mechanism in _mechanisms(joints):
        # One that hangs on an articulation is left as it is: check_builder() asks for a root above both.
        if not owned_bodies.intersection(body for joint in mechanism for body in joint[1:]):
            _articulate(edit, mechanism, rows, name)


def _belongs_in_a_tree(prim: Usd.Prim, joint: UsdPhysics.JointDesc) -> bool:
    """Whether a joint is enabled, not excluded from articulations and no equality constraint of MuJoCo."""
    excluded = not joint.jointEnabled or joint.excludeFromArticulation
    return not excluded and not _EQUALITIES.intersection(api_schemas(prim))


def _body(path: Sdf.Path, kept: set[str]) -> str:
    """Path of a joint's body, ``""`` for the world."""
    return str(path) if str(path) in kept and str(path) != "/" else ""


def _mechanisms(joints: list[_Joint]) -> list[list[_Joint]]:
    """Joints grouped into connected mechanisms. The world connects nothing."""
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


def _articulate(edit: StageOverlay, joints: list[_Joint], rows: Ignored, name: str) -> None:
    """Give one mechanism an articulation root, and exclude the joints that close loops from its tree."""
    bodies = list(dict.fromkeys(body for joint in joints for body in joint[1:] if body))
    if not bodies:  # disabled ones, which are static geometry
        rows.extend((joint.path, "joint", "left out: it joins static geometry alone") for joint in joints)
        return
    if len(bodies) == 1:
        return  # one body on joints to the world: done on the builder, OpenUSD would lose the body
    grounded = [joint for joint in joints if not joint.body0 or not joint.body1]
    between = [joint for joint in joints if joint.body0 and joint.body1]
    root_body = _root_body(bodies, grounded, between)
    tree = _tree_from(root_body, between, name)
    root = edit.prim(grounded[0].path if grounded else root_body)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    rows.append((str(root.GetPath()), "joints without articulation", f"made one articulation of {len(bodies)} bodies"))
    # A second joint between the same two bodies closes no loop: Newton merges the two into one D6 joint.
    in_tree = {joint[1:] for joint in [*tree, *grounded[:1]]}
    for joint in joints:
        if joint[1:] not in in_tree:
            UsdPhysics.Joint(edit.prim(joint.path)).CreateExcludeFromArticulationAttr(True)
            why = "kept as a constraint, not a coordinate: no drive and no limit"
            rows.append((joint.path, "joint closes a loop", why))


def _root_body(bodies: list[str], grounded: list[_Joint], between: list[_Joint]) -> str:
    """The body on the first joint to the world, otherwise the first body that is no joint's child."""
    if grounded:
        return grounded[0].body1 or grounded[0].body0
    children = {joint.body1 for joint in between}
    return next((body for body in bodies if body not in children), bodies[0])


def _tree_from(root_body: str, joints: list[_Joint], name: str) -> list[_Joint]:
    """Joints of a spanning tree that starts at ``root_body`` and leads from ``body0`` to ``body1``.

    Raises:
        StageError: a joint points the other way, from child to parent.
    """
    reached, tree, growing = {root_body}, list[_Joint](), True
    while growing:
        growing = False
        for joint in joints:
            if joint.body0 in reached and joint.body1 not in reached:
                reached.add(joint.body1)
                tree.append(joint)
                growing = True
    lost = [joint for joint in joints if joint.body0 not in reached]
    if lost:
        reason = (
            f"points from child to parent in the tree that starts at {root_body}; swap physics:body0 and physics:body1"
        )
        raise StageError(name, lost[0].path, reason)
    return tree
