# SPDX-License-Identifier: Apache-2.0
"""Roaming body: the body of an environment that a camera follows, as it may go anywhere."""

from __future__ import annotations

import newton
import numpy as np

__all__ = ["roaming_body"]

_FREE = int(newton.JointType.FREE), int(newton.JointType.DISTANCE)
_ENDLESS = 1.0e5
"""Limit from which a slide counts as without end [m]."""
_LEVEL = 0.5
"""Level part from which an axis counts as level."""


def roaming_body(template: newton.ModelBuilder) -> int | None:
    """Body of an environment that may go anywhere: a robot that walks, flies or drives.

    That is the first one on a free joint, else the first that slides without end along level ground, as planar robots
    do whose roots are slides, else the first that is on no joint.

    Args:
        template: The bodies and joints of an environment.

    Returns:
        Index of the body in the template; None if nothing goes anywhere.
    """
    joints = list(zip(template.joint_type, template.joint_parent, template.joint_child, strict=True))
    free = [int(child) for kind, parent, child in joints if int(parent) < 0 and int(kind) in _FREE]
    if free:
        return free[0]
    if (sliding := _sliding_body(template, -1)) is not None:
        return sliding
    held = {int(child) for child in template.joint_child}
    return next((body for body in range(template.body_count) if body not in held), None)


def _sliding_body(template: newton.ModelBuilder, base: int) -> int | None:
    """The last body of a chain of endless slides on a body, -1 for the world, of which one at least is level."""
    for joint, (parent, child) in enumerate(zip(template.joint_parent, template.joint_child, strict=True)):
        if int(parent) == base and _is_endless_level_slide(template, joint):
            further = _sliding_body(template, int(child))
            return int(child) if further is None else further
    return None


def _is_endless_level_slide(template: newton.ModelBuilder, joint: int) -> bool:
    first, count = int(template.joint_qd_start[joint]), int(template.joint_dof_dim[joint][0])
    for dof in range(first, first + count):
        endless = template.joint_limit_lower[dof] < -_ENDLESS and template.joint_limit_upper[dof] > _ENDLESS
        if endless and float(np.linalg.norm(np.asarray(template.joint_axis[dof], dtype=float)[:2])) > _LEVEL:
            return True
    return False
