# SPDX-License-Identifier: Apache-2.0
"""Ray caster: rays from a body, their measurements, and the kernels for rays against a height field alone."""

import warp as wp

from .ray_field import RayField, field_height, march_field

__all__ = [
    "ALIGN_BASE",
    "ALIGN_WORLD",
    "ALIGN_YAW",
    "RayCasterData",
    "RaySetup",
    "march_rays",
    "place_rays",
    "ray_in_world",
    "scan_field",
    "write_ray",
]

ALIGN_BASE = wp.constant(0)
"""Alignment of rays: they turn with the body."""
ALIGN_YAW = wp.constant(1)
"""Alignment of rays: they turn with the body's heading only."""
ALIGN_WORLD = wp.constant(2)
"""Alignment of rays: they keep their direction in the world."""


@wp.struct
class RayCasterData:
    """Ray caster data: pose of the sensor, hit points and lengths of the rays."""

    pos_w: wp.array[wp.vec3]
    """Position in the world of the body that carries the sensor, with drift [m], shape ``(num_envs,)``."""
    quat_w: wp.array[wp.quat]
    """Orientation of that body in the world, (x, y, z, w), shape ``(num_envs,)``."""
    ray_hits_w: wp.array2d[wp.vec3]
    """Hit points in the world [m], infinite where a ray hits nothing, shape ``(num_envs, num_rays)``."""
    distances: wp.array2d[float]
    """Lengths of the rays [m], ``max_distance`` where they hit nothing, shape ``(num_envs, num_rays)``."""


@wp.struct
class RaySetup:
    """Ray caster setup: starts and directions of the rays, their drift, and the environments that measure."""

    body_pose: wp.array[wp.transform]
    """Poses of the bodies of all environments in the world [m], shape ``(num_envs * num_bodies,)``."""
    body: int
    """Index of the body in an environment; negative for a sensor that is fixed to the environment."""
    num_bodies: int
    """Number of bodies in an environment."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments in the world [m], shape ``(num_envs,)``."""
    starts: wp.array[wp.vec3]
    """Starts of the rays in the body's frame [m], shape ``(num_rays,)``."""
    directions: wp.array[wp.vec3]
    """Unit vectors along the rays in the body's frame, shape ``(num_rays,)``."""
    alignment: int
    """Alignment of the rays, one of the ``ALIGN`` constants."""
    max_distance: float
    """Length of the rays [m]."""
    missed: float
    """Measured length of a ray that hits nothing [m]."""
    drift: wp.array[wp.vec3]
    """Error of the body's position in the world [m], shape ``(num_envs,)``."""
    ray_drift: wp.array[wp.vec3]
    """Shift x, y of the starts in the frame of the rays, and z of the hit points in the world [m], shape
    ``(num_envs,)``."""
    due: wp.array[wp.bool]
    """Whether an environment measures in this step, shape ``(num_envs,)``."""


# -- starts and directions


@wp.func
def _body_pose(env: int, setup: RaySetup) -> wp.transform:
    """Pose in the world of the body that carries the sensor, with drift [m]."""
    pose = wp.transform(setup.env_origin[env], wp.quat_identity())
    if setup.body >= 0:
        pose = setup.body_pose[env * setup.num_bodies + setup.body]
    return wp.transform(wp.transform_get_translation(pose) + setup.drift[env], wp.transform_get_rotation(pose))


