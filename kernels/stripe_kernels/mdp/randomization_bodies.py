# SPDX-License-Identifier: Apache-2.0
"""Randomisation of bodies: events that change masses, inertias and centres of mass.

``operation`` and ``distribution`` are codes of ``randomization.OPERATIONS`` and ``DISTRIBUTIONS``; a config gives their
names. A body without mass stays without.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..model_data import BodyModelData
from ..removed_tables import forward_tables
from ..term_info import randomizes
from . import random
from .randomization import operate, sample

__all__ = [
    "randomize_pseudo_inertia",
    "randomize_rigid_body_com",
    "randomize_rigid_body_inertia",
    "randomize_rigid_body_mass",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, randomizations={"BODY_RANDOMIZATIONS": __name__})

_STAY = (0.0, 0.0)
_PSEUDO = ("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3")


@wp.func
def _inverse_or_zero(matrix: wp.mat33) -> wp.mat33:
    """Inverse of a matrix with a positive determinant, else zero: that of a body that cannot be turned."""
    if wp.determinant(matrix) > 0.0:
        return wp.inverse(matrix)
    return wp.mat33()


@wp.func
def _is_positive(m: wp.mat33) -> bool:
    """Whether a symmetric matrix is positive definite, by Sylvester's criterion: its leading minors are positive."""
    minor = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    return m[0, 0] > 0.0 and minor > 0.0 and wp.determinant(m) > 0.0


@wp.func
def _write_mass(env: int, model: BodyModelData, body: int, mass: float):
    """Write the mass of a body [kg] and its inverse, which Newton keeps apart."""
    model.mass[env, body] = mass
    model.inv_mass[env, body] = 1.0 / mass


@wp.func
def _write_inertia(env: int, model: BodyModelData, body: int, inertia: wp.mat33):
    """Write the inertia of a body [kg m^2] and its inverse."""
    model.inertia[env, body] = inertia
    model.inv_inertia[env, body] = _inverse_or_zero(inertia)


@randomizes(
    ranges={"mass_distribution_params": ("mass", "positive")},
    defaults={"distribution": "uniform", "recompute_inertia": True, "min_mass": 1e-06},
)
@wp.func
def randomize_rigid_body_mass(
    env: int,
    model: BodyModelData,
    rng: wp.array[wp.uint32],
    body_ids: wp.array[int],
    mass_distribution_params: wp.vec2,
    operation: int,
    distribution: int,
    recompute_inertia: bool,
    min_mass: float,
):
    """Randomise the masses of bodies; with ``recompute_inertia`` their inertias scale with them.

    Formula: ``m_i = max(op(m_default,i, draw_i), min_mass)`` [kg], ``I_i = I_default,i m_i / m_default,i`` [kg m^2].

    Source: Isaac Lab, ``mdp.randomize_rigid_body_mass``.
    """
    for i in range(body_ids.shape[0]):
        body = body_ids[i]
        default = model.default_mass[env, body]
        # Drawn for bodies without mass too: the draws of other bodies do not depend on them.
        draw = sample(env, rng, mass_distribution_params, distribution)
        if default > 0.0:
            mass = wp.max(operate(default, draw, operation), min_mass)
            _write_mass(env, model, body, mass)
            if recompute_inertia:
                _write_inertia(env, model, body, model.default_inertia[env, body] * (mass / default))


@randomizes(
    ranges={"inertia_distribution_params": ("inertia", "positive")},
    defaults={"operation": "add", "distribution": "uniform", "diagonal_only": True},
)
@wp.func
def randomize_rigid_body_inertia(
    env: int,
    model: BodyModelData,
    rng: wp.array[wp.uint32],
    body_ids: wp.array[int],
    inertia_distribution_params: wp.vec2,
    operation: int,
    distribution: int,
    diagonal_only: bool,
):
    """Randomise the inertias of bodies, by one draw a body for its diagonal or for the whole matrix.

    Formula: ``I_i,kl = op(I_default,i,kl, draw_i)`` [kg m^2], for ``k = l`` alone with ``diagonal_only``; the default
    where that is not positive definite.

    Source: Isaac Lab, ``mdp.randomize_rigid_body_inertia``.
    """
    for i in range(body_ids.shape[0]):
        body = body_ids[i]
        default = model.default_inertia[env, body]
        draw = sample(env, rng, inertia_distribution_params, distribution)
        inertia = default
        for k in range(3):
            for j in range(3):
                if k == j or not diagonal_only:
                    inertia[k, j] = operate(default[k, j], draw, operation)
        # Operation "add" may leave a matrix that is not positive definite, which no body has: the solver would diverge.
        if not _is_positive(inertia):
            inertia = default
        if model.default_mass[env, body] > 0.0:
            _write_inertia(env, model, body, inertia)


