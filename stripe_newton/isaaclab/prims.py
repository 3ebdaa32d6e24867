# SPDX-License-Identifier: Apache-2.0
"""Prims of the Isaac Lab dialect: functions of Isaac Sim and Isaac Lab on the stage that is being authored."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSemantics

from stripe_newton.sim import current_stage as authored_stage
from stripe_newton.sim.spawners.spawner_cfg import place

from .latest_simulation import latest_simulation

__all__ = [
    "create_prim",
    "define_prim",
    "delete_prim",
    "find_first_matching_prim",
    "find_matching_prim_paths",
    "find_matching_prims",
    "get_all_matching_child_prims",
    "get_context",
    "get_current_stage",
    "get_first_matching_child_prim",
    "get_prim_at_path",
    "is_prim_path_valid",
    "set_prim_visibility",
]

Vector = Sequence[float] | None
Predicate = Callable[[Usd.Prim], bool]


def get_current_stage(fabric: bool = False) -> Usd.Stage:
    """The stage of the scene under construction, else that of the latest simulation."""
    sim = latest_simulation()
    return authored_stage() if sim is None else sim.stage


class _Context:
    """Omniverse's context, which is asked for the stage."""

    def get_stage(self) -> Usd.Stage:
        """The stage."""
        return get_current_stage()


def get_context(name: str = "") -> _Context:
    """Omniverse's context; ``get_stage()`` of it is :func:`get_current_stage`."""
    return _Context()


def create_prim(
    prim_path: str,
    prim_type: str = "Xform",
    position: Vector = None,
    translation: Vector = None,
    orientation: Vector = None,
    scale: Vector = None,
    usd_path: str | None = None,
    semantic_label: str | None = None,
    semantic_type: str = "class",
    attributes: dict[str, object] | None = None,
    stage: Usd.Stage | None = None,
) -> Usd.Prim:
    """Author a prim.

    Args:
        prim_path: Its path.
        prim_type: USD type.
        position: Position in the world [m]; below a prim that is moved it is not that.
        translation: Position in the parent's frame [m].
        orientation: Quaternion (w, x, y, z).
        scale: Scale.
        usd_path: File to reference.
        semantic_label: Semantic label.
        semantic_type: Type of the label.
        attributes: Values of attributes by name.
        stage: The stage. Default: :func:`get_current_stage`.
    """
    prim = (stage or get_current_stage()).DefinePrim(prim_path, prim_type)
    if usd_path is not None:
        prim.GetReferences().AddReference(usd_path)
    turn = None if orientation is None else (*orientation[1:], orientation[0])
    if any(value is not None for value in (position, translation, turn, scale)):
        place(prim, translation if position is None else position, turn, scale)
    if semantic_label is not None:
        UsdSemantics.LabelsAPI.Apply(prim, semantic_type).CreateLabelsAttr([semantic_label])
    for name, value in (attributes or {}).items():
        prim.GetAttribute(name).Set(value)
    return prim


def define_prim(prim_path: str, prim_type: str = "Xform", fabric: bool = False) -> Usd.Prim:
    """Author a prim without more."""
    return create_prim(prim_path, prim_type)


def delete_prim(prim_path: str) -> None:
    """Remove a prim."""
    get_current_stage().RemovePrim(prim_path)


def get_prim_at_path(prim_path: str, fabric: bool = False) -> Usd.Prim:
    """The prim at a path, which may be an invalid one."""
    return get_current_stage().GetPrimAtPath(prim_path)


def is_prim_path_valid(prim_path: str, fabric: bool = False) -> bool:
    """Whether there is a prim at a path."""
    return bool(get_prim_at_path(prim_path).IsValid())


def set_prim_visibility(prim: Usd.Prim, visible: bool) -> None:
    """Show or hide a prim."""
    imageable = UsdGeom.Imageable(prim)
    (imageable.MakeVisible if visible else imageable.MakeInvisible)()


def find_matching_prims(prim_path_regex: str, stage: Usd.Stage | None = None) -> list[Usd.Prim]:
    """All prims whose path matches an expression, part by part."""
    parts = [part for part in prim_path_regex.split("/") if part]
    found = [(stage or get_current_stage()).GetPseudoRoot()]
    for part in parts:
        found = [child for prim in found for child in prim.GetAllChildren() if re.fullmatch(part, child.GetName())]
    return found


def find_matching_prim_paths(prim_path_regex: str, stage: Usd.Stage | None = None) -> list[str]:
    """Paths of :func:`find_matching_prims`."""
    return [str(prim.GetPath()) for prim in find_matching_prims(prim_path_regex, stage)]


def find_first_matching_prim(prim_path_regex: str, stage: Usd.Stage | None = None) -> Usd.Prim | None:
    """The first prim whose path matches an expression, or None."""
    return next(iter(find_matching_prims(prim_path_regex, stage)), None)


def get_all_matching_child_prims(
    prim_path: str,
    predicate: Predicate = lambda prim: True,
    depth: int | None = None,
    stage: Usd.Stage | None = None,
    traverse_instance_prims: bool = True,
) -> list[Usd.Prim]:
    """Prims at and below a path for which a function is true.

    Args:
        prim_path: The path.
        predicate: The function.
        depth: Levels below the path, 0 for the prim itself. Default: all.
        stage: The stage.
        traverse_instance_prims: Whether to look into instances.
    """
    root = (stage or get_current_stage()).GetPrimAtPath(prim_path)
    if not root.IsValid():
        raise ValueError(f"no prim at '{prim_path}'")
    rule = Usd.TraverseInstanceProxies() if traverse_instance_prims else Usd.PrimDefaultPredicate
    first = len(Sdf.Path(prim_path).GetPrefixes())
    prims = Usd.PrimRange(root, rule)
    near = (p for p in prims if depth is None or len(p.GetPath().GetPrefixes()) - first <= depth)
    return [prim for prim in near if predicate(prim)]


def get_first_matching_child_prim(
    prim_path: str,
    predicate: Predicate,
    stage: Usd.Stage | None = None,
    traverse_instance_prims: bool = True,
) -> Usd.Prim | None:
    """The first prim at or below a path for which a function is true, or None."""
    found = get_all_matching_child_prims(prim_path, predicate, None, stage, traverse_instance_prims)
    return found[0] if found else None


def get_world_transform_matrix(prim: Usd.Prim) -> Gf.Matrix4d:
    """Pose of a prim in the world, as USD writes it: row vectors."""
    return UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
