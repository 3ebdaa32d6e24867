# SPDX-License-Identifier: Apache-2.0
"""MJCF completion: joint names, servos, effort limits and keyframes that Newton's importer reads otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo

from .mjcf_masses import bodies_of_file
from .mjcf_ref import count_as_the_file

__all__ = ["MjcfStart", "complete_mjcf"]


class MjcfStart:
    """Counts of a builder before an MJCF file is added: what comes after them is the file's."""

    def __init__(self, builder: newton.ModelBuilder):
        self.body, self.joint, self.shape = builder.body_count, builder.joint_count, builder.shape_count
        self.actuator = len(_rows(builder, "ctrl_source"))
        self.equality = len(_rows(builder, "equality_constraint_type"))
        self.tendon = len(_rows(builder, "tendon_type"))

    def actuators_since(self, builder: newton.ModelBuilder) -> int:
        """Number of actuators that were added."""
        return len(_rows(builder, "ctrl_source")) - self.actuator

    def equalities_since(self, builder: newton.ModelBuilder) -> int:
        """Number of MuJoCo's equality constraints that were added."""
        return len(_rows(builder, "equality_constraint_type")) - self.equality

    def tendons_since(self, builder: newton.ModelBuilder) -> int:
        """Number of tendons that were added."""
        return len(_rows(builder, "tendon_type")) - self.tendon


def complete_mjcf(
    builder: newton.ModelBuilder,
    path: str,
    start: MjcfStart,
    keyframe: str | None = None,
    xform: wp.transform | None = None,
    scale: float = 1.0,
) -> None:
    """Complete what ``builder.add_mjcf(path)`` just added.

    * Hinges and slides that share a body, which Newton merges into one joint, get their own names back: the joint is
      labelled ``a+b+c``, one name a degree of freedom.
    * Servos become drives. Newton reads ``<position>`` as a drive that follows the position target, but the same law
      written ``<general biastype="affine">`` as an actuator that pulls towards its own control, for ever zero.
    * The gear of a servo is in the gains of its drive, whose target is the position of the joint.
    * The force range of a drive, and the control range of a ``<motor>`` times its gear, become the joint's effort
      limit, which an actuator config can then replace.
    * Joint coordinates are those of the file, also with ``ref``: see :func:`count_as_the_file`.
    * The positions of ``keyframe`` become the initial ones.

    Args:
        builder: The builder that the file was added to.
        path: The file.
        start: Counts before the file was added.
        keyframe: Name of a keyframe of the file.
        xform: Pose of the file's world frame.
        scale: Scale of lengths.

    Raises:
        ValueError: there is no such keyframe; the message lists what there is.
    """
    count_as_the_file(builder, start.joint, start.equality)
    _servos_to_drives(builder, start.actuator)
    added = range(start.joint, builder.joint_count)
    merged = [j for j in added if builder.joint_type[j] == newton.JointType.D6 and sum(builder.joint_dof_dim[j]) > 1]
    if not merged and keyframe is None:
        return
    # Newton's importer keeps neither the names of merged joints nor keyframes.
    spec = mujoco.MjSpec.from_file(path)
    model = spec.compile()
    by_number = {body.id: body for body in spec.bodies}
    bodies = {own: by_number[there] for own, there in bodies_of_file(builder, start.body, model).items()}
    for joint in merged:
        _restore_names(builder, joint, bodies.get(builder.joint_child[joint]))
    if keyframe is not None:
        _set_keyframe(builder, spec, model, bodies, start.joint, keyframe, xform, scale)


def _restore_names(builder: newton.ModelBuilder, joint: int, body: mujoco.MjsBody | None) -> None:
    """Label a merged joint by the names of the joints of its body."""
    parent, _, own = builder.joint_label[joint].rpartition("/")
    names = [_sanitized(j.name) for j in _joints(body)]
    # Newton joins the names by "_", in an order of its own: the letters tell whether these are its joints.
    if len(names) == sum(builder.joint_dof_dim[joint]) and all(names) and sorted(own) == sorted("_".join(names)):
        builder.joint_label[joint] = f"{parent}/{'+'.join(names)}"


