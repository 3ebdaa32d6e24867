# SPDX-License-Identifier: Apache-2.0
"""Prim paths of sensors: the bodies, sites and colliders that they name, in one environment and in what all share.

A path matches what lies below the prims that its parts name, in their order. The parts need not follow each other
directly, as importers may put prims of their own in between. The last part is a regular expression for a name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.expressions import full_match, reason_of
from stripe_newton.sim.scene_context import authored_path, is_env_path

__all__ = ["Frame", "OffsetCfg", "find_bodies", "find_colliders", "find_frames", "per_shape", "split_path"]


@configclass
class OffsetCfg:
    """A frame relative to that of a body or site."""

    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin [m]."""
    rot: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation, quaternion (x, y, z, w)."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0.99 < sum(x * x for x in self.rot) ** 0.5 < 1.01:
            yield "rot", f"is {self.rot}, must be a unit quaternion in the order (x, y, z, w)"

    @property
    def rot_xyzw(self) -> tuple[float, float, float, float]:
        """:attr:`rot` as the package reads it; a subclass may keep another order in the field."""
        return self.rot

    @property
    def transform(self) -> wp.transform:
        """The offset as a Warp transform."""
        return wp.transform(wp.vec3(*self.pos), wp.normalize(wp.quat(*self.rot_xyzw)))


@dataclass
class Frame:
    """A frame that is fixed to a body."""

    name: str
    """Name of the body or site."""
    body: int
    """Body of one environment; -1 for what does not move, whose pose is relative to the environment's origin."""
    pose: wp.transform
    """Pose in the body's frame [m]."""

    def at(self, offset: OffsetCfg, name: str = "") -> Frame:
        """The frame that lies at ``offset`` from this one."""
        return Frame(name or self.name, self.body, self.pose * offset.transform)


def split_path(prim_path: str) -> tuple[str, str]:
    """A prim path as the authored path of the parent and the expression below it.

    Raises:
        ValueError: if the parent's path is not a valid one.
    """
    parent, _, expression = prim_path.rpartition("/")
    return authored_path(parent), expression


def find_bodies(builder: newton.ModelBuilder, prim_path: str, where: str) -> tuple[list[int], list[str]]:
    """Bodies that a prim path names, in the builder's order.

    A path that matches no body, but a prim with a single body below it, names that one: the root link of an asset.

    Args:
        builder: One environment.
        prim_path: Path whose last part may be an expression.
        where: Path of the config's field, for the error.

    Returns:
        Bodies, and their names: the last part of the path, or the path where that is ambiguous.

    Raises:
        ConfigError: if there are none; the message says what there is.
    """
    parent, expression = split_path(prim_path)
    below = _below(parent, builder.body_label)
    found = _named(below, expression) or _only_inside(below, expression)
    if not found:
        raise ConfigError([f"{where}: no body at '{prim_path}'; below '{parent}' there is {_list(below.values())}"])
    return list(found), _names(found)


def find_frames(builder: newton.ModelBuilder, prim_path: str, where: str) -> list[Frame]:
    """Frames of the bodies, or else of the sites, that a prim path names.

    Raises:
        ConfigError: if there are none; the message says what there is.
    """
    parent, expression = split_path(prim_path)
    is_site = newton.ShapeFlags.SITE
    labels = {i: label for i, label in enumerate(builder.shape_label) if builder.shape_flags[i] & is_site}
    bodies, sites = _below(parent, builder.body_label), _below(parent, labels)
    on_bodies, on_sites = _named(bodies, expression), _named(sites, expression)
    if on_sites and not on_bodies:  # a site named like a body, such as the frame of a link, gives way to it
        poses = ((builder.shape_body[i], wp.transform(*builder.shape_transform[i])) for i in on_sites)
        return [Frame(name, body, pose) for name, (body, pose) in zip(_names(on_sites), poses)]
    found = on_bodies or _only_inside(bodies, expression)
    if not found:
        there = f"{_list(bodies.values())}, sites: {_list(sites.values())}"
        raise ConfigError([f"{where}: no body or site at '{prim_path}'; below '{parent}' there is {there}"])
    return [Frame(name, body, wp.transform_identity()) for body, name in zip(found, _names(found))]


