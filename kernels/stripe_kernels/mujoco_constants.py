# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's derived constants: inverse weights of degrees of freedom and bodies, and subtree masses.

MuJoCo computes them from masses and armatures when a model is compiled, and scales constraints by the inverse weights.
``mujoco_warp.set_const`` computes them for all worlds, body by body in some hundred launches. Here they take three
launches, for the worlds of a mask only. Geometry at the reference pose is the same in all worlds, so the Jacobians are
computed once on the host.

Source: MuJoCo's documentation, "Constraint model" and ``mjModel.dof_invweight0``, ``mjModel.body_invweight0``;
factorization: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 6.3.
"""

import warp as wp
from newton._src.solvers.mujoco.kernels import quat_wxyz_to_xyzw

__all__ = ["MassTree", "assemble_mass_matrix", "factor_mass_matrix", "write_constants"]

_SMALLEST = wp.constant(1.0e-15)
"""MuJoCo's ``mjMINVAL``: a smaller inverse weight counts as zero."""


@wp.struct
class MassTree:
    """Kinematic trees of a world over degrees of freedom and bodies, and the sparse matrices over them.

    The row of a degree of freedom has an entry for itself, then one for each degree of freedom between it and the
    root: its chain. Numbers rise from the root outwards.
    """

    row_start: wp.array[int]
    """First entry of the row of each degree of freedom, shape ``(nv,)``."""
    row_count: wp.array[int]
    """Number of entries in the row of each degree of freedom, shape ``(nv,)``."""
    entry_row: wp.array[int]
    """Degree of freedom whose row an entry is in, shape ``(entries,)``."""
    entry_column: wp.array[int]
    """Degree of freedom of an entry's column, shape ``(entries,)``."""
    dof_body: wp.array[int]
    """Body that a degree of freedom moves directly, shape ``(nv,)``."""
    group_start: wp.array[int]
    """First degree of freedom of the group that shares one weight, such as a ball joint, shape ``(nv,)``."""
    group_count: wp.array[int]
    """Number of degrees of freedom in that group, shape ``(nv,)``."""
    body_end: wp.array[int]
    """Index after the last descendant of each body, shape ``(nbody,)``."""
    body_dof: wp.array[int]
    """Last degree of freedom between the root and each body, -1 for none, shape ``(nbody,)``."""
    linear: wp.array2d[wp.vec3]
    """Velocity of each body's origin at unit speed of each degree of freedom, in the body's frame, ``(nbody, nv)``."""
    angular: wp.array2d[wp.vec3]
    """Angular velocity of each body at unit speed of each degree of freedom, in the body's frame, ``(nbody, nv)``."""
    body_mass: wp.array2d[float]
    body_ipos: wp.array2d[wp.vec3]
    body_inertia: wp.array2d[wp.vec3]
    body_iquat: wp.array2d[wp.quat]
    dof_armature: wp.array2d[float]
    matrix: wp.array2d[float]
    """Mass matrix, then its factors: L below the diagonal, D on it; shape ``(num_envs, entries)``."""
    dof_chain: wp.array3d[float]
    """Scratch, shape ``(num_envs, nv, longest chain)``."""
    body_chain: wp.array3d[wp.spatial_vector]
    """Scratch, shape ``(num_envs, nbody, longest chain)``."""
    dof_invweight0: wp.array2d[float]
    body_invweight0: wp.array2d[wp.vec2]
    body_subtreemass: wp.array2d[float]
    touched: wp.array[wp.bool]
    """Worlds whose constants were computed here, shape ``(num_envs,)``."""


@wp.func
def _com_velocity(world: int, body: int, dof: int, tree: MassTree) -> wp.vec3:
    """Velocity of a body's centre of mass at unit speed of a degree of freedom, in the body's frame."""
    return tree.linear[body, dof] + wp.cross(tree.angular[body, dof], tree.body_ipos[world, body])


@wp.kernel(enable_backward=False)
def assemble_mass_matrix(mask: wp.array[wp.bool], tree: MassTree):
    """Assemble the mass matrix at the reference pose; a thread for each entry of a world.

    Formula: ``M_ij = sum_b m_b v_bi . v_bj + w_bi . I_b w_bj``, plus the armature on the diagonal.
    """
    world, entry = wp.tid()
    if not mask[world]:
        return
    i = tree.entry_row[entry]
    j = tree.entry_column[entry]
    # Both degrees of freedom move only the bodies beyond the outer one, ``i``; these have consecutive numbers.
    first = tree.dof_body[i]
    total = wp.float32(0.0)
    for body in range(first, tree.body_end[first]):
        total += tree.body_mass[world, body] * wp.dot(
            _com_velocity(world, body, i, tree), _com_velocity(world, body, j, tree)
        )
        axes = quat_wxyz_to_xyzw(tree.body_iquat[world, body])
        one = wp.quat_rotate_inv(axes, tree.angular[body, i])
        two = wp.quat_rotate_inv(axes, tree.angular[body, j])
        total += wp.dot(one, wp.cw_mul(tree.body_inertia[world, body], two))
    if i == j:
        total += tree.dof_armature[world, i]
    tree.matrix[world, entry] = total


