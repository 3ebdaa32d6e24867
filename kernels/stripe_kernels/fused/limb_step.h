// SPDX-License-Identifier: Apache-2.0
// Limb step: one time step of a world in the form for a hub with limbs. What it computes is what step.h does.

namespace fused {

template <class Ask, class Drive>
FN void begin_steps(World& w, const Parameters& P, Ask ask_drives, Drive drive, int lane) {
    read_state(w, P, ask_drives, drive, lane);
    place_static_bodies(w, P, lane);
    gather_parameters(w, P, lane);
}
FN void begin_steps(World& w, const Parameters& P, int lane) {
    begin_steps(w, P, [](const Rows&) { return false; }, [] {}, lane);
}
FN void end_steps(World& w, const Parameters& P, int lane) { write_state(w, P, lane); }

// Advance a degree of freedom that is not of a free joint.
FN void advance_dof(World& w, int i, real h, real a, real implicit) {
    w.a[i] = a, w.v[i] += h * implicit;
    w.q[joint_q(dof_joint(i))] += h * w.v[i];
}

// Advance velocities by the accelerations of the implicit step, and positions by the new velocities.
FN void integrate(World& w, const Parameters& P, const Hub& H, const Limb* limb, int lane) {
    const real h = P.step_size();
    for (int l = 0; l < NL; l++) {
        const int slot = slot_of(l, lane);
        UNROLLED for (int d = 0; d < LD; d++)
            if (d < limb_size(slot)) advance_dof(w, limb_dof(slot * LD + d), h, limb[l].a[d], limb[l].s[d]);
    }
    if (lane == 0) {
        UNROLLED for (int k = 0; k < NH; k++) {
            const int i = hub_dof(k);
            if (HUB_IS_FREE && k < 6) w.a[i] = H.a[k], w.v[i] += h * H.s[k];
            else advance_dof(w, i, h, H.a[k], H.s[k]);
        }
        if (HUB_IS_FREE) {
            real *q = w.q + joint_q(dof_joint(hub_dof(0))), *v = w.v + hub_dof(0);
            store(q, load(q) + h * load(v));
            store_quat(q + 3, normalized(load_quat(q + 3) * turn_by(h * load(v + 3))));
        }
    }
    SYNC();
}

// One of the steps of a launch, of which `left` are left with this one; see `is_last_pass`.
FN void step(World& w, const Parameters& P, const real*, int, int left, int lane) {
    const bool is_last = is_last_pass(w, P, left, lane);
    if (left == 0 && !is_last) return;
    together(P);
    lane = fresh(lane) % LANES;
    Hub H;
    Limb limb[NL];
    Constraints K;
    LimbContacts contact;
    real inertia[NL][10], bias[NL][LD];
    Spatial needed[NL];
    int rows = 0, overflow = 0;
    LimbMotion motion[NL];
    move_hub(w, fresh(P));
    for (int l = 0; l < NL; l++) move_limb(motion[l], w, fresh(P), slot_of(l, lane));
#if HAS_NEWTON
    if (is_last) {
        SYNC();
        write_newton_bodies(w, fresh(P), motion, lane);
        return;
    }
#endif
    for (int l = 0; l < NL; l++) limb_forces(w, fresh(P), limb[l], motion[l], slot_of(l, lane), bias[l], inertia[l], needed[l]);
    SYNC();
    rows = hub_forces(w, fresh(P), H, K.hub, inertia, needed, lane, overflow);
    for (int l = 0; l < NL; l++) {
        const int slot = slot_of(l, lane);
        rows += limb_dof_parts(limb[l], K.limb[l], w, fresh(P), slot, bias[l], overflow);
        K.contacts[l] = LIMB_CONTACTS ? limb_contacts(contact[l], w, fresh(P), limb[l], slot, rows, overflow) : 0;
    }
    rows = (int)SUM((real)rows);
    const int overflows = IN_ANY(overflow & OVERFLOW_ROWS) * OVERFLOW_ROWS | IN_ANY(overflow & OVERFLOW_CONTACTS) * OVERFLOW_CONTACTS;
    if (rows == 0) {  // one iteration: what is known of the last step must not even be in the last digit
        UNROLLED for (int h = 0; h < NH; h++) H.a[h] = 0;
        for (int l = 0; l < NL; l++) UNROLLED for (int d = 0; d < LD; d++) limb[l].a[d] = 0;
    }
    together(P);
    const int iterations = constrained_acceleration(H, limb, contact, K, rows > 0);
    if (lane == 0) {
        if (overflows) report_overflow(P, overflows);
        if (left == 1) *P.nefc() = rows, *P.solver_niter() = iterations;
    }
#if CONTACT_FORCES
    if (left == 1 && P.m.force_geoms) write_contact_forces(fresh(P), contact, K.contacts, lane);
#endif
    integrate(w, fresh(P), H, limb, lane);
#if VELOCITY_LIMITS
    limit_velocities(w, fresh(P), lane);
#endif
}

}  // namespace fused
