# SPDX-License-Identifier: Apache-2.0
"""Model names: other names for the joints and bodies of a file, and bodies of their own for some of its shapes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import newton
import warp as wp

from stripe_newton.expressions import full_match, reason_of
from stripe_newton.matching import near_matches

__all__ = ["rename_model", "split_links"]


def rename_model(builder: newton.ModelBuilder, path: str, names: Mapping[str, Mapping[str, str]]) -> None:
    """Rename what a file brought below a prim path.

    Args:
        builder: Builder that the file was added to; its labels are paths.
        path: Prim path of the file.
        names: New names of ``bodies`` and ``joints`` by expression, see ``ModelNamesCfg``.

    Raises:
        ValueError: an expression matches nothing, or two things would have one name; everything at once.
    """
    problems = [
        *_rename(builder.body_label, path, names.get("bodies", {}), "bodies", ""),
        *_rename(builder.joint_label, path, names.get("joints", {}), "joints", "+"),
    ]
    if problems:
        raise ValueError(f"names of '{path}': " + "; ".join(problems))


def _rename(labels: list[str], path: str, expressions: Mapping[str, str], field: str, separator: str) -> Iterator[str]:
    """Rename the last parts of the labels below ``path``; yields what does not fit.

    Args:
        labels: All labels, changed in place.
        path: Prim path.
        expressions: New name, which may refer to groups as ``\\1``, by an expression for the old one.
        field: Name of the table, for errors.
        separator: What joins the names of joints that share a body in one label; empty for none.
    """
    rows = [i for i, label in enumerate(labels) if label.startswith(path + "/")]
    unused, old = dict(expressions), {name for i in rows for name in _parts(labels[i], separator)}
    new: dict[str, str] = {}
    for name in old:
        key = next((k for k in expressions if _match(k, name, path)), None)
        new[name] = name if key is None else _expand(_match(key, name, path), expressions[key], path)
        unused.pop(key or "", None)
    for key in unused:
        near = near_matches(key, sorted(old))
        hint = f"; did you mean {', '.join(near)}?" if near else f"; there is {', '.join(sorted(old)) or 'nothing'}"
        yield f"{field}: '{key}' matches nothing{hint}"
    for name in sorted({n for n in new.values() if list(new.values()).count(n) > 1}):
        yield f"{field}: {', '.join(sorted(o for o, n in new.items() if n == name))} would all be '{name}'"
    for i in rows:
        parent = labels[i].rpartition("/")[0]
        labels[i] = f"{parent}/{(separator or '+').join(new[n] for n in _parts(labels[i], separator))}"


def _parts(label: str, separator: str) -> list[str]:
    last = label.rpartition("/")[2]
    return last.split(separator) if separator else [last]


def split_links(builder: newton.ModelBuilder, path: str, links: Mapping[str, Sequence[str]]) -> None:
    """Give shapes of a body a body of their own, without mass, that a fixed joint holds where the first of them is.

    Args:
        builder: Builder whose last articulation has the bodies.
        path: Prim path of the file.
        links: Name of the new body and expression for its shapes, by an expression for the body; the name may refer to
            groups of that expression as ``\\1``.

    Raises:
        ValueError: an expression matches nothing; all of them at once.
    """
    problems = list[str]()
    for expression, (template, shapes) in links.items():
        found = [
            (body, match)
            for body, label in enumerate(builder.body_label)
            if label.startswith(path + "/") and (match := _match(expression, label.rpartition("/")[2], path))
        ]
        if not found:
            problems.append(f"links: '{expression}' matches no body")
        for body, match in found:
            pattern = _expand(match, shapes, path)
            rows = [s for s in builder.body_shapes[body] if _match(pattern, _last(builder.shape_label[s]), path)]
            if rows:
                _split(builder, body, rows, _expand(match, template, path))
            else:
                there = ", ".join(_last(builder.shape_label[s]) for s in builder.body_shapes[body])
                problems.append(f"links: '{pattern}' matches no shape of '{match[0]}', which has {there or 'none'}")
    if problems:
        raise ValueError(f"names of '{path}': " + "; ".join(problems))


def _match(expression: str, name: str, path: str) -> re.Match[str] | None:
    try:
        return full_match(expression, name)
    except re.error as error:
        raise ValueError(f"names of '{path}': '{expression}' {reason_of(error)}") from None


def _expand(match: re.Match[str] | None, template: str, path: str) -> str:
    """The new name."""
    assert match is not None  # of an expression that was found by matching
    try:
        new = match.expand(template)
    except (re.error, IndexError) as error:
        raise ValueError(
            f"names of '{path}': '{template}' is no name for what '{match.re.pattern}' matches: {error}"
        ) from None
    if not new or "/" in new:
        raise ValueError(f"names of '{path}': '{new[:80]}' is no name: it must not be empty, nor have a '/'")
    return new


def _last(label: str) -> str:
    return label.rpartition("/")[2]


def _split(builder: newton.ModelBuilder, body: int, shapes: list[int], name: str) -> None:
    """Move ``shapes`` of ``body`` to a new body ``name`` at the first of them."""
    origin = wp.transform(wp.transform_get_translation(wp.transform(*builder.shape_transform[shapes[0]])))
    label = f"{builder.body_label[body]}/{name}"
    pose = wp.transform(*builder.body_q[body]) * origin
    incoming = next(j for j in range(builder.joint_count) if builder.joint_child[j] == body)
    articulation = builder.joint_articulation[incoming]
    link = builder.add_link(xform=pose, label=label)
    for shape in shapes:
        builder.body_shapes[body].remove(shape)
        builder.body_shapes.setdefault(link, []).append(shape)
        builder.shape_body[shape] = link
        builder.shape_transform[shape] = wp.transform_inverse(origin) * wp.transform(*builder.shape_transform[shape])
    joint = builder.add_joint_fixed(body, link, parent_xform=origin, label=f"{label}_fixed")
    if articulation >= 0:
        if builder.articulation_end[articulation] != joint:
            raise RuntimeError(f"'{label}': links are split off before other articulations are added")
        builder.joint_articulation[joint] = articulation
        builder.articulation_end[articulation] = joint + 1
