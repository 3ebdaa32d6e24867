# SPDX-License-Identifier: Apache-2.0
"""What MuJoCo derives from masses and armatures once: inverse weights, by which it weighs constraints, subtree masses.

``mujoco_warp.set_const`` computes them for all worlds, body by body in some hundred launches. Here they take three, and
only the worlds of a mask. Geometry at the reference pose is the same in all worlds, so Jacobians come from the host.

Source: MuJoCo's documentation, "Constraint model" and ``mjModel.dof_invweight0``, ``mjModel.body_invweight0``;
factorization: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, table 6.3.
"""

import warp as wp
from newton._src.solvers.mujoco.kernels import quat_wxyz_to_xyzw

__all__ = ["MassTree", "assemble_mass_matrix", "factor_mass_matrix", "write_constants"]

_SMALLEST = wp.constant(1.0e-15)


@wp.struct
class MassTree:
    """Degrees of freedom and bodies of a world as trees, and matrices over them.

    The row of a degree of freedom holds itself, then what it hangs on, up to the root: its chain.
    """

    row_start: wp.array[int]
    """First entry of the row of each degree of freedom, shape ``(nv,)``."""
    row_count: wp.array[int]
    """Entries in it, shape ``(nv,)``."""
    entry_row: wp.array[int]
    """Degree of freedom of each entry, shape ``(entries,)``."""
    entry_column: wp.array[int]
    """The other one, shape ``(entries,)``."""
    dof_body: wp.array[int]
    """Body that it moves first, shape ``(nv,)``."""
    group_start: wp.array[int]
    """First degree of freedom of those it shares its weight with, shape ``(nv,)``."""
    group_count: wp.array[int]
    """Their number, shape ``(nv,)``."""
    body_end: wp.array[int]
    """Body after the last one that hangs on each, shape ``(nbody,)``."""
    body_dof: wp.array[int]
    """Last degree of freedom that moves it, -1 for none, shape ``(nbody,)``."""
    linear: wp.array2d[wp.vec3]
    """Velocity of each body's origin at unit speed of each degree of freedom, in the body's frame, ``(nbody, nv)``."""
    angular: wp.array2d[wp.vec3]
    """Angular velocity likewise."""
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
    """``M_ij = sum_b m_b v_bi . v_bj + w_bi . I_b w_bj``, plus armature; a thread for each entry of a world."""
    world, entry = wp.tid()
    if not mask[world]:
        return
    i = tree.entry_row[entry]
    j = tree.entry_column[entry]
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
    """``M = L^T D L``, in place; a thread for each world."""
    world = wp.tid()
    if not mask[world]:
        return
    tree.touched[world] = True
    for step in range(tree.row_start.shape[0]):
        k = tree.row_start.shape[0] - 1 - step
        start = tree.row_start[k]
        pivot = tree.matrix[world, start]
        for a in range(1, tree.row_count[k]):
            share = tree.matrix[world, start + a] / pivot
            above = tree.row_start[tree.entry_column[start + a]] - a
            for b in range(a, tree.row_count[k]):
                tree.matrix[world, above + b] = tree.matrix[world, above + b] - tree.matrix[world, start + b] * share
            tree.matrix[world, start + a] = share


@wp.func
def _dof_weight(world: int, dof: int, scratch: int, tree: MassTree) -> float:
    """``e^T M^-1 e`` of a degree of freedom; uses row ``scratch`` of ``dof_chain``."""
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
    """Means of the diagonals of ``J M^-1 J^T``: of the velocity of the centre of mass, and of the angular velocity."""
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
    if linear < 3.0 * _SMALLEST and angular > 3.0 * _SMALLEST:
        linear = angular
    elif angular < 3.0 * _SMALLEST and linear > 3.0 * _SMALLEST:
        angular = linear
    return wp.vec2(linear / 3.0, angular / 3.0)


@wp.kernel(enable_backward=False)
def write_constants(mask: wp.array[wp.bool], tree: MassTree):
    """Inverse weights and subtree masses; a thread for each degree of freedom, then for each body, of a world."""
    world, i = wp.tid()
    if not mask[world]:
        return
    dofs = tree.row_start.shape[0]
    if i < dofs:
        total = wp.float32(0.0)
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