def _set_keyframe(
    builder: newton.ModelBuilder,
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    bodies: dict[int, mujoco.MjsBody],
    first_joint: int,
    keyframe: str,
    xform: wp.transform | None,
    scale: float,
) -> None:
    """Write the positions of a keyframe as the initial ones; MuJoCo's quaternions begin with w."""
    names = [key.name for key in spec.keys]
    if keyframe not in names:
        raise ValueError(f"there is no keyframe '{keyframe}', it has {', '.join(names) or 'none'}")
    qpos = model.key_qpos[names.index(keyframe)]
    for joint in range(first_joint, builder.joint_count):
        start = builder.joint_q_start[joint]
        for own in _joints(bodies.get(builder.joint_child[joint])):
            at = int(model.jnt_qposadr[own.id])
            if own.type == mujoco.mjtJoint.mjJNT_FREE:
                position, quat = qpos[at : at + 3] * scale, qpos[at + 3 : at + 7]
                pose = wp.transform(wp.vec3(*position), wp.quat(*quat[1:], quat[0]))
                values = list(pose if xform is None else xform * pose)
            elif own.type == mujoco.mjtJoint.mjJNT_BALL:
                values = [*qpos[at + 1 : at + 4], qpos[at]]
            else:
                values = [qpos[at] * (scale if own.type == mujoco.mjtJoint.mjJNT_SLIDE else 1.0)]
            builder.joint_q[start : start + len(values)] = [float(v) for v in values]
            start += len(values)


def _joints(body: mujoco.MjsBody | None) -> list[mujoco.MjsJoint]:
    """The joints of an MJCF body in Newton's order: slides come first."""
    joints = list(body.joints) if body is not None else []
    return sorted(joints, key=lambda j: j.type == mujoco.mjtJoint.mjJNT_HINGE)


def _sanitized(name: str) -> str:
    """A name as Newton's importers write it."""
    return name.replace("-", "_")


def _servos_to_drives(builder: newton.ModelBuilder, first: int) -> None:
    """Turn servos among the actuators from ``first`` on into drives, and force ranges into effort limits."""
    source, kind = _rows(builder, "ctrl_source"), _rows(builder, "ctrl_type")
    for row in range(first, len(source)):
        if _value(builder, "actuator_trntype", row) != SolverMuJoCo.TrnType.JOINT:
            continue
        dof = int(_value(builder, "actuator_trnid", row)[0])
        if dof < 0:
            continue
        if source[row] == SolverMuJoCo.CtrlSource.CTRL_DIRECT:
            gains = _servo_gains(builder, row)
            if gains is None:  # a motor, or something else that stays an actuator with a control of its own
                _limit_effort(builder, dof, _motor_range(builder, row))
                continue
            builder.joint_target_ke[dof], builder.joint_target_kd[dof] = gains
            follows = newton.JointTargetMode.POSITION if gains[0] > 0.0 else newton.JointTargetMode.VELOCITY
            builder.joint_target_mode[dof] = int(follows)
            source[row] = int(SolverMuJoCo.CtrlSource.JOINT_TARGET)
            kind[row] = int(SolverMuJoCo.CtrlType.POSITION if gains[0] > 0.0 else SolverMuJoCo.CtrlType.VELOCITY)
        elif (gear := _gear(builder, row)) not in (0.0, 1.0):
            _move_gear_into_gains(builder, row, dof, gear)
        # A range of the drive would hold beside the joint's limit, and an actuator config could not raise it.
        if _limit_effort(builder, dof, _force_range(builder, row)):
            _rows(builder, "actuator_has_forcerange")[row] = 0
            limited = _rows(builder, "actuator_forcelimited")
            if row < len(limited):
                limited[row] = 0  # else a file that says "true" asks for a range that is gone


