// SPDX-License-Identifier: Apache-2.0
// Attachments: equalities that connect two bodies at a point, or weld their frames. Their rows hold at zero
//
//     x = p1 - p2  and  r = torquescale vec(conj(q2) q1),
//
// the points p and orientations q of the first and second body (or site) in the world. Source: MuJoCo's documentation,
// chapter "Computation", section "Equality", and its XML reference of `connect` and `weld`. Rates follow from
// q' = 1/2 (0, w) q with the angular velocity w. With the rotation R2 of q2 and (s, u) = torquescale/2 conj(q2) q1,
//
//     r' = s y + y x u,  y = R2' (w1 - w2),
//     r'' = s z + z x u - 1/2 |w1 - w2|^2 u,  z = R2' (w1' - w2' + w1 x w2).
//
// The reference accelerations have x'' and r'' at rest of the joints, which J does not have: J a is the rest of them.

#if NATTACHMENTS
namespace fused {

// Of an orientation (s, u) and a vector in its frame: the vector part of its product with them, from the left.
FN Vec turned_part(Quat h, Vec y) { return h.w * y + cross(y, Vec{h.x, h.y, h.z}); }

// What the rows need of the bodies' frames and velocities, which geoms and the rows are going to overwrite.
FN void place_attachments(World& w, const Parameters& P, int lane) {
    EACH(i, NATTACHMENTS) {
        const int e = attached_equality(i), bodies[] = {attached_body(2 * i), attached_body(2 * i + 1)};
        const bool is_weld = equality_size(e) == 6;
        const real* data = P.equality() + EQUALITY_DATA * e;
        real *o = w.attachments + ATTACHMENT_SIZE * i, weight[2] = {0, 0};
        Vec at[2], bias[2], spin[2], turning[2];
        Quat q[2];
        for (int k = 0; k < 2; k++) {
            const int b = bodies[k], site = attached_site(2 * i + k);
            // A connection has the point of each body, a weld that of the second body first.
            Vec own = load(site >= 0 ? P.site_pos() + 3 * site : data + 3 * (is_weld ? 1 - k : k));
            q[k] = load_quat(w.quat + 4 * b);
            at[k] = load(w.pos + 3 * b) + rotate(q[k], own);
            if (site >= 0) q[k] = q[k] * load_quat(P.site_quat() + 4 * site);
            else if (k == 0 && is_weld) q[k] = q[k] * load_quat(data + 6);
            Spatial v = load_spatial(w.V + 6 * b), a = load_spatial(w.A + 6 * b);
            spin[k] = v.a, turning[k] = a.a;
            bias[k] = a.l + cross(a.a, at[k]) + cross(v.a, v.l + cross(v.a, at[k]));
            weight[0] += P.weight()[2 * b], weight[1] += P.weight()[2 * b + 1];
            store(o + A_POINT + 3 * k, at[k]);
        }
        Vec x = at[0] - at[1] + (origin_of(w, bodies[0]) - origin_of(w, bodies[1])), r{0, 0, 0}, rate{0, 0, 0};
        if (is_weld) {
            Quat back = conjugate(q[1]), h = back * q[0];
            const real half = (real)0.5 * data[10];
            h = Quat{half * h.w, half * h.x, half * h.y, half * h.z};
            r = Vec{2 * h.x, 2 * h.y, 2 * h.z};
            Vec dw = spin[0] - spin[1], z = rotate(back, turning[0] - turning[1] + cross(spin[0], spin[1]));
            rate = turned_part(h, z) - ((real)0.25 * dot(dw, dw)) * r;
            store_quat(o + A_TURN, q[1]), store_quat(o + A_RELATIVE, h);
        }
        Impedance z = impedance(P, P.solref_equality() + 2 * e, P.solimp_equality() + 5 * e, SQRT(dot(x, x) + dot(r, r)));
        store(o + A_E, (z.k * z.imp) * x + (bias[0] - bias[1])), store(o + A_E + 3, (z.k * z.imp) * r + rate);
        for (int k = 0; k < 2; k++) o[A_D + k] = 1 / regularization(z.imp, weight[k]);
        o[A_DAMPING] = z.b;
    }
    SYNC();
}

// Rows of all attachments, of which A_ROW says where they begin.
FN void attachment_rows(World& w, int lane) {
    EACH(t, NATTACHMENTS * NV) {
        const int i = t / NV, k = t % NV, bodies[] = {attached_body(2 * i), attached_body(2 * i + 1)}, size = equality_size(attached_equality(i));
        const real* o = w.attachments + ATTACHMENT_SIZE * i;
        const int first = (int)o[A_ROW];
        if (first < 0) continue;
        Spatial m1 = point_motion(w, bodies[0], k, load(o + A_POINT), origin_of(w, bodies[0]));
        Spatial m2 = point_motion(w, bodies[1], k, load(o + A_POINT + 3), origin_of(w, bodies[1]));
        Vec u = m1.l - m2.l, turned{0, 0, 0};
        if (size == 6)
            turned = turned_part(load_quat(o + A_RELATIVE), rotate(conjugate(load_quat(o + A_TURN)), m1.a - m2.a));
        const real column[6] = {u.x, u.y, u.z, turned.x, turned.y, turned.z};
        for (int n = 0; n < size && first + n < MAX_ROWS; n++) {
            real* own = row(w, first + n);
            own[k] = column[n];
            if (k == 0) set_row(own, EQUALITY, o[A_D + n / 3], o[A_DAMPING], o[A_E + n], 0);
        }
    }
}

// Wrench of an attachment on its first body (k = 0) or its second one, about the origin of the body's tree.
FN Spatial attachment_wrench(const World& w, int i, int k) {
    const real* o = w.attachments + ATTACHMENT_SIZE * i;
    const int first = (int)o[A_ROW], size = equality_size(attached_equality(i));
    real f[6] = {0, 0, 0, 0, 0, 0}, sign = k ? -1 : 1;
    if (first >= 0)
        for (int n = 0; n < size && first + n < MAX_ROWS; n++) f[n] = row_of<false>(w, first + n)[R_F];
    Vec torque{0, 0, 0}, force = load(f), moment = load(f + 3);
    if (size == 6) {  // the transpose of what turns an angular velocity into r'
        Quat h = load_quat(o + A_RELATIVE);
        torque = rotate(load_quat(o + A_TURN), h.w * moment + cross(Vec{h.x, h.y, h.z}, moment));
    }
    return sign * Spatial{torque + cross(load(o + A_POINT + 3 * k), force), force};
}

}  // namespace fused
#endif
