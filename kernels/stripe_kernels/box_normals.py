# SPDX-License-Identifier: Apache-2.0
"""Box normals: normals of boxes that Newton's camera sensor leaves zero.

The sensor finds the face of a box that a ray hits by two distances to it that agree within 1e-6 m. Single precision
does not keep that beyond some 8 m, so that large floors and walls get spots without a normal.
"""

import newton
import warp as wp

__all__ = ["box_normal", "fill_box_normals"]

_BOX = wp.constant(int(newton.GeoType.BOX))
_END = wp.constant(1.0e30)


@wp.func
def box_normal(start: wp.vec3, direction: wp.vec3, half: wp.vec3) -> wp.vec3:
    """Normal of the face through which a ray that hits a box enters it, or leaves it if it starts inside.

    The slab method (Kay and Kajiya 1986), all in the frame of the box.
    """
    enter, leave = wp.float32(-_END), wp.float32(_END)
    first, last = wp.int32(2), wp.int32(2)
    for axis in range(3):
        if direction[axis] != 0.0:
            middle = -start[axis] / direction[axis]
            reach = half[axis] / wp.abs(direction[axis])
            if middle - reach > enter:
                enter, first = middle - reach, axis
            if middle + reach < leave:
                leave, last = middle + reach, axis
    normal = wp.vec3(0.0)
    if enter >= 0.0:
        normal[first] = -wp.sign(direction[first])
    else:
        normal[last] = wp.sign(direction[last])
    return normal


@wp.kernel(enable_backward=False)
def fill_box_normals(
    camera: wp.array[wp.transform],
    rays: wp.array4d[wp.vec3],
    shape: wp.array3d[wp.uint32],
    kind: wp.array[int],
    scale: wp.array[wp.vec3],
    body: wp.array[int],
    offset: wp.array[wp.transform],
    body_pose: wp.array[wp.transform],
    normals: wp.array3d[wp.vec3],
):
    """Fill in the normals that are zero where a ray hit a box; one thread a ray.

    Args:
        camera: Poses of the cameras in the world, shape ``(cameras,)``.
        rays: Starts and directions of the rays in the frames of the cameras, shape ``(height, width, 1, 2)``.
        shape: Shapes that the rays hit, shape ``(cameras, height, width)``.
        kind: ``newton.GeoType`` of the shapes, shape ``(num_shapes,)``.
        scale: Half extents of the boxes [m], shape ``(num_shapes,)``.
        body: Bodies of the shapes, -1 for the world, shape ``(num_shapes,)``.
        offset: Poses of the shapes in the frames of their bodies, shape ``(num_shapes,)``.
        body_pose: Poses of the bodies in the world, shape ``(num_bodies,)``.
        normals: Unit normals in the world, shape ``(cameras, height, width)``.
    """
    c, row, column = wp.tid()
    hit = shape[c, row, column]
    if hit >= wp.uint32(kind.shape[0]):  # nothing
        return
    i = int(hit)
    if kind[i] != _BOX or wp.length_sq(normals[c, row, column]) > 0.5:
        return
    pose = offset[i]
    if body[i] >= 0:
        pose = wp.transform_multiply(body_pose[body[i]], pose)
    to_box = wp.transform_multiply(wp.transform_inverse(pose), camera[c])
    start = wp.transform_point(to_box, rays[row, column, 0, 0])
    direction = wp.transform_vector(to_box, rays[row, column, 0, 1])
    normals[c, row, column] = wp.transform_vector(pose, box_normal(start, direction, scale[i]))
