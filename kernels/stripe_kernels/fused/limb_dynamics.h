// SPDX-License-Identifier: Apache-2.0
// Limb dynamics: kinematics, mass matrix and forces of a hub with limbs. Formulas are those of dynamics.h.

namespace fused {

// Bodies that do not move: the world, and what is fixed in it.
FN void place_static_bodies(World& w, const Parameters& P, int lane) {
    if (lane == 0) {
        set_frame(w, 0, Frame{{0, 0, 0}, {1, 0, 0, 0}});
        store(w.origin, Vec{0, 0, 0});
        ROLLED for (int i = 0; i < NSTATIC; i++) {
            int b = static_body(i), p = body_parent(b);
            Frame f = hang(frame_of(w, p), P, b);
            if (NMOCAP && body_mocap(b) >= 0)  // the caller places it
                f = Frame{load(P.mocap_pos() + 3 * body_mocap(b)), load_quat(P.mocap_quat() + 4 * body_mocap(b))};
            f.turn = normalized(f.turn);
            if (p == 0) store(w.origin + 3 * body_tree(b), f.x), f.x = Vec{0, 0, 0};
            set_frame(w, b, f);
        }
    }
    SYNC();
}

FN bool is_moved_by(int body, int dof) { return (body_dofs(body) >> dof) & 1; }

// Motion of a degree of freedom of the hub. A free joint's translations are along the axes of the world.
FN Spatial hub_motion(const World& w, int h) {
    if (HUB_IS_FREE && h < 3) return Spatial{{0, 0, 0}, {(real)(h == 0), (real)(h == 1), (real)(h == 2)}};
    if (HUB_IS_FREE && h < 6) return Spatial{load(w.S + 6 * h), {0, 0, 0}};
    return load_spatial(w.S + 6 * h);
}

// Poses and velocities of the hub's bodies. All lanes compute and store the same.
FN void move_hub(World& w, const Parameters& P) {
    int h = 0;
    ROLLED for (int i = 0; i < HUB_BODIES; i++) {
        int b = hub_body(i), p = body_parent(b), first = body_joint(b), last = first + body_joints(b);
        const bool is_free = first < last && joint_type(first) == FREE;
        Frame f = is_free ? Frame{load(w.q + joint_q(first)), load_quat(w.q + joint_q(first) + 3)} : hang(frame_of(w, p), P, b);
        ROLLED for (int j = first; j < last; j++) {
            const real* q = w.q + joint_q(j);
            if (!is_free) {
                Vec axis, anchor;
                move_by_joint(P, j, q[0], f.x, f.turn, axis, anchor);
                store(w.S + 6 * (h + j - first), axis), store(w.S + 6 * (h + j - first) + 3, anchor);
            }
        }
        f.turn = normalized(f.turn);
        Vec shift{0, 0, 0};
        if (p == 0) shift = f.x, store(w.origin + 3 * body_tree(b), f.x), f.x = Vec{0, 0, 0};
        set_frame(w, b, f);
        Spatial v{{0, 0, 0}, {0, 0, 0}}, a{{0, 0, 0}, -1 * load(P.gravity())};
        if (hub_parent(i) >= 0) v = load_spatial(w.hub + 12 * hub_parent(i)), a = load_spatial(w.hub + 12 * hub_parent(i) + 6);
        ROLLED for (int j = first; j < last; j++) {
            int d = joint_v(j);
            if (joint_type(j) == FREE) {
                Mat R = matrix(f.turn);
                v.l = v.l + load(w.v + d);
                Spatial own = v;  // the axes of one joint do not turn each other
                for (int k = 0; k < 3; k++) {
                    Spatial s{column(R, k), {0, 0, 0}};
                    store_spatial(w.S + 6 * (3 + k), s);
                    a = a + w.v[d + 3 + k] * cross_motion(own, s);
                    v = v + w.v[d + 3 + k] * s;
                }
                h += 6;
            } else {
                Vec axis = load(w.S + 6 * h), anchor = load(w.S + 6 * h + 3) - shift;
                Spatial s = joint_type(j) == SLIDE ? Spatial{{0, 0, 0}, axis} : Spatial{axis, cross(anchor, axis)};
                store_spatial(w.S + 6 * h, s);
                a = a + w.v[d] * cross_motion(v, s);
                v = v + w.v[d] * s;
                h++;
            }
        }
        store_spatial(w.hub + 12 * i, v), store_spatial(w.hub + 12 * i + 6, a);
    }
    SYNC();
}

// How a limb moves: of each degree of freedom its motion, and velocity and acceleration, without that of the joints, of the
// link that it moves.
struct LimbMotion {
    Spatial S[LD], v[LD], a[LD];
};
// Poses and motions of a limb, from the hub outwards. Loops stay loops: the code is run through once in a step, so that fetching
// it takes longer than what is saved by copies of it.
FN void move_limb(LimbMotion& o, World& w, const Parameters& P, int slot) {
    for (int d = 0; d < LD; d++) o.S[d] = o.v[d] = o.a[d] = Spatial{{0, 0, 0}, {0, 0, 0}};
    Frame f = frame_of(w, limb_parent(slot));
    Spatial v{{0, 0, 0}, {0, 0, 0}}, a{{0, 0, 0}, {0, 0, 0}};
    if (limb_link(slot) >= 0) v = load_spatial(w.hub + 12 * limb_link(slot)), a = load_spatial(w.hub + 12 * limb_link(slot) + 6);
    else a.l = -1 * load(P.gravity());
    ROLLED for (int d = 0; d < limb_size(slot); d++) {
        const int i = limb_dof(slot * LD + d), j = dof_joint(i), link = dof_body(i);
        if (j == body_joint(link)) f = hang(f, P, link);
        Vec axis, anchor;
        move_by_joint(P, j, w.q[joint_q(j)], f.x, f.turn, axis, anchor);
        Spatial s = joint_type(j) == SLIDE ? Spatial{{0, 0, 0}, axis} : Spatial{axis, cross(anchor, axis)};
        a = a + w.v[i] * cross_motion(v, s);
        v = v + w.v[i] * s;
        o.S[d] = s, o.v[d] = v, o.a[d] = a;
        if (!ends_body(slot * LD + d)) continue;
        f.turn = normalized(f.turn);
        set_frame(w, link, f);
        ROLLED for (int t = weld_start(slot * LD + d); t < weld_start(slot * LD + d + 1); t++)
            set_frame(w, weld(t), hang(frame_of(w, body_parent(weld(t))), P, weld(t)));
    }
}

// Force on a degree of freedom but for those of constraints, of which `bias` is what its bodies need, and what the implicit
// step has beside the mass matrix there.
template <bool IS_FREE>
FN void set_joint_force(DofParts& o, World& w, const Parameters& P, int i, real bias) {
    const int j = dof_joint(i);
    const real v = w.v[i], h = P.step_size(), damping = P.damping()[i];
    real f = APPLIED(w, P.id, i) - bias - damping * v, total = 0;
    o.implicit = h * damping;
    if (!IS_FREE && joint_type(j) != FREE) {
        const real q = w.q[joint_q(j)];
        f -= P.stiffness()[j] * (q - P.spring()[joint_q(j)]);
        ROLLED for (int t = dof_actuator_start(i); t < dof_actuator_start(i + 1); t++) {
            const int u = dof_actuator(t);
            real slope;
            const real gear = P.gear()[6 * u];
            total += gear * actuator_force(P, u, CONTROL(w, P.id, u), q, v, slope);
            if (IMPLICIT) o.implicit -= h * gear * gear * slope;
        }
        if (joint_force_limited(j)) total = clamped(total, P.joint_force()[2 * j], P.joint_force()[2 * j + 1]);
    }
    EFFORT(w, P.id, i) = total;
    o.smooth = f + total;
}

// The parts of the degree of freedom `i`, of which it may be known that it `IS_FREE`. Returns its number of constraint rows.
template <bool IS_FREE = false>
FN int set_dof_parts(DofParts& o, World& w, const Parameters& P, int i, real bias, int& overflow) {
    const int j = dof_joint(i);
    int count = 0;
    o.armature = P.armature()[i];
    set_joint_force<IS_FREE>(o, w, P, i, bias);
    o.sign = o.D = o.e = 0;
    if (!IS_FREE && joint_limited(j)) {  // at one end: the model's range is wider than its margins
        const real q = w.q[joint_q(j)], low = q - P.range()[2 * j], high = P.range()[2 * j + 1] - q;
        const real margin = P.limit_margin()[j], pos = smaller(low, high);
        if (pos < margin) {
            Impedance z = impedance(P, P.solref_limit() + 2 * j, P.solimp_limit() + 5 * j, pos - margin);
            o.sign = low < high ? 1 : -1, o.D = 1 / regularization(z.imp, P.dof_weight()[i]);
            o.e = z.k * z.imp * (pos - margin) + o.sign * (w.a[i] + z.b * w.v[i]);
            count = 1;
        }
    }
    const real loss = P.loss()[i];
#if LOSSES
    o.loss = loss, o.loss_D = o.loss_e = 0;
    if (loss > 0) {
        Impedance z = impedance(P, P.solref_loss() + 2 * i, P.solimp_loss() + 5 * i, 0);
        o.loss_D = 1 / regularization(z.imp, P.dof_weight()[i]), o.loss_e = w.a[i] + z.b * w.v[i];
        count++;
    }
#else
    if (loss > 0) overflow |= OVERFLOW_ROWS;  // a kernel that is made anew has a place for it
#endif
    return count;
}

template <int N>
FN void set_rows(JointRows<N>& rows, int d, const DofParts& o) {
    rows.sign[d] = o.sign, rows.D[d] = o.D, rows.e[d] = o.e, rows.js[d] = 0;
#if LOSSES
    rows.loss[d] = o.loss, rows.loss_D[d] = o.loss_D, rows.loss_e[d] = o.loss_e;
#endif
}

// Mass matrix of a limb, but for armatures, and what its degrees of freedom need of force; `inertia` and `needed` become
// those of all of it.
FN void limb_forces(World& w, const Parameters& P, Limb& L, const LimbMotion& motion, int slot, real* bias, real* inertia, Spatial& needed) {
    real X[LD * 10];
    Spatial F[LD];
    for (int k = 0; k < LD * 10; k++) X[k] = 0;
    for (int d = 0; d < LD; d++) F[d] = Spatial{{0, 0, 0}, {0, 0, 0}};
    ROLLED for (int d = 0; d < limb_size(slot); d++) {
        const int at = slot * LD + d, link = dof_body(limb_dof(at));
        if (!ends_body(at)) continue;
        real I[10];
        place_inertia(I, w.link[at], frame_of(w, link));
        for (int k = 0; k < 10; k++) X[10 * d + k] = I[k];
        F[d] = inertial_force(I, motion.v[d], motion.a[d]);
        if (w.link[at].special == 0) continue;
        F[d] = F[d] + special_force(w, P, link);
        ROLLED for (int t = weld_start(at); t < weld_start(at + 1); t++) F[d] = F[d] + special_force(w, P, weld(t));
    }
    for (int k = 0; k < 10; k++) inertia[k] = 0;
    needed = Spatial{{0, 0, 0}, {0, 0, 0}};
    const int attached = limb_parent(slot);
    UNROLLED for (int d = 0; d < LD; d++) L.S[d] = motion.S[d];
    UNROLLED for (int d = LD - 1; d >= 0; d--) {
        for (int k = 0; k < 10; k++) inertia[k] += X[10 * d + k];
        needed = needed + F[d];
        Spatial U = operator_inertia(inertia, L.S[d]);
        UNROLLED for (int e = 0; e <= d; e++) L.A[PACKED(d, e)] = dot(L.S[e], U);
        UNROLLED for (int h = 0; h < NH; h++)
            L.B[d * NH + h] = ALL_HUB || is_moved_by(attached, hub_dof(h)) ? dot(hub_motion(w, h), U) : 0;
        bias[d] = dot(L.S[d], needed);
    }
}

// What the degrees of freedom of a limb have beside bodies. Returns the number of constraint rows.
FN int limb_dof_parts(Limb& L, JointRows<LD>& rows, World& w, const Parameters& P, int slot, const real* bias, int& overflow) {
    DofParts parts[LD];
    int count = 0;
    ROLLED for (int d = 0; d < LD; d++) {
        DofParts& o = parts[d] = DofParts{1};  // a degree of freedom that is none is by itself, at rest
        if (d < limb_size(slot)) count += set_dof_parts(o, w, P, limb_dof(slot * LD + d), bias[d], overflow);
    }
    UNROLLED for (int d = 0; d < LD; d++) {
        const DofParts& o = parts[d];
        const int i = limb_dof(slot * LD + d);
        const bool is_one = d < limb_size(slot);
        L.A[PACKED(d, d)] += o.armature, L.smooth[d] = o.smooth, L.implicit[d] = o.implicit, L.a[d] = is_one ? w.a[i] : 0;
        set_rows(rows, d, o);
    }
    return count;
}

// All of it of the hub, on which the limbs hang; `inertia` and `needed` are those of the limbs of this lane. Returns the number
// of constraint rows.
FN int hub_forces(World& w, const Parameters& P, Hub& H, JointRows<NH>& rows, const real (*inertia)[10], const Spatial* needed, int lane, int& overflow) {
    real X[10 * (HUB_BODIES ? HUB_BODIES : 1)];
    Spatial F[HUB_BODIES ? HUB_BODIES : 1];
    ROLLED for (int i = 0; i < HUB_BODIES; i++) {
        real *sum = X + 10 * i, own[10];
        for (int k = 0; k < 10; k++) sum[k] = 0;
        F[i] = Spatial{{0, 0, 0}, {0, 0, 0}};
        if (hub_limbs(i)) {
            for (int l = 0; l < NL; l++) {
                if (limb_link(slot_of(l, lane)) != i) continue;
                for (int k = 0; k < 10; k++) sum[k] += inertia[l][k];
                F[i] = F[i] + needed[l];
            }
            for (int k = 0; k < 10; k++) sum[k] = SUM(sum[k]);
            F[i] = Spatial{{SUM(F[i].a.x), SUM(F[i].a.y), SUM(F[i].a.z)}, {SUM(F[i].l.x), SUM(F[i].l.y), SUM(F[i].l.z)}};
        }
        const int b = hub_body(i);
        const LinkParameters& link = w.hub_link[i];
        const Frame f = frame_of(w, b);
        place_inertia(own, link, f);
        for (int k = 0; k < 10; k++) sum[k] += own[k];
        F[i] = F[i] + inertial_force(own, load_spatial(w.hub + 12 * i), load_spatial(w.hub + 12 * i + 6));
        if (link.special != 0) F[i] = F[i] + special_force(w, P, b);
    }
    ROLLED for (int i = HUB_BODIES - 1; i > 0; i--) {
        int p = hub_parent(i);
        if (p < 0) continue;
        for (int k = 0; k < 10; k++) X[10 * p + k] += X[10 * i + k];
        F[p] = F[p] + F[i];
    }
    int count = 0;
    EACH(h, NH) {  // a lane some of them, for all lanes
        const int i = hub_dof(h);
        count += set_dof_parts<HUB_IS_FREE && NH == 6>(w.hub_parts[h], w, P, i, dot(hub_motion(w, h), F[hub_dof_link(h)]), overflow);
    }
    SYNC();
    UNROLLED for (int h = 0; h < NH; h++) {
        const int i = hub_dof(h), link = hub_dof_link(h), b = dof_body(i);
        const Spatial U = operator_inertia(X + 10 * link, hub_motion(w, h));
        UNROLLED for (int k = 0; k <= h; k++)
            H.C[PACKED(h, k)] = HUB_IS_CHAIN || is_moved_by(b, hub_dof(k)) ? dot(hub_motion(w, k), U) : 0;
        const DofParts& o = w.hub_parts[h];
        H.C[PACKED(h, h)] += o.armature, H.smooth[h] = o.smooth, H.implicit[h] = o.implicit, H.a[h] = w.a[i];
        if (h >= FIRST_HUB_ROW) set_rows(rows, h, o);
    }
    return count;
}

#if HAS_NEWTON
// Poses and velocities of all bodies as Newton has them, once they have moved. What is known of links is overwritten.
FN void write_newton_bodies(World& w, const Parameters& P, const LimbMotion* motion, int lane) {
    for (int l = 0; l < NL; l++)
        ROLLED for (int d = 0, at = slot_of(l, lane) * LD; d < limb_size(slot_of(l, lane)); d++, at++) {
            if (!ends_body(at)) continue;
            ROLLED for (int first = weld_start(at) - 1, t = first; t < weld_start(at + 1); t++) {  // the link, and its welds
                const int b = t == first ? dof_body(limb_dof(at)) : weld(t);
                const Frame f = frame_of(w, b);
                keep_velocity(w.velocities + 6 * b, P, b, f.x, f.turn, motion[l].v[d]);
            }
        }
    const Spatial still{{0, 0, 0}, {0, 0, 0}};
    EACH(i, HUB_BODIES + NSTATIC) {
        int b = i < HUB_BODIES ? hub_body(i) : static_body(i - HUB_BODIES);
        Frame f = frame_of(w, b);
        keep_velocity(w.velocities + 6 * b, P, b, f.x, f.turn, i < HUB_BODIES ? load_spatial(w.hub + 12 * i) : still);
    }
    write_body_rows(w, P, lane);
}
#endif

}  // namespace fused
