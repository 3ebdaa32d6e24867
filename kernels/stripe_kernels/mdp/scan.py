# SPDX-License-Identifier: Apache-2.0
"""Observations of rays: what a height scanner or a range sensor sees.

``ray_ids`` are rays of the sensor, all of them unless ``params`` names some. A thread computes one ray.
"""

import warp as wp

from ..sensors.ray import RayCasterData
from ..term_info import Each, writes

__all__ = ["height_scan"]


@writes(Each("ray_ids"))
@wp.func
def height_scan(env: int, sensor: RayCasterData, ray_ids: wp.array[int], out: wp.array[float], offset: float = 0.5):
    """Height of the sensor over the points that its rays hit, less an offset.

    Formula: ``out_i = p.z - hit_i.z - offset`` [m], ``p`` the body that carries the sensor; minus infinity where a ray
    hits nothing, which a ``clip`` makes finite.

    Source: Isaac Lab, ``mdp.height_scan``.
    """
    for i in range(ray_ids.shape[0]):
        out[i] = sensor.pos_w[env][2] - sensor.ray_hits_w[env, ray_ids[i]][2] - offset