@randomizes()
@wp.func
def randomize_rigid_body_com(
    env: int, model: BodyModelData, rng: wp.array[wp.uint32], body_ids: wp.array[int], com_range: wp.array[wp.vec2]
):
    """Randomise the centres of mass of bodies, all by one offset; only x, y and z of ``com_range`` are used.

    Formula: ``c_i = c_default,i + U(com_range)`` [m], in the frame of each body.

    Source: Isaac Lab, ``mdp.randomize_rigid_body_com``.
    """
    # Inertias are about the centre of mass, so they do not change with it.
    offset = random.uniform_vec3(env, rng, com_range, 0)
    for i in range(body_ids.shape[0]):
        body = body_ids[i]
        model.com[env, body] = model.default_com[env, body] + offset


@randomizes(
    ranges={f"{name}_range": ("", "any") for name in _PSEUDO},
    defaults={f"{name}_range": _STAY for name in _PSEUDO} | {"distribution": "uniform"},
)
@wp.func
def randomize_pseudo_inertia(
    env: int,
    model: BodyModelData,
    rng: wp.array[wp.uint32],
    body_ids: wp.array[int],
    alpha_range: wp.vec2,
    d1_range: wp.vec2,
    d2_range: wp.vec2,
    d3_range: wp.vec2,
    s12_range: wp.vec2,
    s13_range: wp.vec2,
    s23_range: wp.vec2,
    t1_range: wp.vec2,
    t2_range: wp.vec2,
    t3_range: wp.vec2,
    distribution: int,
):
    """Randomise mass, centre of mass and inertia of bodies together, so that they stay physically consistent.

    Formula: ``J = U J_default U^T``, ``J = [[S, m c], [m c^T, m]]``, ``S = tr(I_o) / 2 - I_o`` about the body's origin,
    ``U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]``: density times
    ``e^(2 alpha)``, stretch, shear, shift [m].

    Source: C. Rucker and P. Wensing, "Smooth Parameterization of Rigid-Body Inertia", IEEE RA-L 7(2), 2022; mjlab,
    ``dr.pseudo_inertia``.
    """
    # All ten draws are taken for every body, whatever its mass and the ranges: the stream does not depend on them.
    for i in range(body_ids.shape[0]):
        body = body_ids[i]
        scale = wp.exp(sample(env, rng, alpha_range, distribution))
        d1 = wp.exp(sample(env, rng, d1_range, distribution))
        d2 = wp.exp(sample(env, rng, d2_range, distribution))
        d3 = wp.exp(sample(env, rng, d3_range, distribution))
        s12 = sample(env, rng, s12_range, distribution)
        s13 = sample(env, rng, s13_range, distribution)
        s23 = sample(env, rng, s23_range, distribution)
        t1 = sample(env, rng, t1_range, distribution)
        t2 = sample(env, rng, t2_range, distribution)
        t3 = sample(env, rng, t3_range, distribution)
        mass = model.default_mass[env, body]
        if mass > 0.0:
            # U is the affine map x -> A x + t of the body's matter, with density times e^(2 alpha). It maps the centre
            # of mass to A c + t, and the second moments about it to A S A^T: no 4 x 4 matrix is needed.
            inertia = model.default_inertia[env, body]
            moments = 0.5 * wp.trace(inertia) * wp.identity(n=3, dtype=wp.float32) - inertia
            stretch = wp.mat33(d1, s12, s13, 0.0, d2, s23, 0.0, 0.0, d3)
            moments = scale * scale * (stretch * moments * wp.transpose(stretch))
            new = wp.trace(moments) * wp.identity(n=3, dtype=wp.float32) - moments
            model.com[env, body] = stretch * model.default_com[env, body] + wp.vec3(t1, t2, t3)
            _write_mass(env, model, body, mass * scale * scale)
            _write_inertia(env, model, body, 0.5 * (new + wp.transpose(new)))  # rounding left it slightly asymmetric
