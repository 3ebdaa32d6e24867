# SPDX-License-Identifier: Apache-2.0
"""Model data for randomising events: quantities of the model by environment, with their values as built.

Arrays lead with the environment and share memory with ``newton.Model``. A field ``default_x`` holds the value of ``x``
when the model was built. Terms start from it, never from ``x``, so that changes do not add up over episodes::

    @wp.func
    def double_the_mass(env: int, model: BodyModelData, body_ids: wp.array[int]):
        for i in range(body_ids.shape[0]):
            model.mass[env, body_ids[i]] = 2.0 * model.default_mass[env, body_ids[i]]
"""

import warp as wp

__all__ = ["BodyModelData", "EncoderData", "JointModelData", "SceneModelData", "ShapeModelData"]


@wp.struct
class BodyModelData:
    """Masses of the bodies of an asset; shapes ``(num_envs, num_bodies)``."""

    mass: wp.array2d[float]
    """Masses [kg]."""
    inv_mass: wp.array2d[float]
    """Inverse masses [1/kg], 0 for a body without mass."""
    inertia: wp.array2d[wp.mat33]
    """Moments of inertia about the centre of mass, in the body's frame [kg m^2]."""
    inv_inertia: wp.array2d[wp.mat33]
    """Inverse moments of inertia [1/(kg m^2)], 0 for a body without inertia."""
    com: wp.array2d[wp.vec3]
    """Centres of mass in the bodies' frames [m]."""
    default_mass: wp.array2d[float]
    default_inv_mass: wp.array2d[float]
    default_inertia: wp.array2d[wp.mat33]
    default_inv_inertia: wp.array2d[wp.mat33]
    default_com: wp.array2d[wp.vec3]


@wp.struct
class JointModelData:
    """Properties of the joints of an articulation; shapes ``(num_envs, num_joints)``."""

    stiffness: wp.array2d[float]
    """Position gains of the drives, implicit or explicit [N/m or N m/rad]."""
    damping: wp.array2d[float]
    """Velocity gains of the drives, implicit or explicit [N s/m or N m s/rad]."""
    effort_limit: wp.array2d[float]
    """Largest efforts [N or N m]."""
    friction: wp.array2d[float]
    """Coulomb friction [N or N m]."""
    armature: wp.array2d[float]
    """Inertia added to the joints [kg or kg m^2]."""
    passive_stiffness: wp.array2d[float]
    """Stiffness of the springs about the rest positions [N/m or N m/rad]."""
    passive_damping: wp.array2d[float]
    """Damping of the joints themselves [N s/m or N m s/rad]."""
    lower: wp.array2d[float]
    """Lower limits [m or rad]."""
    upper: wp.array2d[float]
    """Upper limits [m or rad]."""
    default_stiffness: wp.array2d[float]
    default_damping: wp.array2d[float]
    default_effort_limit: wp.array2d[float]
    default_friction: wp.array2d[float]
    default_armature: wp.array2d[float]
    default_passive_stiffness: wp.array2d[float]
    default_passive_damping: wp.array2d[float]
    default_lower: wp.array2d[float]
    default_upper: wp.array2d[float]
    initial_joint_pos: wp.array2d[float]
    """Joint positions at the start of an episode, as configured [m or rad]."""


@wp.struct
class ShapeModelData:
    """Properties of all shapes of an environment, colliders and sites; shapes ``(num_envs, num_shapes)``."""

    friction: wp.array2d[float]
    """Coefficients of sliding friction."""
    torsional_friction: wp.array2d[float]
    """Coefficients of torsional friction [m]."""
    rolling_friction: wp.array2d[float]
    """Coefficients of rolling friction [m]."""
    restitution: wp.array2d[float]
    """Coefficients of restitution."""
    margin: wp.array2d[float]
    """Contact margins: distances from the surface at which shapes rest on each other [m]."""
    gap: wp.array2d[float]
    """Contact gaps: distances beyond the margin within which contacts are detected [m]."""
    pose: wp.array2d[wp.transform]
    """Poses in the body's frame [m]."""
    size: wp.array2d[wp.vec3]
    """Sizes in the form of ``newton.Model.shape_scale``: radius, half height, half extents [m]."""
    radius: wp.array2d[float]
    """Radii of the bounding spheres [m]."""
    color: wp.array2d[wp.vec3]
    """Colours, sRGB from 0 to 1."""
    default_friction: wp.array2d[float]
    default_torsional_friction: wp.array2d[float]
    default_rolling_friction: wp.array2d[float]
    default_restitution: wp.array2d[float]
    default_margin: wp.array2d[float]
    default_gap: wp.array2d[float]
    default_pose: wp.array2d[wp.transform]
    default_size: wp.array2d[wp.vec3]
    default_radius: wp.array2d[float]
    default_color: wp.array2d[wp.vec3]
    kind: wp.array[int]
    """``newton.GeoType`` of each shape, shape ``(num_shapes,)``."""


@wp.struct
class SceneModelData:
    """Scene properties of each environment; shapes ``(num_envs, 1)``."""

    gravity: wp.array2d[wp.vec3]
    """Gravity in the world frame [m/s^2]."""
    default_gravity: wp.array2d[wp.vec3]


@wp.struct
class EncoderData:
    """Errors of the joint encoders of an articulation."""

    bias: wp.array2d[float]
    """Encoder readings minus true joint positions [m or rad], shape ``(num_envs, num_joints)``."""
