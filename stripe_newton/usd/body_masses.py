# SPDX-License-Identifier: Apache-2.0
"""Body masses: reasons to refuse the masses and inertias of bodies, whatever the file that they were read from."""

from __future__ import annotations

import math
from collections.abc import Iterator

import newton
import numpy as np
from newton import JointType

from .builder_start import BuilderStart

__all__ = ["MUJOCO_MINIMUM", "mass_problems", "moments_problem"]

MUJOCO_MINIMUM = 1.0e-15
"""Least mass and moment of inertia of a moving body in MuJoCo, ``mjMINVAL``."""
_NOISE, _LEAST = 1.0e-6, 1.0e-18
"""Negative moment of inertia that is rounding: in parts of the largest one, and in any case [kg m^2]."""


def mass_problems(builder: newton.ModelBuilder, start: BuilderStart, smallest: float) -> Iterator[tuple[int, str]]:
    """Bodies that cannot be simulated for their mass or inertia.

    Args:
        builder: The builder.
        start: What was in it before the file.
        smallest: Least mass [kg] and moment of inertia [kg m^2] that the solver takes.

    Yields:
        A body and what is wrong with it.
    """
    group = _group_masses(builder, start)
    # Where bodies are welded together, the first one speaks for all.
    welded = {builder.joint_child[j] for j in range(start.joint, builder.joint_count) if _is_weld(builder, j)}
    for body in range(start.body, builder.body_count):
        mass, inertia = builder.body_mass[body], np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
        if mass < 0.0 or not math.isfinite(mass):
            yield body, f"has mass {mass:g}; it must be positive and finite"
        elif body not in welded and not group[body] > 0.0:
            remedy = (
                "give it mass and inertia (physics:mass, <inertial>) or a collider with a density, or fix its joint"
            )
            yield body, f"moves and has no mass; {remedy}"
        elif mass > 0.0 and (problem := moments_problem(inertia)):
            yield body, f"its inertia has {problem}"
        elif mass > 0.0 and not math.isinf(group[body]):
            least = float(_moments(inertia)[0])  # 0 is what balance_inertias replaces
            if mass < smallest or 0.0 < least < smallest:
                what = f"has mass {mass:g} kg and a moment of inertia of {least:g} kg m^2"
                yield body, f"{what}; MuJoCo takes {smallest:g} or more: are the units right?"


def moments_problem(inertia: np.ndarray) -> str:
    """Problem of the principal moments of an inertia tensor; empty if there is none, or they are 0.

    Args:
        inertia: The tensor [kg m^2], shape ``(3, 3)``.
    """
    if not np.isfinite(inertia).all():
        return f"the components {', '.join(f'{m:g}' for m in inertia.reshape(-1))} kg m^2, must be finite"
    moments = _moments(inertia)
    if moments[0] >= -max(_NOISE * moments[-1], _LEAST):
        return ""
    text = ", ".join(f"{m:.3g}" for m in moments)
    return f"the principal moments {text} kg m^2, must be positive; check its signs and its frame"


def _moments(inertia: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh((inertia + inertia.T) / 2)


def _is_weld(builder: newton.ModelBuilder, joint: int) -> bool:
    return builder.joint_type[joint] == JointType.FIXED and builder.joint_articulation[joint] >= 0


def _group_masses(builder: newton.ModelBuilder, start: BuilderStart) -> dict[int, float]:
    """Mass of each body with everything that is welded to it; infinite where that is the world."""
    # Union-find over the fixed joints; -1 is the world.
    group = {body: body for body in range(-1, builder.body_count)}

    def top(body: int) -> int:
        while group[body] != body:
            body = group[body]
        return body

    for joint in range(start.joint, builder.joint_count):
        if _is_weld(builder, joint):
            group[top(builder.joint_child[joint])] = top(builder.joint_parent[joint])
    masses = dict.fromkeys(group, 0.0)
    masses[top(-1)] = math.inf
    for body in range(start.body, builder.body_count):
        masses[top(body)] += builder.body_mass[body]
    return {body: masses[top(body)] for body in group}
