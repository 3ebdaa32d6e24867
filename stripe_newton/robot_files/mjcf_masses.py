# SPDX-License-Identifier: Apache-2.0
"""MJCF masses: mass, centre of mass and inertia of bodies as MuJoCo's compiler computes them."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import newton
import numpy as np
import warp as wp

from .urdf_checks import Row

__all__ = ["bodies_of_file", "has_medium", "take_compiled_masses"]

_RELATIVE = 1e-4
"""Differences below this share are those of single precision: there the importer's numbers stay."""
_APART = 1e-4
"""Share by which moments of inertia that are equal within a tenth of it are set apart in a medium."""


def take_compiled_masses(builder: newton.ModelBuilder, first_body: int, model: mujoco.MjModel) -> Iterator[Row]:
    """Give bodies the mass properties that MuJoCo's compiler finds, where Newton's importer finds others.

    The compiler has settings that the importer does not know: ``settotalmass``, ``inertiagrouprange``, ``boundmass``,
    ``balanceinertia``, and how the inertia of a mesh is computed.

    In a medium equal moments are set apart by a hundredth of a per cent. The forces of the medium act along the
    principal axes, and MuJoCo Warp's axes of a sphere, a cube or a cylinder would be others than those of the file.

    Args:
        builder: The builder that the file was added to, in its scale and without bodies merged.
        first_body: Number of bodies before.
        model: MuJoCo's model of the file.

    Yields:
        A row for each body whose moments were set apart.
    """
    medium = has_medium(model)
    for body, there in bodies_of_file(builder, first_body, model).items():
        mass = float(model.body_mass[there])
        if not mass > 0.0:
            continue
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.body_iquat[there])
        axes, moments = rotation.reshape(3, 3), np.array(model.body_inertia[there])
        ambiguous = medium and np.diff(np.sort(moments)).min() < 0.1 * _APART * moments.max()
        if ambiguous:
            moments *= 1.0 + _APART * np.array([2.0, 1.0, 0.0])
            why = (
                f"of equal moments two are made {_APART:.2%} and {2.0 * _APART:.2%} larger: the medium acts along the "
            )
            why += "principal axes, and MuJoCo Warp's of equal moments would not be the file's"
            yield model.body(there).name or f"body {there}", "inertia", why
        inertia = axes @ np.diag(moments) @ axes.T
        own = np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
        if ambiguous or not (
            np.isclose(builder.body_mass[body], mass, rtol=_RELATIVE)
            and np.allclose(builder.body_com[body], model.body_ipos[there], rtol=_RELATIVE, atol=1e-6)
            and np.allclose(own, inertia, rtol=_RELATIVE, atol=_RELATIVE * np.abs(inertia).max())
        ):
            builder.body_mass[body], builder.body_inv_mass[body] = mass, 1.0 / mass
            builder.body_com[body] = wp.vec3(*model.body_ipos[there])
            builder.body_inertia[body] = wp.mat33(*inertia.reshape(-1))
            builder.body_inv_inertia[body] = wp.mat33(*np.linalg.inv(inertia).reshape(-1))


def has_medium(model: mujoco.MjModel) -> bool:
    """Whether a fluid acts on the bodies of a file."""
    return bool(model.opt.density or model.opt.viscosity or np.any(model.opt.wind))


def bodies_of_file(builder: newton.ModelBuilder, first_body: int, model: mujoco.MjModel) -> dict[int, int]:
    """The file's body for each of the builder from ``first_body`` on: by name, or by order if all are there."""
    bodies = range(first_body, builder.body_count)
    in_order = len(bodies) == model.nbody - 1
    names = {model.body(b).name.replace("-", "_"): b for b in range(1, model.nbody) if model.body(b).name}
    found = {
        b: names.get(builder.body_label[b].rpartition("/")[2], b - first_body + 1 if in_order else -1) for b in bodies
    }
    return {body: there for body, there in found.items() if there >= 0}
