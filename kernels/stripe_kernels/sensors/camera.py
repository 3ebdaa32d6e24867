# SPDX-License-Identifier: Apache-2.0
"""Camera sensor: poses of the cameras, and conversion of the pixels that Newton's camera sensor renders."""

import warp as wp

__all__ = ["CameraData", "CameraSetup", "aim_cameras", "choose_worlds", "clip_depth", "label_shapes"]


@wp.struct
class CameraData:
    """Camera data: pose and images of the last measurement. Rows of pixels run from the upper left corner.

    Images that the sensor's config does not request are empty.
    """

    pos_w: wp.array[wp.vec3]
    """Position in the world [m], shape ``(num_envs,)``."""
    quat_w_world: wp.array[wp.quat]
    """Orientation in the world, (x, y, z, w), of a frame with x forward and z up, shape ``(num_envs,)``."""
    rgb: wp.array4d[wp.uint8]
    """Colours, sRGB, shape ``(num_envs, height, width, 3)``."""
    distance_to_image_plane: wp.array3d[float]
    """Depth along the optical axis [m], shape ``(num_envs, height, width)``."""
    distance_to_camera: wp.array3d[float]
    """Distance from the camera [m], shape ``(num_envs, height, width)``."""
    normals: wp.array3d[wp.vec3]
    """Unit normals of the surfaces in the world, zero where there is none, shape ``(num_envs, height, width)``."""
    semantic_segmentation: wp.array3d[int]
    """Labels of the assets, 0 for none, shape ``(num_envs, height, width)``."""
    instance_segmentation: wp.array3d[int]
    """Labels of bodies and static prims, 0 for none, shape ``(num_envs, height, width)``."""
    instance_id_segmentation: wp.array3d[int]
    """Labels of the shapes, 0 for none, shape ``(num_envs, height, width)``."""
    mount: wp.array[wp.transform]
    """Poses in the frame of the body or the environment, x forward and z up [m], shape ``(num_envs,)``."""
    default_mount: wp.array[wp.transform]
    """Poses by the config, likewise."""
    to_sun: wp.array[wp.vec3]
    """Unit vectors towards the sun in the world, shape ``(num_envs,)``."""
    sun: wp.array[wp.vec3]
    """Radiance of the sun, linear RGB, shape ``(num_envs,)``."""
    sky: wp.array[wp.vec3]
    """Ambient radiance from above, linear RGB, shape ``(num_envs,)``."""
    ground: wp.array[wp.vec3]
    """Ambient radiance from below, linear RGB, shape ``(num_envs,)``."""
    default_to_sun: wp.array[wp.vec3]
    """Direction of the scene's sun, likewise; so are ``default_sun``, ``default_sky`` and ``default_ground``."""
    default_sun: wp.array[wp.vec3]
    default_sky: wp.array[wp.vec3]
    default_ground: wp.array[wp.vec3]


@wp.struct
class CameraSetup:
    """Camera setup: the body that carries the camera, its mounting pose, and the environments that measure."""

    body_pose: wp.array[wp.transform]
    """Poses of the bodies of all environments in the world [m], shape ``(num_envs * num_bodies,)``."""
    body: int
    """Index of the body in an environment; negative for a camera that is fixed to the environment."""
    num_bodies: int
    """Number of bodies in an environment."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments in the world [m], shape ``(num_envs,)``."""
    mount: wp.array[wp.transform]
    """Poses in the frame of the body or the environment, x forward and z up [m], shape ``(num_envs,)``."""
    due: wp.array[wp.bool]
    """Whether an environment takes a picture in this step, shape ``(num_envs,)``."""


@wp.kernel(enable_backward=False)
def aim_cameras(setup: CameraSetup, to_opengl: wp.quat, data: CameraData, pose: wp.array[wp.transform]):
    """Compute the camera poses of environments that are due; one thread an environment.

    Args:
        setup: The camera.
        to_opengl: Rotation from the frame with x forward and z up to OpenGL's, which looks along -z with y up.
        data: Output, position and orientation of the camera.
        pose: Output, poses of the cameras in the world, in OpenGL's convention [m], shape ``(num_envs,)``.
    """
    env = wp.tid()
    if not setup.due[env]:
        return
    at = wp.transform(setup.env_origin[env], wp.quat_identity())
    if setup.body >= 0:
        at = setup.body_pose[env * setup.num_bodies + setup.body]
    at = at * setup.mount[env]
    p, q = wp.transform_get_translation(at), wp.transform_get_rotation(at)
    data.pos_w[env] = p
    data.quat_w_world[env] = q
    pose[env] = wp.transform(p, q * to_opengl)


@wp.kernel(enable_backward=False)
def choose_worlds(due: wp.array[wp.bool], idle: int, world: wp.array[int]):
    """Write the index of each environment that is due, and ``idle`` for the others; one thread an environment."""
    env = wp.tid()
    world[env] = wp.where(due[env], env, idle)


@wp.func
def _depth_or_missing(length: float, far: float, missing: float) -> float:
    """Depth from 0 to ``far`` as it is, and ``missing`` for any other, NaN included [m]."""
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
    """Convert the renderer's ray lengths and depths to those of the sensor, in place; one thread a pixel.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        slant: Cosine of the angle between each pixel's ray and the optical axis, shape ``(height, width)``.
        near: Depth at which the rays start [m].
        far: Largest depth [m].
        missing: Depth of pixels where nothing was hit, or something beyond ``far`` [m].
        plane: Depths along the axis, negative where nothing was hit [m]; may be empty.
        length: Lengths of the rays from their starts, negative where nothing was hit [m]; may be empty.
    """
    env, row, col = wp.tid()
    if not due[env]:
        return
    if plane.shape[0] > 0:
        plane[env, row, col] = _depth_or_missing(plane[env, row, col], far, missing)
    if length.shape[0] > 0:
        ray = length[env, row, col]
        if ray >= 0.0:
            ray += near / slant[row, col]  # rays start on the near plane, distances count from the camera
        length[env, row, col] = _depth_or_missing(ray, far, missing)


@wp.kernel(enable_backward=False)
def label_shapes(due: wp.array[wp.bool], shapes: wp.array3d[wp.uint32], labels: wp.array[int], out: wp.array3d[int]):
    """Write the label of the shape that each pixel shows; one thread a pixel.

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        shapes: Indices of shapes, larger than any index for none, shape ``(num_envs, height, width)``.
        labels: Label of each shape, shape ``(num_shapes,)``.
        out: Output, labels, 0 for none, shape ``(num_envs, height, width)``.
    """
    env, row, col = wp.tid()
    if not due[env]:
        return
    shape, label = shapes[env, row, col], wp.int32(0)
    # Compared as unsigned: a pixel without a shape holds 0xFFFFFFFF, which as an int would be index -1.
    if shape < wp.uint32(labels.shape[0]):
        label = labels[int(shape)]
    out[env, row, col] = label
