# SPDX-License-Identifier: Apache-2.0
"""Geometry of rubble: distances from capsules, and pieces placed in the world."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from stripe_newton.scene.capsules import Capsules


def distance(colliders, points):
    """Signed distance of points from capsules, in their own frame."""
    found = []
    for c in colliders:
        local = Rotation.from_quat(c.rot).inv().apply(np.asarray(points) - c.pos)
        local[:, 2] -= np.clip(local[:, 2], -c.size[1], c.size[1])
        found.append(np.linalg.norm(local, axis=1) - c.size[0])
    return np.min(found, axis=0)


def corners(mesh):
    return np.concatenate([p.vertices for p in mesh.parts() if not p.name.startswith("steel")]).astype(float)


def placed(instance, points):
    return np.array(instance.position) + instance.scale * Rotation.from_quat(instance.rotation).apply(points)


def capsules(instances):
    poses = [np.array([*i.position, *i.rotation]) for i in instances]
    found = [Capsules.from_colliders(i.mesh.colliders(), p, i.scale) for i, p in zip(instances, poses, strict=True)]
    names = "positions", "rotations", "radius", "half_length"
    return Capsules(*(np.concatenate([getattr(f, name) for f in found]) for name in names))
