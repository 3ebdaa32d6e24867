// SPDX-License-Identifier: Apache-2.0
// Launch: what happens before and after the steps of a launch, and between their parts.

namespace fused {

// The same number, of which the compiler knows no more: what is computed from it is not kept from phase to phase, and from
// step to step, in registers that there are not enough of.
FN int fresh(int x) {
#ifdef __CUDA_ARCH__
    asm volatile("" : "+r"(x));
#endif
    return x;
}
FN Parameters fresh(const Parameters& P) { return Parameters{P.m, fresh(P.id), P.num_worlds}; }

// Let the worlds of a block go on together: they then share the fetched instructions. Not in the last block, where a world
// may be missing.
FN void together(const Parameters& P) {
#ifdef __CUDA_ARCH__
    if ((blockIdx.x + 1) * WORLDS_PER_BLOCK <= P.num_worlds) __syncthreads();
#endif
}

// What did not fit, as bits: of a launch, and of all worlds for the host, which reads `overflow_told`. Writing there is slow,
// so only the first world with a new bit does.
FN void report_overflow(const Parameters& P, int bits) {
    *P.overflow() |= bits;
    if (!P.m.overflow_seen) return;
    int *seen = (int*)P.m.overflow_seen, *told = (int*)P.m.overflow_told;
#ifdef __CUDA_ARCH__
    if (bits & ~atomicOr(seen, bits)) atomicOr(told, bits);
#else
    if (bits & ~*seen) *told |= bits;
    *seen |= bits;
#endif
}

#if !LIMBS  // else see limb_state.h
// The state, controls and forces of a launch, into the world.
FN void read_state(World& w, const Parameters& P, int lane) {
    const Rows r = rows_of(w, P, lane);
    if (lane == 0) w.has_kinematic = w.is_pushed = 0;
#if !GIVEN_CONTACTS  // others report what they cannot find room for, too
    if (lane == 0) *P.overflow() = 0;
#endif
    SYNC_WARP();
#if HAS_NEWTON
    if (KINEMATIC_BODIES) find_kinematic(r, P);
    if (P.m.body_f) find_pushed(r, P);
    else
#endif
        read_rows<6 * NB>(
            r, [&](const World&, int id, int i) { return IN_ROW(xfrc_applied, id, i); },
            [](World& o, int, int, real x) { if (x != 0) o.is_pushed = 1; });
    read_rows<NV>(
        r, [&](const World&, int id, int i) { return IN_ROW(qacc_warmstart, id, i); }, [](World& o, int, int i, real x) { o.a[i] = x; });
#if HAS_NEWTON
    if (P.m.joint_q_in) {
        read_newton_joints(w, P, lane);
        place_fixed_bodies(P, lane);
    } else
#endif
    {
        read_rows<NQ>(r, [&](const World&, int id, int i) { return IN_ROW(qpos, id, i); }, [](World& o, int, int i, real x) { o.q[i] = x; });
        read_rows<NV>(r, [&](const World&, int id, int i) { return IN_ROW(qvel, id, i); }, [](World& o, int, int i, real x) { o.v[i] = x; });
    }
#if HAS_NEWTON
    if (P.m.joint_f) read_newton_controls(w, P, lane);
#endif
    SYNC_WARP();
#if HAS_NEWTON
    if (P.m.body_f && w.is_pushed) read_body_forces(w, P, lane);
#endif
    SYNC();
}

// The state after a launch, and what others read of it.
FN void write_state(World& w, const Parameters& P, int lane) {
    SYNC_WARP();
    const Rows r = rows_of(w, P, lane);
    write_rows<NQ>(r, [&](const World& o, int id, int i) { IN_ROW(qpos, id, i) = o.q[i]; });
    write_rows<NV>(r, [&](const World& o, int id, int i) { IN_ROW(qvel, id, i) = o.v[i], IN_ROW(qacc_warmstart, id, i) = o.a[i]; });
#if HAS_NEWTON
    if (P.m.efforts)  // by Newton's degrees of freedom
        write_rows<NV>(r, [&](const World& o, int id, int i) {
            *in_newton(P.m.efforts, id, NEWTON_DOFS, newton_dof(i)) = EFFORT(o, id, i);
        });
#endif
#if HAS_NEWTON
    if (P.m.joint_q_out) {
        convert_turned(w, P, lane);
        write_newton_joints(w, P, P.m.joint_q_out, P.m.joint_qd_out, lane);
    }
#endif
}
#endif

// A launch goes through the code of a step once more, up to where bodies have moved, if somebody reads their poses: another copy
// of that code would take longer to fetch than it runs. Returns whether this is it, and there is something to do.
FN bool is_last_pass(World& w, const Parameters& P, int left, int lane) {
#if HAS_NEWTON
    if (KINEMATIC_BODIES && left == 0 && P.m.joint_q_out) {
        SYNC();
        read_kinematic_joints(w, P, P.m.joint_q_out, P.m.joint_qd_out, lane);
        SYNC();
    }
    return left == 0 && P.m.body_q;
#else
    return false;
#endif
}

#if HAS_NEWTON
// Joints before the last step of a launch, from which accelerations follow.
FN void begin_last_step(World& w, const Parameters& P, int lane) {
    if (!P.m.joint_qd_before && !P.m.computed_effort) return;
    convert_turned(w, P, lane);
#if LIMBS
    if (NEWTON_IN_ORDER && !KINEMATIC_BODIES && P.m.joint_qd_before && !P.m.joint_q_before) {
        EACH(i, NV) w.effort[i] = newton_velocity(w, i);  // efforts of the step before are not needed any more
        SYNC_WARP();
        const Rows r = rows_of(w, P, lane);
        send_row(r, NEWTON_ROW_OF(P.m.joint_qd_before, NEWTON_DOFS), r.first->effort, NEWTON_DOFS, NV);
        SYNC_WARP();
        return;
    }
#endif
    if (P.m.joint_qd_before) write_newton_joints(w, P, P.m.joint_q_before, P.m.joint_qd_before, lane);
}

// Poses and velocities of bodies as Newton has them: (position, x, y, z, w), and (velocity of the centre of mass, angular
// velocity) in the world, from what `keep_velocity` has kept for all bodies.
FN void write_body_rows(World& w, const Parameters& P, int lane) {
    SYNC_WARP();
    const Rows r = rows_of(w, P, lane);
    write_rows<7 * NEWTON_BODIES>(r, [&](World& o, int id, int i) {
        const int b = mujoco_body(i / 7), k = i % 7;
        const real x = k < 3 ? o.pos[3 * b + k] + o.origin[3 * body_tree(b) + k] : o.quat[4 * b + (k == 6 ? 0 : k - 2)];
        *in_newton(P.m.body_q, id, 7 * NEWTON_BODIES, i) = x;
    });
    write_rows<6 * NEWTON_BODIES>(r, [&](World& o, int id, int i) {
        *in_newton(P.m.body_qd, id, 6 * NEWTON_BODIES, i) = body_velocities(o)[6 * mujoco_body(i / 6) + i % 6];
    });
}
#endif

}  // namespace fused
