# SPDX-License-Identifier: Apache-2.0
"""Joint order: the joints and bodies of an articulation in another order than that of its file.

Newton's importers give the joints depth first, PhysX breadth first. Policies and lists of numbers that were made for
one order are wrong in the other, so an :class:`ArticulationCfg` may choose. The builder of one environment is permuted
before it is replicated: all views, solvers and sensors then have that order, and nothing is copied in a step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton import Model
from newton.solvers import SolverMuJoCo

from stripe_newton.configclass import ConfigError

__all__ = ["JointOrder", "order_joints"]

JointOrder = str | Sequence[str]
"""``"file"``, ``"breadth_first"`` or names of joints."""

_Frequency = Model.AttributeFrequency
Rows = dict[Any, list[int]]
"""Old row by new row, by the kind of the rows."""


def order_joints(builder: newton.ModelBuilder, path: str, order: JointOrder) -> None:
    """Permute the joints and bodies of the articulations at or below a prim path.

    Args:
        builder: Builder of one environment, without actuators of Newton's own.
        path: Prim path.
        order: ``"breadth_first"``: by the depth in the tree, then by the order of the parents, then by name, as PhysX
            has the joints of a converted URDF file. Names of joints: these in their order, each as soon as its parent
            is there; joints without a name in the list come directly after their parent. ``"file"`` changes nothing.

    Raises:
        ConfigError: a name is not that of a joint.
    """
    if order == "file":
        return
    for start, end, label in zip(
        builder.articulation_start, builder.articulation_end, builder.articulation_label, strict=True
    ):
        if label == path or label.startswith(path + "/"):
            _permute(builder, range(start, end), _sequence(builder, range(start, end), order, path))


def _sequence(builder: newton.ModelBuilder, joints: range, order: JointOrder, path: str) -> list[int]:
    """The joints of an articulation in the order that is asked for."""
    names = {j: builder.joint_label[j].rpartition("/")[2] for j in joints}
    parents = {builder.joint_child[j]: j for j in reversed(joints)}
    above = {j: parents.get(builder.joint_parent[j], -1) for j in joints}
    if isinstance(order, str):
        if order != "breadth_first":
            raise ConfigError([f"joint_order of '{path}': is '{order}', must be 'file', 'breadth_first' or names"])
        return _breadth_first(joints, above, names)
    if unknown := [name for name in order if name not in names.values()]:
        there = ", ".join(names.values())
        raise ConfigError([f"joint_order of '{path}': no joint {', '.join(unknown)}; there is {there}"])
    rank = {j: order.index(name) if name in order else -1 for j, name in names.items()}
    waiting, done = list(joints), [-1]
    while waiting:
        ready = [j for j in waiting if above[j] in done]
        # An unnamed joint follows its parent directly, the one that was placed last.
        chosen = min(ready, key=lambda j: (rank[j], -done.index(above[j]), j))
        waiting.remove(chosen)
        done.append(chosen)
    return done[1:]


def _breadth_first(joints: range, above: Mapping[int, int], names: Mapping[int, str]) -> list[int]:
    by_name = sorted(joints, key=names.__getitem__)
    done, level = list[int](), [-1]
    while level:
        level = [j for parent in level for j in by_name if above[j] == parent]
        done += level
    return done


def _permute(builder: newton.ModelBuilder, joints: range, sequence: list[int]) -> None:
    """Put the joints of an articulation into the order of ``sequence``, and its bodies after them."""
    if sequence == list(joints):
        return
    if builder.actuator_entries or builder._body_variants:
        raise RuntimeError("joints are ordered before actuators and variants are added")
    rows = _old_rows(builder, joints, sequence)
    new = {kind: _inverse(old) for kind, old in rows.items()}
    starts = _starts(builder, rows[_Frequency.JOINT])
    # Newton's own table of what its lists hold, by which it merges builders: it has no public form.
    for name, spec in builder._builder_merge_attribute_specs().items():
        values = getattr(builder, name)
        if spec.compaction_policy != "generic" or not values:
            continue
        if spec.frequency in rows:
            values[:] = [values[old] for old in rows[spec.frequency]]
        if spec.references in new:
            values[:] = [_mapped(value, new[spec.references]) for value in values]
    for name, found in starts.items():
        getattr(builder, name)[:] = found
    _permute_tables(builder, new)
    _permute_custom(builder, rows, new)


def _old_rows(builder: newton.ModelBuilder, joints: range, sequence: list[int]) -> Rows:
    """Old row by new row of each kind of rows."""
    spans = {
        _Frequency.JOINT_DOF: (builder.joint_qd_start, builder.joint_dof_count),
        _Frequency.JOINT_COORD: (builder.joint_q_start, builder.joint_coord_count),
        _Frequency.JOINT_CONSTRAINT: (builder.joint_cts_start, builder.joint_constraint_count),
    }
    order = [*range(joints.start), *sequence, *range(joints.stop, builder.joint_count)]
    rows: Rows = {_Frequency.JOINT: order}
    for kind, (starts, count) in spans.items():
        ends = [*starts[1:], count]
        rows[kind] = [row for j in order for row in range(starts[j], ends[j])]
    bodies = list(dict.fromkeys(builder.joint_child[j] for j in sequence))
    rows[_Frequency.BODY] = list(range(builder.body_count))
    for place, body in zip(sorted(bodies), bodies, strict=True):
        rows[_Frequency.BODY][place] = body
    return rows


def _inverse(old: Sequence[int]) -> dict[int, int]:
    return {row: place for place, row in enumerate(old)}


def _starts(builder: newton.ModelBuilder, order: Sequence[int]) -> dict[str, list[int]]:
    """First rows of the joints in their new order."""
    found = {}
    for name, count in (
        ("joint_q_start", builder.joint_coord_count),
        ("joint_qd_start", builder.joint_dof_count),
        ("joint_cts_start", builder.joint_constraint_count),
    ):
        ends = [*getattr(builder, name), count]
        sizes = [ends[j + 1] - ends[j] for j in order]
        found[name] = [int(x) for x in np.cumsum([0, *sizes])[:-1]]
    return found


def _permute_tables(builder: newton.ModelBuilder, new: Mapping[Any, dict[int, int]]) -> None:
    """The dictionaries of a builder that hold bodies and joints."""
    joint, body = new[_Frequency.JOINT], {**new[_Frequency.BODY], -1: -1}
    shapes = {body[b]: found for b, found in builder.body_shapes.items()}
    builder.body_shapes.clear()
    builder.body_shapes.update(sorted(shapes.items()))
    for table in (builder.joint_parents, builder.joint_children):
        changed = {body[b]: [(body[other], joint[j]) for other, j in pairs] for b, pairs in table.items()}
        table.clear()
        table.update(changed)


def _permute_custom(builder: newton.ModelBuilder, rows: Rows, new: Mapping[Any, dict[int, int]]) -> None:
    """Custom attributes: rows by joint, degree of freedom or body, and what refers to these."""
    for name, attribute in builder.custom_attributes.items():
        references = new.get(Model._normalize_attribute_reference(attribute.references))
        if attribute.frequency in rows and isinstance(attribute.values, dict):
            place = new[attribute.frequency]
            attribute.values = {place[row]: value for row, value in attribute.values.items()}
        if references is not None and attribute.values:
            attribute.values = _each(attribute.values, lambda value, table=references: _mapped(value, table))
        elif attribute.values and name in _BY_KIND:
            attribute.values = _BY_KIND[name](builder, attribute.values, new)


def _each(values: Any, change: Any) -> Any:
    if isinstance(values, dict):
        return {row: change(value) for row, value in values.items()}
    return [change(value) for value in values]


def _mapped(value: Any, table: Mapping[int, int]) -> Any:
    """A row, or rows, after the permutation; negative ones stand for none or the world."""
    if isinstance(value, (tuple, list)):
        return type(value)(_mapped(v, table) for v in value)
    if wp.types.type_is_vector(type(value)):
        return type(value)(*(_mapped(int(v), table) for v in value))
    return value if value is None or int(value) < 0 else table[int(value)]


def _targets_of_actuators(builder: newton.ModelBuilder, values: list[Any], new: Mapping[Any, dict[int, int]]) -> Any:
    """Targets of MuJoCo's actuators: a degree of freedom or a body, by the kind of transmission."""
    kinds = builder.custom_attributes["mujoco:actuator_trntype"]
    transmission = SolverMuJoCo.TrnType
    tables = {
        transmission.JOINT: new[_Frequency.JOINT_DOF],
        transmission.JOINT_IN_PARENT: new[_Frequency.JOINT_DOF],
        transmission.BODY: new[_Frequency.BODY],
    }
    found = []
    for row, value in enumerate(values):
        kind = kinds.values[row] if kinds.values and row < len(kinds.values) else None
        table = tables.get(int(kinds.default if kind is None else kind))
        if value is not None and table is not None:
            value = wp.vec2i(_mapped(int(value[0]), table), int(value[1]))
        found.append(value)
    return found


def _targets_of_equalities(builder: newton.ModelBuilder, values: list[Any], new: Mapping[Any, dict[int, int]]) -> Any:
    """Targets of MuJoCo's equality constraints that are joints: kind 1 of Newton's importers."""
    kinds = builder.custom_attributes["mujoco:equality_constraint_target_kind"].values or []
    joints = new[_Frequency.JOINT]
    return [
        _mapped(value, joints) if row < len(kinds) and kinds[row] is not None and int(kinds[row]) == 1 else value
        for row, value in enumerate(values)
    ]


_BY_KIND = {
    "mujoco:actuator_trnid": _targets_of_actuators,
    "mujoco:equality_constraint_target": _targets_of_equalities,
}
"""Attributes whose rows refer to one kind or another, and what maps them."""
