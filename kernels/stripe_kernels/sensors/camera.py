# SPDX-License-Identifier: Apache-2.0
"""Cameras: where they look from, and what is made of the pixels that Newton's camera sensor renders."""

import warp as wp

__all__ = ["CameraData", "CameraSetup", "aim_cameras", "clip_depth", "label_shapes"]


@wp.struct
class CameraData:
    """What a camera saw; pixels lie in rows from the upper left. Arrays that were not asked for are empty."""

    pos_w: wp.array[wp.vec3]
    """Position [m], shape ``(num_envs,)``."""
    quat_w_world: wp.array[wp.quat]
    """Orientation, (x, y, z, w), of a frame with x forward and z up, shape ``(num_envs,)``."""
    rgb: wp.array4d[wp.uint8]
    """Colours, sRGB, shape ``(num_envs, height, width, 3)``."""
    distance_to_image_plane: wp.array3d[float]
    """Depth along the optical axis [m], shape ``(num_envs, height, width)``."""
    distance_to_camera: wp.array3d[float]
    """Distance from the camera [m], shape ``(num_envs, height, width)``."""
    normals: wp.array3d[wp.vec3]
    """Unit normals of the surfaces in the world, zero where there is none, shape ``(num_envs, height, width)``."""
    semantic_segmentation: wp.array3d[int]
    """Assets, 0 for none, shape ``(num_envs, height, width)``."""
    instance_segmentation: wp.array3d[int]
    """Bodies and static prims, 0 for none, shape ``(num_envs, height, width)``."""
    instance_id_segmentation: wp.array3d[int]
    """Shapes, 0 for none, shape ``(num_envs, height, width)``."""


@wp.struct
class CameraSetup:
    """What carries a camera, and when it looks."""

    body_pose: wp.array[wp.transform]
    """Poses of the bodies of all environments [m]."""
    body: int
    """The body among those of an environment; negative for a camera that is fixed to the environment."""
    num_bodies: int
    """Bodies of an environment."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments [m], shape ``(num_envs,)``."""
    mount: wp.array[wp.transform]
    """Poses in the frame of the body or the environment, x forward and z up [m], shape ``(num_envs,)``."""
    due: wp.array[wp.bool]
    """Whether it looks in this step, shape ``(num_envs,)``."""


@wp.kernel(enable_backward=False)
def aim_cameras(
    setup: CameraSetup,
    to_opengl: wp.quat,
    idle: int,
    data: CameraData,
    pose: wp.array[wp.transform],
    world: wp.array[int],
):
    """Say from where each environment is seen, and which are not looked at: one thread an environment.

    Args:
        setup: The camera.
        to_opengl: Turns the frame with x forward and z up into one with y up that looks along -z.
        idle: What stands for a world whose picture stays as it is.
        data: Where the pose is noted.
        pose: Poses of the cameras, for the renderer [m], shape ``(num_envs,)``.
        world: Worlds that they show, shape ``(num_envs,)``.
    """
    env = wp.tid()
    if not setup.due[env]:
        world[env] = idle
        return
    at = wp.transform(setup.env_origin[env], wp.quat_identity())
    if setup.body >= 0:
        at = setup.body_pose[env * setup.num_bodies + setup.body]
    at = at * setup.mount[env]
    p, q = wp.transform_get_translation(at), wp.transform_get_rotation(at)
    data.pos_w[env] = p
    data.quat_w_world[env] = q
    pose[env] = wp.transform(p, q * to_opengl)
    world[env] = env


@wp.func
def _clipped(length: float, far: float, missing: float) -> float:
    if length >= 0.0 and length <= far:
        return length
    return missing


@wp.kernel(enable_backward=False)
def clip_depth(
    due: wp.array[wp.bool],
    slant: wp.array2d[float],
    near: float,
    far: float,
    missing: float,
    plane: wp.array3d[float],
    length: wp.array3d[float],
):
    """From what the renderer notes to depths: one thread a pixel.

    Args:
        due: Environments that were looked at, shape ``(num_envs,)``.
        slant: Cosine of each pixel's ray to the optical axis, shape ``(height, width)``.
        near: Depth at which the rays start [m].
        far: Largest depth [m].
        missing: What stands for nothing [m].
        plane: Depths along the axis, negative where nothing was hit [m]; may be empty.
        length: Lengths of the rays from their starts, negative where nothing was hit [m]; may be empty.
    """
    env, row, col = wp.tid()
    if not due[env]:
        return
    if plane.shape[0] > 0:
        plane[env, row, col] = _clipped(plane[env, row, col], far, missing)
    if length.shape[0] > 0:
        ray = length[env, row, col]
        if ray >= 0.0:
            ray += near / slant[row, col]
        length[env, row, col] = _clipped(ray, far, missing)


@wp.kernel(enable_backward=False)
def label_shapes(due: wp.array[wp.bool], shapes: wp.array3d[wp.uint32], labels: wp.array[int], out: wp.array3d[int]):
    """What each pixel shows: one thread a pixel.

    Args:
        due: Environments that were looked at, shape ``(num_envs,)``.
        shapes: Shapes, or a number above all for none, shape ``(num_envs, height, width)``.
        labels: Label of each shape.
        out: Labels, 0 for none, shape ``(num_envs, height, width)``.
    """
    env, row, col = wp.tid()
    if not due[env]:
        return
    shape, label = shapes[env, row, col], wp.int32(0)
    if shape < wp.uint32(labels.shape[0]):
        label = labels[int(shape)]
    out[env, row, col] = label
