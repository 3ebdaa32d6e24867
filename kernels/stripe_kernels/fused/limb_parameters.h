// SPDX-License-Identifier: Apache-2.0
// Limb parameters: what is computed of a world's parameters once in a launch. Bodies that are welded to each other become one
// link, whose inertia lies in shared memory: those of the bodies are far apart in MuJoCo's arrays, and would be fetched in each
// physics step.

namespace fused {

// Add the body `b`, which is fixed to a link at `g` in the link's frame.
FN void add_to_link(LinkParameters& o, const Parameters& P, bool is_pushed, int b, Frame g) {
    const Vec c = g.x + rotate(g.turn, load(P.com() + 3 * b));
    const real* wrench = P.xfrc_applied() + 6 * b;
    real X[10], pushed = FABS(P.gravcomp()[b]);
    spatial_inertia(X, P.mass()[b], load(P.inertia() + 3 * b), matrix(g.turn * load_quat(P.inertia_quat() + 4 * b)), c);
    for (int k = 0; k < 10; k++) o.inertia[k] += X[k];
    if (is_pushed)
        for (int k = 0; k < 6; k++) pushed += FABS(wrench[k]);
    if (pushed != 0) o.special = 1;
}
FN void clear(LinkParameters& o) {
    for (int k = 0; k < 10; k++) o.inertia[k] = 0;
    o.special = 0;
}

// Links and planes of a world. Frames of its bodies are overwritten.
FN void gather_parameters(World& w, const Parameters& P, int lane) {
    const Frame own{{0, 0, 0}, {1, 0, 0, 0}};
    for (int l = 0; l < NL; l++) {
        const int slot = slot_of(l, lane), size = limb_size(slot);
        // After the limb the hub's bodies, which lanes share.
        const int hub = l == NL - 1 ? (HUB_BODIES - lane + LANES - 1) / LANES : 0;
        ROLLED for (int d = 0; d < size + hub; d++) {
            const bool of_hub = d >= size;
            const int at = slot * LD + d, i = (d - size) * LANES + lane;
            LinkParameters& o = of_hub ? w.hub_link[i] : w.link[at];
            clear(o);
            if (!of_hub && !ends_body(at)) continue;
            const int link = of_hub ? hub_body(i) : dof_body(limb_dof(at)), welds = of_hub ? 0 : weld_start(at + 1) - weld_start(at);
            ROLLED for (int t = -1; t < welds; t++) {  // the link, and what is welded to it
                const int b = t < 0 ? link : weld(weld_start(at) + t);
                Frame g = own;
                if (t >= 0) g = hang(frame_of(w, body_parent(b)), P, b);
                set_frame(w, b, g);
                add_to_link(o, P, w.is_pushed, b, g);
            }
        }
    }
    EACH(i, NPLANES) {
        const int g = plane(i);
        const Geom at = geom_of(w, P, g);
        store(w.planes + 6 * i, at.pos + origin_of(w, geom_body(g))), store(w.planes + 6 * i + 3, column(at.axes, 2));
    }
#if NGROUNDS
    EACH(i, NGROUNDS) {
        const Geom at = geom_of(w, P, ground(i));
        store(w.grounds + 12 * i, at.pos), store_matrix(w.grounds + 12 * i + 3, at.axes);
    }
#endif
    SYNC();
}

// Inertia of a link in the axes of the world, about the point that `f` is relative to.
FN void place_inertia(real* X, const LinkParameters& o, Frame f) {
    const real* I = o.inertia;
    const Mat R = matrix(f.turn), J{{I[4], I[7], I[8]}, {I[7], I[5], I[9]}, {I[8], I[9], I[6]}};
    const Vec mc = R * load(I + 1), r = f.x, q = mc + I[0] * r;
    const Vec a0 = J * R.r0, a1 = J * R.r1, a2 = J * R.r2;
    const real both = 2 * dot(r, mc) + I[0] * dot(r, r);  // the parallel axis theorem for a point that is no centre of mass
    X[0] = I[0];
    store(X + 1, q);
    X[4] = dot(R.r0, a0) + both - r.x * q.x - mc.x * r.x;
    X[5] = dot(R.r1, a1) + both - r.y * q.y - mc.y * r.y;
    X[6] = dot(R.r2, a2) + both - r.z * q.z - mc.z * r.z;
    X[7] = dot(R.r0, a1) - r.x * q.y - mc.x * r.y;
    X[8] = dot(R.r0, a2) - r.x * q.z - mc.x * r.z;
    X[9] = dot(R.r1, a2) - r.y * q.z - mc.y * r.z;
}
// Wrench that a link alone needs for the acceleration `a` at the velocity `v`: I a + v x* I v.
FN Spatial inertial_force(const real* X, Spatial v, Spatial a) {
    return operator_inertia(X, a) + cross_force(v, operator_inertia(X, v));
}
// What gravity compensation and external wrenches on the body `b` add to it.
FN Spatial special_force(const World& w, const Parameters& P, int b) {
    const Frame f = frame_of(w, b);
    const real *given = P.xfrc_applied() + 6 * b, none[6] = {0, 0, 0, 0, 0, 0}, *wrench = w.is_pushed ? given : none;
    const Vec c = f.x + rotate(f.turn, load(P.com() + 3 * b));
    const Vec push = (-P.mass()[b] * P.gravcomp()[b]) * load(P.gravity()) + load(wrench);
    return Spatial{-1 * load(wrench + 3) - cross(c, push), -1 * push};
}

}  // namespace fused
