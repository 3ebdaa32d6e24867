// SPDX-License-Identifier: Apache-2.0
// Limb state: what a launch reads and writes in the form for a hub with limbs, where the state is in shared memory. Rows that
// Newton has in another order than MuJoCo take the ways of newton_state.h.

namespace fused {

#if HAS_NEWTON
struct alignas(16) Four {
    real x[4];
};
// Whether any number of the forces on the bodies of these worlds is not 0: all are looked at in few instructions, as mostly
// none is.
FN bool any_force(const Rows& r, const Parameters& P) {
#if IN_SHARED && defined(__CUDA_ARCH__)
    enum { SIZE = WORLDS_OF_WARP * 6 * NEWTON_BODIES / 4, EACH_LANE = (SIZE + 31) / 32 };  // fours
    const Four* from = (const Four*)NEWTON_ROW_OF(P.m.body_f, 6 * NEWTON_BODIES);
    if (r.worlds < WORLDS_OF_WARP || WORLDS_OF_WARP % 2 || (unsigned long long)from % 16) return true;
    bool found = false;
    ROLLED for (int first = 0; first < EACH_LANE; first += 7) {
        Four x[7];
        UNROLLED for (int k = 0; k < 7; k++) {
            const int i = r.start + 32 * (first + k);
            x[k] = i < SIZE ? from[i] : Four{{0, 0, 0, 0}};
        }
        UNROLLED for (int k = 0; k < 7; k++)
            found = found || x[k].x[0] != 0 || x[k].x[1] != 0 || x[k].x[2] != 0 || x[k].x[3] != 0;
    }
    return any_in_warp(found);
#else
    return true;
#endif
}

// Controls, and forces on joints, which are those that drives have given where `are_given` says so.
FN void ask_controls(const Rows& r, World& w, const Parameters& P, bool are_given) {
#if ACTUATORS && CONTROLS_TOGETHER
    const unsigned long long from = CONTROLS_TOGETHER == FROM_POSITIONS ? P.m.joint_target_q : P.m.joint_target_qd;
    const int size = CONTROLS_TOGETHER == FROM_POSITIONS ? NEWTON_TARGETS : NEWTON_DOFS;
    if (from) ask_row(r, r.first->ctrl, NEWTON_ROW_OF(from, size) + control_index(0), size, NU);
    else ask_row(r, r.first->ctrl, ROW_OF(ctrl), NU);
#endif
    if (!are_given) ask_row(r, r.first->applied, NEWTON_ROW_OF(P.m.joint_f, NEWTON_DOFS), NEWTON_DOFS, NV);
}
#endif

// The state, controls and forces of a launch, into the world. `ask_drives(r)` asks for what efforts of drives follow from, and
// returns whether it did, `drive()` computes them.
template <class Ask, class Drive>
FN void read_state(World& w, const Parameters& P, Ask ask_drives, Drive drive, int lane) {
    const Rows r = rows_of(w, P, lane);
    if (lane == 0) w.has_kinematic = w.is_pushed = 0, *P.overflow() = 0;
    SYNC_WARP();
    bool in_order = false, is_driven = false;
    ask_row(r, r.first->a, ROW_OF(qacc_warmstart), NV);
#if HAS_NEWTON
    in_order = NEWTON_IN_ORDER && P.m.joint_q_in;
    if (in_order) {
        ask_row(r, r.first->q, NEWTON_ROW_OF(P.m.joint_q_in, NEWTON_COORDS), NEWTON_COORDS, NQ);
        ask_row(r, r.first->v, NEWTON_ROW_OF(P.m.joint_qd_in, NEWTON_DOFS), NEWTON_DOFS, NV);
    } else if (P.m.joint_q_in)
        read_newton_joints(w, P, lane);
    else
#endif
        ask_row(r, r.first->q, ROW_OF(qpos), NQ), ask_row(r, r.first->v, ROW_OF(qvel), NV);
#if HAS_NEWTON
    const bool together = NEWTON_IN_ORDER && (!ACTUATORS || CONTROLS_TOGETHER) && P.m.joint_f;
    if (together) is_driven = ask_drives(r), ask_controls(r, w, P, is_driven);
    else if (!P.m.joint_f)
#endif
    {
        ask_row(r, r.first->applied, ROW_OF(qfrc_applied), NV);
#if ACTUATORS
        ask_row(r, r.first->ctrl, ROW_OF(ctrl), NU);
#endif
    }
#if HAS_NEWTON
    if (KINEMATIC_BODIES) find_kinematic(r, P);
    if (P.m.body_f) {
        if (any_force(r, P)) find_pushed(r, P);
    } else
#endif
        read_rows<6 * NB>(
            r, [&](const World&, int id, int i) { return IN_ROW(xfrc_applied, id, i); },
            [](World& o, int, int, real x) { if (x != 0) o.is_pushed = 1; });
    await_rows();
#if HAS_NEWTON
    if (in_order) convert_read_joints(w, P, lane);
    if (P.m.joint_q_in) place_fixed_bodies(P, lane);
    if (together) {
        if (is_driven) drive();
        finish_controls(w, P, lane);
    } else if (P.m.joint_f)
        read_newton_controls(w, P, lane);
    SYNC_WARP();
    if (P.m.body_f && w.is_pushed) read_body_forces(w, P, lane);
#endif
    SYNC();
}

// The state after a launch, and what others read of it.
FN void write_state(World& w, const Parameters& P, int lane) {
    SYNC_WARP();
    const Rows r = rows_of(w, P, lane);
    send_row(r, ROW_TO(qpos, q), NQ);
    send_row(r, ROW_TO(qvel, v), NV);
    send_row(r, ROW_TO(qacc_warmstart, a), NV);
#if HAS_NEWTON
    if (NEWTON_IN_ORDER && P.m.efforts)
        send_row(r, NEWTON_ROW_OF(P.m.efforts, NEWTON_DOFS), r.first->effort, NEWTON_DOFS, NV);
    else if (P.m.efforts)  // by Newton's degrees of freedom
        write_rows<NV>(r, [&](const World& o, int id, int i) {
            *in_newton(P.m.efforts, id, NEWTON_DOFS, newton_dof(i)) = EFFORT(o, id, i);
        });
    else
#endif
        send_row(r, ROW_TO(qfrc_actuator, effort), NV);
#if HAS_NEWTON
    if (!P.m.joint_q_out) return;
    convert_turned(w, P, lane);
    if (NEWTON_IN_ORDER && !KINEMATIC_BODIES) {
        convert_written_joints(w, P, lane);
        send_row(r, NEWTON_ROW_OF(P.m.joint_q_out, NEWTON_COORDS), r.first->q, NEWTON_COORDS, NQ);
        send_row(r, NEWTON_ROW_OF(P.m.joint_qd_out, NEWTON_DOFS), r.first->v, NEWTON_DOFS, NV);
    } else
        write_newton_joints(w, P, P.m.joint_q_out, P.m.joint_qd_out, lane);
#endif
}

}  // namespace fused
