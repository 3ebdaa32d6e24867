# SPDX-License-Identifier: Apache-2.0
"""Default reset: an asset whose root or joints no event resets begins an episode in its default state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp import reset_joints_to_default, reset_root_to_default
from stripe_kernels.term_info import is_for_each_asset, parts_reset
from stripe_newton.assets import Articulation
from stripe_newton.assets.asset_base import BoundAsset
from stripe_newton.fusion import Code, Item, SceneEntityCfg, Section
from stripe_newton.matching import match_names

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .manager_base import is_warp_term

__all__ = ["default_reset_items"]


def default_reset_items(
    context: ManagerContext, events: Sequence[EventTermCfg], others: Sequence[str], keep: Sequence[str]
) -> list[Item]:
    """The item that brings assets to their default state where an episode begins; none where events reset them all.

    It belongs before the events: what they write, torch terms among them, overrides it. Only events whose function
    declares by ``@resets`` that it resets a root or joints, and that run at every reset, take its place.

    Args:
        context: The context of the managers; problems are added to it.
        events: Terms of the event manager.
        others: Assets that something else resets.
        keep: Expressions for the names of assets that stay as they are.
    """
    names = context.entity_names()
    kept = set(others) | _matching(context, keep, names)
    body, done = list[Code](), []
    for name in names:
        asset = context.asset(name)
        if name in kept:
            continue
        root, joints = _reset_by_events(context, asset, name, events)
        struct = context.scope.name(name, asset.native_data.struct)
        calls: list[wp.Function] = []
        if asset.layout.floating and not root:
            calls.append(reset_root_to_default)
        if isinstance(asset, Articulation) and len(joints) < asset.num_joints:
            calls.append(reset_joints_to_default)
        body += [context.scope.call(function, "env", struct) for function in calls]
        done += [f"{name} ({'root' if f is reset_root_to_default else 'joints'})" for f in calls]
    return [Section("reset_to_default", body, done).only(context.is_reset)] if body else []


def _matching(context: ManagerContext, expressions: Sequence[str], names: list[str]) -> set[str]:
    try:
        return {names[i] for i in match_names(list(expressions), names, what="asset")[0]} if expressions else set()
    except ValueError as error:
        context.problems.append(f"keep_at_reset: {error}")
        return set()


def _reset_by_events(
    context: ManagerContext, asset: BoundAsset, name: str, events: Sequence[EventTermCfg]
) -> tuple[bool, set[int]]:
    """Whether events reset the root of an asset, and which of its joints they reset."""
    root, joints = False, set[int]()
    for term in events:
        if term.mode != "reset" or term.min_step_count_between_reset > 0 or not is_warp_term(term.func):
            continue
        parts = parts_reset(term.func)
        for entity in _entities(context, term) if parts else ():
            if entity.name != name:
                continue
            root |= "root" in parts
            if "joints" in parts and isinstance(asset, Articulation):
                joints |= _joints(term, entity, asset)
    return root, joints


def _entities(context: ManagerContext, term: EventTermCfg) -> Iterator[SceneEntityCfg]:
    """Assets that a term is about, found as its arguments are."""
    assert is_warp_term(term.func)
    given, there = term.params, context.entity_names()
    named = [a for a, kind in term.func.input_types.items() if kind is ArticulationData]
    for argument in named:
        keys = [k for k in (argument, f"{argument}_cfg", "asset_cfg") if k in given]
        value = given[keys[0]] if keys else None
        if value is None and is_for_each_asset(term.func):
            yield from map(SceneEntityCfg, there)
        elif value is None:
            yield SceneEntityCfg(argument if argument in there or len(there) != 1 else there[0])
        else:
            yield SceneEntityCfg(value) if isinstance(value, str) else value


def _joints(term: EventTermCfg, entity: SceneEntityCfg, asset: Articulation) -> set[int]:
    assert is_warp_term(term.func)
    every = set(range(asset.num_joints))
    if "joint_ids" not in term.func.input_types or not entity.chooses("joint"):
        return set() if "joint_ids" in term.params else every
    try:
        return set(entity.indices("joint", asset.joint_names))
    except ValueError:  # the event manager reports it
        return set()