def find_colliders(
    template: newton.ModelBuilder, static: newton.ModelBuilder, prim_path: str, where: str
) -> dict[str, tuple[list[int], list[int]]]:
    """Colliders of the bodies that a prim path names, or else those at and below the prims that it names.

    Args:
        template: One environment.
        static: What all environments share.
        prim_path: Path whose last part may be an expression.
        where: Path of the config's field, for the error.

    Returns:
        For each body or prim, by name, the shapes in ``template`` and those in ``static``.

    Raises:
        ConfigError: if there are none; the message says what there is.
    """
    parent, expression = split_path(prim_path)
    inside = is_env_path(parent)
    builder = template if inside else static
    bodies = _named(_below(parent, builder.body_label), expression)
    shapes = {name: list(builder.body_shapes[body]) for body, name in zip(bodies, _names(bodies))}
    if not bodies:  # a static prim, or one with bodies below it that count as one filter
        shapes = _shapes_below(builder, parent, expression)
    flags, collides = builder.shape_flags, newton.ShapeFlags.COLLIDE_SHAPES
    colliders = {name: [i for i in found if flags[i] & collides] for name, found in shapes.items()}
    colliders = {name: found for name, found in colliders.items() if found}
    if not colliders:
        labels = [label for label, flag in zip(builder.shape_label, flags) if flag & collides]
        raise ConfigError([f"{where}: no collider at '{prim_path}'; there is {_list(labels)}"])
    return {name: (found, []) if inside else ([], found) for name, found in colliders.items()}


def _shapes_below(builder: newton.ModelBuilder, parent: str, expression: str) -> dict[str, list[int]]:
    """Shapes at and below each prim that the expression names, those of bodies below it included."""
    shapes: dict[str, list[int]] = {}
    below = [(path, [index]) for index, path in _below(parent, builder.shape_label).items()]
    below += [(path, builder.body_shapes[body]) for body, path in _below(parent, builder.body_label).items()]
    for path, indices in below:
        if head := _head(path, expression):
            known = shapes.setdefault(head, [])
            known += [i for i in indices if i not in known]
    return shapes


def per_shape(template: np.ndarray, static: np.ndarray, num_envs: int) -> np.ndarray:
    """A value for each shape of the model, from those of the shapes in one environment and of the shared ones."""
    # Newton adds what is shared first, then one environment after the other.
    return np.concatenate((static, np.tile(template, num_envs))).astype(np.int32)


def _below(parent: str, labels: Sequence[str] | Mapping[int, str]) -> dict[int, str]:
    """The rest of the paths that contain the parts of ``parent`` in their order, by index."""
    parts, found = parent.split("/"), {}
    for index, label in labels.items() if isinstance(labels, Mapping) else enumerate(labels):
        matched = 0
        names = label.split("/")
        for depth, name in enumerate(names):
            matched += matched < len(parts) and name == parts[matched]
            if matched == len(parts) and depth + 1 < len(names):
                found[index] = "/".join(names[depth + 1 :])
                break
    return found


def _named(paths: dict[int, str], expression: str) -> dict[int, str]:
    """Paths that the expression matches, or whose last part it matches; a path equal to it comes alone."""
    # An exact path is no expression: a name with a dot would match others, too.
    exact = {i: p for i, p in paths.items() if p == expression}
    return exact or {i: p for i, p in paths.items() if _fits(expression, p.rpartition("/")[2]) or _fits(expression, p)}


def _only_inside(paths: dict[int, str], expression: str) -> dict[int, str]:
    """The single path below the prim that the expression names; none where there are several."""
    found = {i: p for i, p in paths.items() if _head(p, expression)}
    return found if len(found) == 1 else {}


def _head(path: str, expression: str) -> str:
    """The beginning of a path that the expression names; empty if it names none."""
    parts = path.split("/")
    heads = ("/".join(parts[:depth]) for depth in range(1, len(parts) + 1))
    return next((head for head in heads if _fits(expression, head)), "")


def _fits(expression: str, path: str) -> bool:
    try:
        return full_match(expression, path) is not None
    except re.error as error:
        raise ConfigError([f"prim_path: '{expression}' {reason_of(error)}"]) from None


def _names(paths: dict[int, str]) -> list[str]:
    """Last parts of the paths, or the paths where that is ambiguous."""
    last = [path.rpartition("/")[2] for path in paths.values()]
    return [name if last.count(name) == 1 else path for name, path in zip(last, paths.values())]


def _list(names: Iterable[str]) -> str:
    """Names for an error message, not too many of them."""
    there = list(names)
    return ", ".join(there[:20]) + (", ..." if len(there) > 20 else "") if there else "none"
