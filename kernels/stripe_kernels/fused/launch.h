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

FN void write_newton_bodies(World& w, const Parameters& P, int lane);

// The state and controls of a launch, into the world.
FN void read_state(World& w, const Parameters& P, int lane) {
    if (!P.m.joint_q_in) {
        EACH(i, NQ) w.q[i] = P.qpos()[i];
        EACH(i, NV) w.v[i] = P.qvel()[i];
    }
#if HAS_NEWTON
    if (P.m.joint_q_in) {
        read_newton_joints(w, P, (const float*)P.m.joint_q_in, (const float*)P.m.joint_qd_in, true, lane);
        place_fixed_bodies(P, lane);
    }
    SYNC();
    read_newton_controls(P, lane);
#endif
    EACH(i, NV) w.a[i] = P.qacc_warmstart()[i];
    SYNC();
}

// The state after a launch, and what others read of it.
FN void write_state(World& w, const Parameters& P, int lane) {
    EACH(i, NQ) P.qpos()[i] = w.q[i];
    EACH(i, NV) P.qvel()[i] = w.v[i], P.qacc_warmstart()[i] = w.a[i];
#if HAS_NEWTON
    if (P.m.joint_q_out) {
        float *q = (float*)P.m.joint_q_out, *v = (float*)P.m.joint_qd_out;
        write_newton_joints(w, P, q, v, lane);
        read_newton_joints(w, P, q, v, false, lane);  // where their bodies are
        SYNC();
    }
    if (P.m.efforts) write_newton_efforts(P, lane);
#endif
    if (P.m.body_q) write_newton_bodies(w, P, lane);
}

}  // namespace fused
