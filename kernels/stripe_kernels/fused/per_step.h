// SPDX-License-Identifier: Apache-2.0
// Per step: what has to happen at each physics step of a launch, on the state of that step: explicit actuators, external
// wrenches, velocity limits. Launches of one physics step each do the same in kernels of their own, see
// `Simulation.launch`. Kernels contain only what somebody asked for.

#if HAS_NEWTON
namespace fused {

// Whether rows of drives are copied into the state, see copies.h.
#define ROWS_OF_DRIVES (LIMBS && SOLVER_DRIVES && !DRIVES && NEWTON_IN_ORDER && NEWTON_TARGETS <= NQ)
#if ROWS_OF_DRIVES
FN void place_static_bodies(World& w, const Parameters& P, int lane);
#endif

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

#if ROWS_OF_DRIVES
// The same two as below where all joints are driven by the solver, and their rows lie in Newton's arrays as in the state.
enum DriveRow { EFFORT_TARGETS = 0, LIMITS = NV, STIFFNESS = NV, DAMPING = 2 * NV, VELOCITY_TARGETS = 3 * NV, MODES = 4 * NV, TARGETS = 5 * NV };
template <class Array>
FN void ask_drive_row(const Rows& r, int place, const Array& array, int row_size, int size) {
    ask_row(r, r.first->drive_rows + place, (const real*)array.data + (long long)r.id * row_size, row_size, size);
}
FN int mode_in(const World& w, int i) {  // integers are copied as they are
    int mode;
    memcpy(&mode, w.drive_rows + MODES + i, 4);
    return mode;
}
// Ask for what efforts follow from; return whether there are drives.
template <class Drives>
FN bool ask_efforts(const Rows& r, const Parameters& P, const Drives& drives) {
    if (!drives.law.data || !P.m.joint_f) return false;
    ask_drive_row(r, EFFORT_TARGETS, drives.effort_target, NEWTON_DOFS, NV);
    ask_drive_row(r, LIMITS, drives.effort_limit, NEWTON_DOFS, NV);
    if (drives.feeds_velocity) {
        ask_drive_row(r, DAMPING, drives.damping, NEWTON_DOFS, NV);
        ask_drive_row(r, VELOCITY_TARGETS, drives.vel_target, NEWTON_DOFS, NV);
        ask_drive_row(r, MODES, drives.mode, NEWTON_DOFS, NV);
    }
    return true;
}
// `feed(mode, damping, velocity target, effort target, limit)` returns the effort of a degree of freedom.
template <class Feed>
FN void give_asked_efforts(World& w, const Parameters& P, Feed feed, int lane) {
    const real* x = w.drive_rows;
    EACH(i, NV) w.applied[i] = feed(mode_in(w, i), x[DAMPING + i], x[VELOCITY_TARGETS + i], x[EFFORT_TARGETS + i], x[LIMITS + i]);
    SYNC_WARP();
    const Rows r = rows_of(w, P, lane);
    send_row(r, NEWTON_ROW_OF(P.m.joint_f, NEWTON_DOFS), r.first->applied, NEWTON_DOFS, NV);
    SYNC_WARP();
}
// `ask(mode, stiffness, damping, target, velocity target, effort target, position, velocity)` returns what a drive asks for.
template <class Drives, class Ask>
FN void note_asked_efforts(World& w, const Parameters& P, const Drives& drives, Ask ask, int lane) {
    if (!P.m.computed_effort) return;
    const Rows r = rows_of(w, P, lane);
    ask_drive_row(r, EFFORT_TARGETS, drives.effort_target, NEWTON_DOFS, NV);
    ask_drive_row(r, STIFFNESS, drives.stiffness, NEWTON_DOFS, NV);
    ask_drive_row(r, DAMPING, drives.damping, NEWTON_DOFS, NV);
    ask_drive_row(r, VELOCITY_TARGETS, drives.vel_target, NEWTON_DOFS, NV);
    ask_drive_row(r, MODES, drives.mode, NEWTON_DOFS, NV);
    ask_drive_row(r, TARGETS, drives.pos_target, NEWTON_TARGETS, NEWTON_TARGETS);
    await_rows();
    const real* x = w.drive_rows;
    EACH(i, NV) {
        const int j = dof_joint(i), coord = drives.coord.data[i];
        const real q = is_turning(j) ? 0 : w.q[joint_q(j)] - reference(P, P.id, i);
        w.effort[i] = ask(mode_in(w, i), x[STIFFNESS + i], x[DAMPING + i], coord < 0 ? 0 : x[TARGETS + coord], x[VELOCITY_TARGETS + i],
                          x[EFFORT_TARGETS + i], q, newton_velocity(w, i));
    }
    SYNC_WARP();
    send_row(r, NEWTON_ROW_OF(P.m.computed_effort, NEWTON_DOFS), r.first->effort, NEWTON_DOFS, NV);
    SYNC_WARP();
    place_static_bodies(w, P, lane);  // in the place of those rows
}
#elif SOLVER_DRIVES
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
