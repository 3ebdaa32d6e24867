# SPDX-License-Identifier: Apache-2.0
"""Ray observations: measurements of a height scanner or a range sensor.

``ray_ids`` are rays of the sensor, all of them unless ``params`` names some. One thread computes one ray.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..removed_tables import forward_tables
from ..sensors.ray import RayCasterData
from ..term_info import Each, writes

__all__ = ["height_scan"]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"SCAN_OBSERVATION_SIZES": __name__})


@writes(Each("ray_ids"))
@wp.func
def height_scan(env: int, sensor: RayCasterData, ray_ids: wp.array[int], out: wp.array[float], offset: float = 0.5):
    """Height scan: height of the sensor above the points that its rays hit, less an offset.

    Formula: ``out_i = p.z - hit_i.z - offset`` [m], ``p`` the body that carries the sensor; minus infinity where a ray
    hits nothing, which a ``clip`` makes finite.

    Source: Isaac Lab, ``mdp.height_scan``.
    """
    for i in range(ray_ids.shape[0]):
        out[i] = sensor.pos_w[env][2] - sensor.ray_hits_w[env, ray_ids[i]][2] - offset