@wp.func
def _rotate_to_world(alignment: int, q: wp.quat, v: wp.vec3) -> wp.vec3:
    """Rotate a vector from the frame of the rays to the world, for a body of orientation ``q``."""
    if alignment == ALIGN_BASE:
        return wp.quat_rotate(q, v)
    if alignment == ALIGN_WORLD:
        return v
    # (x, y) is the body's x axis seen from above: its direction gives cosine and sine of the yaw without atan2.
    x = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    y = 2.0 * (q[0] * q[1] + q[2] * q[3])
    length = wp.sqrt(x * x + y * y)
    if length < 1.0e-6:  # the body's x axis is vertical: it has no heading
        return v
    c, s = x / length, y / length
    return wp.vec3(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


@wp.func
def _ray_from_pose(env: int, ray: int, p: wp.vec3, q: wp.quat, setup: RaySetup) -> tuple[wp.vec3, wp.vec3]:
    """Start and unit direction of a ray in the world, for a body at position ``p`` with orientation ``q``."""
    shift = setup.ray_drift[env]
    start = p + _rotate_to_world(setup.alignment, q, setup.starts[ray] + wp.vec3(shift[0], shift[1], 0.0))
    return start, _rotate_to_world(setup.alignment, q, setup.directions[ray])


@wp.func
def ray_in_world(env: int, ray: int, setup: RaySetup, data: RayCasterData) -> tuple[wp.vec3, wp.vec3]:
    """Start and unit direction of a ray in the world; the thread of ray 0 also writes the body's pose to ``data``."""
    pose = _body_pose(env, setup)
    p, q = wp.transform_get_translation(pose), wp.transform_get_rotation(pose)
    if ray == 0:
        data.pos_w[env] = p
        data.quat_w[env] = q
    start, direction = _ray_from_pose(env, ray, p, q, setup)
    return start, direction


@wp.func
def write_ray(
    env: int, ray: int, start: wp.vec3, direction: wp.vec3, distance: float, setup: RaySetup, data: RayCasterData
):
    """Write hit point and length of a ray; a negative distance [m] means that it hit nothing."""
    hit = wp.vec3(wp.inf, wp.inf, wp.inf)
    length = setup.missed
    if distance >= 0.0 and distance <= setup.max_distance:
        length = distance
        hit = start + distance * direction + wp.vec3(0.0, 0.0, setup.ray_drift[env][2])
    data.ray_hits_w[env, ray] = hit
    data.distances[env, ray] = length


# -- kernels


@wp.kernel(enable_backward=False)
def scan_field(setup: RaySetup, field: RayField, data: RayCasterData):
    """Cast rays that point straight down by a height lookup each; one thread a ray."""
    env, ray = wp.tid()
    if setup.due[env]:
        start, direction = ray_in_world(env, ray, setup, data)
        write_ray(env, ray, start, direction, start[2] - field_height(field, start[0], start[1]), setup, data)


@wp.kernel(enable_backward=False)
def march_rays(setup: RaySetup, field: RayField, data: RayCasterData):
    """Cast rays of any direction against the height field alone; one thread a ray."""
    env, ray = wp.tid()
    if setup.due[env]:
        start, direction = ray_in_world(env, ray, setup, data)
        write_ray(env, ray, start, direction, march_field(field, start, direction, setup.max_distance), setup, data)


@wp.kernel(enable_backward=False)
def place_rays(setup: RaySetup, measured: wp.array2d[float], data: RayCasterData):
    """Compute hit points from a pose and lengths that went through noise and delay; one thread a ray.

    Args:
        setup: The sensor.
        measured: Position, quaternion (x, y, z, w), then the lengths, infinite where a ray hit nothing, shape
            ``(num_envs, 7 + num_rays)``.
        data: Output, the measurement.
    """
    env, ray = wp.tid()
    if not setup.due[env]:
        return
    p = wp.vec3(measured[env, 0], measured[env, 1], measured[env, 2])
    q = wp.quat(measured[env, 3], measured[env, 4], measured[env, 5], measured[env, 6])
    if ray == 0:
        data.pos_w[env] = p
        data.quat_w[env] = q
    start, direction = _ray_from_pose(env, ray, p, q, setup)
    length = measured[env, 7 + ray]
    # Noise may make a short length negative, which write_ray would take for a miss.
    if length <= setup.max_distance:
        length = wp.max(length, 0.0)
    else:
        length = -1.0
    write_ray(env, ray, start, direction, length, setup, data)
