// SPDX-License-Identifier: Apache-2.0
// Results: what others read of a step, in MuJoCo's data or in arrays of their own: poses of bodies and geoms, contacts and
// their forces. Kernels contain only what somebody asked for.

namespace fused {

#if HAS_NEWTON
// Poses and velocities of bodies that have moved.
FN void write_newton_bodies(World& w, const Parameters& P, int lane) {
    EACH(b, NB)
        keep_velocity(body_velocities(w) + 6 * b, P, b, load(w.pos + 3 * b), load_quat(w.quat + 4 * b), load_spatial(w.V + 6 * b));
    write_body_rows(w, P, lane);
}
#endif

// Of geoms that move; those of the world are where they are.
FN void write_geom_poses(const World& w, const Parameters& P, int lane) {
    EACH(g, NALLGEOMS) {
        if (geom_body(g) == 0) continue;
        Geom o = geom_of(w, P, g);
        store((real*)P.geom_xpos() + 3 * g, o.pos + origin_of(w, geom_body(g)));
        store_matrix((real*)P.geom_xmat() + 9 * g, o.axes);
    }
}

#if CONTACTS || CONTACT_FORCES
// Geom of a contact, the first (k = 0) or the second one.
FN int contact_geom(const real* C, const real* given, int k) {
    int pair = (int)C[C_PAIR];
    if (pair < 0) return (int)given[GIVEN_SIZE * (-1 - pair) + G_GEOM + k];
    return k ? contact_geom2(pair) : first_geom(C, pair);
}
#endif

#if CONTACT_FORCES || ACCELERATIONS
// Wrench of a contact on its second body, about its point, from the forces of its rows: normal, two tangents, and torques
// about the same axes. In a pyramid the rows are pairs of edges, each the normal and plus or minus a friction coefficient
// times another axis.
FN Spatial contact_wrench(const World& w, const real* C) {
    int dim = (int)C[C_DIM], r = (int)C[C_ROW];
    Vec n = load(C + C_NORMAL), t = load(C + C_TANGENT), force{0, 0, 0}, torque{0, 0, 0};
    ROLLED for (int i = 0; i < dim; i++) {
        bool is_pair = dim > 1 && !ELLIPTIC_CONES;
        real x = 0;
        if (!is_pair) x = row_of<false>(w, r + i)[R_F];
        else if (i) {
            const real *plus = row_of<false>(w, r + 2 * i - 2), *minus = row_of<false>(w, r + 2 * i - 1);
            x = C[C_FRICTION + i - 1] * (plus[R_F] - minus[R_F]);
        }
        else
            for (int k = 0; k < 2 * (dim - 1); k++) x += row_of<false>(w, r + k)[R_F];
        Vec axis = i % 3 == 0 ? n : i % 3 == 1 ? t : cross(n, t);
        if (i < 3) force = force + x * axis;
        else torque = torque + x * axis;
    }
    return Spatial{torque, force};
}
#endif

#if CONTACT_FORCES
// Geoms of the contacts, and their forces on the second one in the world. The first place without a contact has geoms of -1.
FN void write_contact_forces(const World& w, const Parameters& P, const real* given, int contacts, int lane) {
    EACH(c, contacts < MAX_CONTACTS ? contacts + 1 : MAX_CONTACTS) {
        const bool is_contact = c < contacts;
        const real* C = contact_of<false>(w, is_contact ? c : 0);
        for (int k = 0; k < 2; k++) P.force_geoms()[2 * c + k] = is_contact ? contact_geom(C, given, k) : -1;
        if (is_contact) store(P.contact_forces() + 3 * c, contact_wrench(w, C).l);
    }
}
#endif

#if CONTACTS
FN void write_body_poses(const World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        store(P.xpos() + 3 * b, load(w.pos + 3 * b) + origin_of(w, b));
        store_quat(P.xquat() + 4 * b, load_quat(w.quat + 4 * b));
    }
}

// Contacts of the world, in its MAX_CONTACTS places among those of all worlds; the other places are of no geoms. `rows` are all
// rows, whose forces are known.
FN void write_contacts(const World& w, const Parameters& P, const real* given, int contacts, int rows, int lane) {
    const long long first = (long long)P.id * MAX_CONTACTS;
    EACH(r, rows) P.efc_force()[r] = row_of<false>(w, r)[R_F];
    EACH(c, MAX_CONTACTS) {
        int* geom = (int*)P.m.contact_geom + 2 * (first + c);
        int* address = (int*)P.m.contact_efc_address + NADDRESSES * (first + c);
        ((int*)P.m.contact_worldid)[first + c] = P.id;
        geom[0] = geom[1] = -1;
        for (int i = 0; i < NADDRESSES; i++) address[i] = -1;
        if (c >= contacts) {
            ((int*)P.m.contact_dim)[first + c] = 0;
            continue;
        }
        const real* C = contact_of<false>(w, c);
        const int size = rows_of(C);
        for (int k = 0; k < 2; k++) geom[k] = contact_geom(C, given, k);
        for (int i = 0; i < size; i++) address[i] = (int)C[C_ROW] + i;
        Vec n = load(C + C_NORMAL), t = load(C + C_TANGENT);
        store((real*)P.m.contact_pos + 3 * (first + c), load(C + C_POS) + origin_of(w, (int)C[C_BODY], (int)C[C_BODY + 1]));
        store_matrix((real*)P.m.contact_frame + 9 * (first + c), Mat{n, t, cross(n, t)});
        for (int i = 0; i < 5; i++) ((real*)P.m.contact_friction)[5 * (first + c) + i] = C[C_FRICTION + i];
        ((real*)P.m.contact_dist)[first + c] = C[C_DIST];
        ((int*)P.m.contact_dim)[first + c] = (int)C[C_DIM];
    }
}
#endif

}  // namespace fused