@wp.kernel(enable_backward=False)
def factor_mass_matrix(mask: wp.array[wp.bool], tree: MassTree):
    """Factor the mass matrix in place, ``M = L^T D L`` (Featherstone, table 6.3); a thread for each world."""
    world = wp.tid()
    if not mask[world]:
        return
    tree.touched[world] = True
    # From the leaves to the root, so that the factors are as sparse as the matrix: no entry appears outside the chains.
    for step in range(tree.row_start.shape[0]):
        k = tree.row_start.shape[0] - 1 - step
        start = tree.row_start[k]
        pivot = tree.matrix[world, start]
        for a in range(1, tree.row_count[k]):
            share = tree.matrix[world, start + a] / pivot
            # The row of the a-th ancestor is the end of this row, so that its entry for column b is at b - a.
            above = tree.row_start[tree.entry_column[start + a]] - a
            for b in range(a, tree.row_count[k]):
                tree.matrix[world, above + b] = tree.matrix[world, above + b] - tree.matrix[world, start + b] * share
            tree.matrix[world, start + a] = share


@wp.func
def _dof_weight(world: int, dof: int, scratch: int, tree: MassTree) -> float:
    """Diagonal entry of ``M^-1`` for a degree of freedom; uses row ``scratch`` of ``dof_chain``.

    With ``M = L^T D L`` it is ``|D^-1/2 L^-T e|^2``, and ``L^-T e`` is zero outside the chain.
    """
    start = tree.row_start[dof]
    count = tree.row_count[dof]
    for a in range(count):
        tree.dof_chain[world, scratch, a] = 0.0
    tree.dof_chain[world, scratch, 0] = 1.0
    weight = wp.float32(0.0)
    for a in range(count):
        row = tree.row_start[tree.entry_column[start + a]] - a
        x = tree.dof_chain[world, scratch, a]
        weight += x * x / tree.matrix[world, row + a]
        for b in range(a + 1, count):
            tree.dof_chain[world, scratch, b] = tree.dof_chain[world, scratch, b] - tree.matrix[world, row + b] * x
    return weight


@wp.func
def _body_weight(world: int, body: int, tree: MassTree) -> wp.vec2:
    """Inverse weights of a body: means of the diagonal of ``J M^-1 J^T`` over its linear and its angular rows.

    ``J`` maps to the velocity of the centre of mass and to the angular velocity. All six rows are solved for at once.
    """
    dof = tree.body_dof[body]
    start = tree.row_start[dof]
    count = tree.row_count[dof]
    for a in range(count):
        other = tree.entry_column[start + a]
        speed = _com_velocity(world, body, other, tree)
        tree.body_chain[world, body, a] = wp.spatial_vector(speed, tree.angular[body, other])
    linear = wp.float32(0.0)
    angular = wp.float32(0.0)
    for a in range(count):
        row = tree.row_start[tree.entry_column[start + a]] - a
        x = tree.body_chain[world, body, a]
        linear += wp.length_sq(wp.spatial_top(x)) / tree.matrix[world, row + a]
        angular += wp.length_sq(wp.spatial_bottom(x)) / tree.matrix[world, row + a]
        for b in range(a + 1, count):
            tree.body_chain[world, body, b] = tree.body_chain[world, body, b] - tree.matrix[world, row + b] * x
    # As in MuJoCo: a body that can only turn, or only slide, takes the one weight for both.
    if linear < 3.0 * _SMALLEST and angular > 3.0 * _SMALLEST:
        linear = angular
    elif angular < 3.0 * _SMALLEST and linear > 3.0 * _SMALLEST:
        angular = linear
    return wp.vec2(linear / 3.0, angular / 3.0)


@wp.kernel(enable_backward=False)
def write_constants(mask: wp.array[wp.bool], tree: MassTree):
    """Write inverse weights and subtree masses; a thread for each degree of freedom and each body of a world."""
    world, i = wp.tid()
    if not mask[world]:
        return
    dofs = tree.row_start.shape[0]
    if i < dofs:
        total = wp.float32(0.0)
        # Every thread of a group computes the weights of all its members, in scratch memory of its own (row i): the
        # threads need not wait for each other.
        for k in range(tree.group_count[i]):
            total += _dof_weight(world, tree.group_start[i] + k, i, tree)
        tree.dof_invweight0[world, i] = total / wp.float32(tree.group_count[i])
        return
    body = i - dofs
    mass = wp.float32(0.0)
    for below in range(body, tree.body_end[body]):
        mass += tree.body_mass[world, below]
    tree.body_subtreemass[world, body] = mass
    if tree.body_dof[body] < 0:
        tree.body_invweight0[world, body] = wp.vec2(0.0, 0.0)
    else:
        tree.body_invweight0[world, body] = _body_weight(world, body, tree)