def _move_gear_into_gains(builder: newton.ModelBuilder, row: int, dof: int, gear: float) -> None:
    """Let a ``<position>`` or ``<velocity>``, whose law is that of gear times the coordinate, be one of its joint."""
    builder.joint_target_ke[dof] *= gear**2
    builder.joint_target_kd[dof] *= gear**2
    if _value(builder, "actuator_has_ctrlrange", row):
        ends = sorted(float(end) / gear for end in _value(builder, "actuator_ctrlrange", row))
        _rows(builder, "actuator_ctrlrange")[row] = wp.vec2(*ends)


def _servo_gains(builder: newton.ModelBuilder, row: int) -> tuple[float, float] | None:
    """Stiffness and damping of a ``<general>`` actuator that is a servo; ``None`` if it is something else."""
    # A position servo is force = kp (control - q) - kd qd: gainprm (kp, 0, 0) and biasprm (0, -kp, -kd).
    affine = _value(builder, "actuator_biastype", row) == 1
    static = _value(builder, "actuator_dyntype", row) == 0 and _value(builder, "actuator_gaintype", row) == 0
    if not (affine and static and _gear(builder, row) == 1.0):
        return None
    gain, (offset, stiffness, damping) = _value(builder, "actuator_gainprm", row)[0], _bias(builder, row)
    if offset != 0.0 or gain <= 0.0 or stiffness > 0.0 or damping > 0.0:
        return None  # a positive bias[2] is a damping ratio, which Newton resolves itself
    # Without stiffness it is a velocity servo, whose control is a velocity: gainprm (kd, 0, 0).
    if np.isclose(gain, -stiffness) or (stiffness == 0.0 and np.isclose(gain, -damping)):
        return -stiffness, -damping
    return None


def _motor_range(builder: newton.ModelBuilder, row: int) -> tuple[float, float] | None:
    """Least and largest effort that a ``<motor>`` can be commanded; ``None`` if unbounded, or if it is no motor."""
    plain = not any(_value(builder, f"actuator_{t}type", row) for t in ("dyn", "gain", "bias"))
    if not plain or not _value(builder, "actuator_has_ctrlrange", row):
        return _force_range(builder, row)
    factor = abs(_gear(builder, row) * _value(builder, "actuator_gainprm", row)[0])
    low, high = _value(builder, "actuator_ctrlrange", row)
    return factor * low, factor * high


def _force_range(builder: newton.ModelBuilder, row: int) -> tuple[float, float] | None:
    """Least and largest effort of an actuator at its joint; ``None`` if unbounded."""
    if not _value(builder, "actuator_has_forcerange", row) or _value(builder, "actuator_forcelimited", row) == 0:
        return None
    low, high = _value(builder, "actuator_forcerange", row)
    factor = abs(_gear(builder, row))
    return factor * low, factor * high


def _limit_effort(builder: newton.ModelBuilder, dof: int, bounds: tuple[float, float] | None) -> bool:
    """Lower the effort limit of a joint to symmetric bounds [N or N m]; returns whether they are symmetric."""
    if bounds is None or not np.isclose(bounds[0], -bounds[1]) or bounds[1] <= 0.0:
        return False
    builder.joint_effort_limit[dof] = min(builder.joint_effort_limit[dof], float(bounds[1]))
    return True


def _gear(builder: newton.ModelBuilder, row: int) -> float:
    return float(_value(builder, "actuator_gear", row)[0])


def _bias(builder: newton.ModelBuilder, row: int) -> Iterator[float]:
    return (float(v) for v in list(_value(builder, "actuator_biasprm", row))[:3])


def _rows(builder: newton.ModelBuilder, name: str) -> list[Any]:
    """Values of an attribute of MuJoCo's by actuator, which may be fewer than there are actuators."""
    attribute = builder.custom_attributes.get(f"mujoco:{name}")
    return attribute.values if attribute is not None and isinstance(attribute.values, list) else []


def _value(builder: newton.ModelBuilder, name: str, row: int) -> Any:
    """The value of a row, which is the attribute's default where nothing was written."""
    values = _rows(builder, name)
    value = values[row] if row < len(values) else None
    return builder.custom_attributes[f"mujoco:{name}"].default if value is None else value
