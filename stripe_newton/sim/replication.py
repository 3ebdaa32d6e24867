# SPDX-License-Identifier: Apache-2.0
"""Replication: the builder of all environments, from that of one and that of what they share."""

from __future__ import annotations

from collections.abc import Sequence

import newton
import numpy as np
import warp as wp

from .body_choice import BodyChoice

__all__ = ["absent_shapes", "put_choices", "put_unmoved", "replicate"]


def replicate(
    builder: newton.ModelBuilder,
    template: newton.ModelBuilder,
    static: newton.ModelBuilder,
    origins: np.ndarray,
    gravity: Sequence[float] | None,
) -> newton.ModelBuilder:
    """Fill a builder with what all environments share, then with copies of one environment.

    Args:
        builder: An empty builder.
        template: One environment, at the origin.
        static: What all environments share.
        origins: Where the environments are [m], shape ``(num_envs, 3)``.
        gravity: Gravity of the settings [m/s^2]; None for those of the builders.
    """
    builder.add_builder(static)  # first: shared shapes come before those of the environments
    # Newton has a gravity for each world and one for what belongs to none: both builders must say the same.
    builder.gravity = static.gravity if gravity is None else wp.vec3(*gravity)
    template.gravity = template.gravity if gravity is None else wp.vec3(*gravity)
    poses = [wp.transform(wp.vec3(*map(float, origin)), wp.quat_identity()) for origin in origins]
    builder.replicate(template, len(origins), xforms=poses)
    return builder


def put_unmoved(builder: newton.ModelBuilder, template: newton.ModelBuilder, num_envs: int, joints: range) -> None:
    """Put copies of some joints and their bodies back to where the template has them: a world is not moved.

    Args:
        builder: The builder of all environments.
        template: One environment.
        num_envs: Number of environments.
        joints: Joints of the template.
    """
    bodies = sorted({template.joint_child[j] for j in joints})
    coords = template.joint_q_start
    ends = [*coords[1 : template.joint_count], template.joint_coord_count]
    for env in range(num_envs):
        for body in bodies:
            builder.body_q[env * template.body_count + body] = template.body_q[body]
        for joint in joints:
            copy, shift = env * template.joint_count + joint, env * template.joint_coord_count
            builder.joint_X_p[copy] = template.joint_X_p[joint]
            for i in range(coords[joint], ends[joint]):
                builder.joint_q[shift + i] = template.joint_q[i]


def put_choices(
    builder: newton.ModelBuilder,
    template: newton.ModelBuilder,
    num_envs: int,
    shared_shapes: int,
    choices: Sequence[BodyChoice],
) -> None:
    """Write the assets that environments have in each other's place.

    Args:
        builder: The builder of all environments.
        template: One environment.
        num_envs: Number of environments.
        shared_shapes: Shapes that all environments share; they come first.
        choices: Bodies that are another asset in each environment.
    """
    for choice in choices:
        for env in range(num_envs):
            choice.write(builder, env, shared_shapes + env * template.shape_count, env * template.body_count)


def absent_shapes(
    template: newton.ModelBuilder, num_envs: int, shared_shapes: int, choices: Sequence[BodyChoice]
) -> np.ndarray:
    """Shapes of the model that the environment they belong to does not have, shape ``(count,)``.

    Args:
        template: One environment.
        num_envs: Number of environments.
        shared_shapes: Shapes that all environments share; they come first.
        choices: Bodies that are another asset in each environment.
    """
    lacking = [
        shared_shapes + env * template.shape_count + row
        for choice in choices
        for env in range(num_envs)
        for row in choice.absent(env)
    ]
    return np.array(lacking, dtype=int)
