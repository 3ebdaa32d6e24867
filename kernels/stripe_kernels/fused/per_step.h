// SPDX-License-Identifier: Apache-2.0
// Per step: what has to happen at each physics step of a launch, on the state of that step: explicit actuators, external
// wrenches, velocity limits. Launches of one physics step each do the same in kernels of their own, see
// `Simulation.launch`. Kernels contain only what somebody asked for.

#if HAS_NEWTON
namespace fused {

#if DRIVES
// Efforts of explicit actuators. `drive(dof, position, velocity)` returns the effort of one of Newton's degrees of freedom
// of this world; what it remembers, such as delayed targets, advances by a step. Joints of other kinds have none.
template <class Drive>
FN void drive_joints(World& w, const Parameters& P, Drive drive, int lane) {
    EACH(j, NJ) {
        if (joint_type(j) != HINGE && joint_type(j) != SLIDE) continue;
        const int dof = newton_v(j);
        const float q = w.q[joint_q(j)] - reference(P, P.id, dof), v = w.v[joint_v(j)], effort = drive(dof, q, v);
        APPLIED(w, P.id, joint_v(j)) = moves_kinematic(w, P, P.id, j) ? 0 : effort;
    }
    SYNC();
}
#endif

#if SOLVER_DRIVES
// Efforts on joints beside those of the solver's own drives, into Newton's forces on joints, before these are read.
// `effort(id, dof)` returns that of one of Newton's degrees of freedom of the world `id`.
template <class Effort>
FN void give_efforts(World& w, const Parameters& P, Effort effort, int lane) {
    if (!P.m.joint_f) return;
    read_rows<NEWTON_DOFS, FEW_IN_FLIGHT>(  // each is several loads
        rows_of(w, P, lane), [&](const World&, int id, int i) { return effort(id, i); },
        [&](World&, int id, int i, real x) { *in_newton(P.m.joint_f, id, NEWTON_DOFS, i) = x; });
    SYNC_WARP();
}
// Efforts that the laws of drives ask for at the start of the last step, unlimited. `ask(id, dof, position, velocity)` returns
// one; coordinates of free joints and balls are no positions of one degree of freedom.
template <class Ask>
FN void note_efforts(World& w, const Parameters& P, Ask ask, int lane) {
    if (!P.m.computed_effort) return;
    read_rows<NV, FEW_IN_FLIGHT>(
        rows_of(w, P, lane),
        [&](const World& o, int id, int i) {
            const int j = dof_joint(i), dof = newton_dof(i);
            const float q = is_turning(j) ? 0 : o.q[joint_q(j)] - reference(P, id, dof);
            return ask(id, dof, q, newton_velocity(o, i));
        },
        [&](World&, int id, int i, real x) { *in_newton(P.m.computed_effort, id, NEWTON_DOFS, newton_dof(i)) = x; });
    SYNC_WARP();
}
#endif

#if WRENCHES
// External wrenches about the centres of mass, in the axes of the world or of the body, as Newton's forces on bodies.
FN void apply_external_wrenches(World& w, const Parameters& P, int lane) {
    if (!P.m.external_wrench) return;
    EACH(b, NB) {
        const int n = newton_body_of(P, b);
        if (n < 0) continue;
        const float* given = (const float*)P.m.external_wrench + 6LL * n;
        Vec force = load_newton(given), torque = load_newton(given + 3);
        if (!((const bool*)P.m.wrench_in_world)[n]) {
            Quat turn_b = load_quat(w.quat + 4 * b);
            force = rotate(turn_b, force), torque = rotate(turn_b, torque);
        }
        float* body_f = (float*)P.m.body_f + 6LL * n;
        store_newton(body_f, force), store_newton(body_f + 3, torque);
    }
    if (lane == 0) w.is_pushed = 1;
    read_body_forces(w, P, lane);  // each lane those of the bodies whose wrenches it wrote
    SYNC();
}
#endif

#if VELOCITY_LIMITS
// Limit the velocities of joints, as Newton has them.
FN void limit_velocities(World& w, const Parameters& P, int lane) {
    if (!P.m.velocity_limit) return;
    EACH(j, NJ) {
        const float* most = (const float*)P.m.velocity_limit + (long long)P.id * NEWTON_DOFS + newton_v(j);
        const int size = velocities(j);
        real* own = w.v + joint_v(j);
        // A velocity that is not a number stays so: a bound in its place would hide where it came from.
        if (size == 1) own[0] = clamped(own[0], -most[0], most[0]);
        else {
            float q[7], v[6];
            bool exceeds = false;
            write_newton_joint(w, P, j, q, v);
            for (int k = 0; k < size; k++) {
                float limited = clamped(v[k], -most[k], most[k]);
                exceeds = exceeds || limited != v[k];
                v[k] = limited;
            }
            if (exceeds) read_newton_joint(w, P, j, q, v);
        }
    }
    SYNC();
}
#endif

}  // namespace fused
#endif
