// SPDX-License-Identifier: Apache-2.0
// Wrench rows: constraint rows without Jacobians. A contact's row is the wrench on its second body for a unit force, about
// the origin of the tree, and the opposite one on its first body; a joint's row is a degree of freedom and a sign.
//
// A robot has many contacts and few pairs of bodies that touch: the contacts of such a pair are a group. With the twist V of
// its bodies relative to each other, J x is one dot product of six numbers for each row. The Hessian of a group is S' K S with
// K = sum of weight W W', 6 x 6, and S the motions of its degrees of freedom. So rows take little memory, and their number
// hardly any time. For models of one tree. Source: R. Featherstone, "Rigid Body Dynamics Algorithms", Springer, 2008, chapter 3.

#if WRENCH_ROWS
namespace fused {

// Contacts in a row between the same two bodies.
struct Group {
    unsigned long long second, first;  // degrees of freedom that move one of the bodies alone: a bit for each
    int row, end, next;                // its rows, and the first contact behind it
};
template <bool FITS>
FN Group group_of(const World& w, int c, int rows, int contacts) {
    const real* C = contact_of<FITS>(w, c);
    const unsigned long long a = body_dofs((int)C[C_BODY]), b = body_dofs((int)C[C_BODY + 1]);
    const int next = (int)C[C_NEXT];
    return Group{b & ~a, a & ~b, (int)C[C_ROW], next < contacts ? (int)contact_of<FITS>(w, next)[C_ROW] : rows, next};
}
struct alignas(2 * sizeof(real)) Two {
    real x[2];
};
// The motion of a degree of freedom.
FN Spatial motion_of(const World& w, int dof) {
    const Two* s = (const Two*)w.S + 3 * dof;
    const Two a = s[0], b = s[1], c = s[2];
    return Spatial{{a.x[0], a.x[1], b.x[0]}, {b.x[1], c.x[0], c.x[1]}};
}
FN real sign_of(const Group& g, int dof) { return (real)((int)(g.second >> dof & 1) - (int)(g.first >> dof & 1)); }
// Rows of joints: those before the first contact's.
template <bool FITS>
FN int joint_rows_of(const World& w, int rows, int contacts) {
    return contacts ? (int)contact_of<FITS>(w, 0)[C_ROW] : rows;
}

// Where the groups of contacts end.
template <bool FITS>
FN void group_contacts(World& w, int contacts, int lane) {
    ROLLED for (int first = (contacts - 1) / LANES * LANES; first >= 0; first -= LANES) {  // the last ones first
        const int c = first + lane;
        bool starts = false;
        if (c < contacts && c) {
            const real *C = contact_of<FITS>(w, c), *before = contact_of<FITS>(w, c - 1);
            starts = C[C_BODY] != before[C_BODY] || C[C_BODY + 1] != before[C_BODY + 1];
        }
        const unsigned behind = LANES > 1 ? BALLOT(starts) & ~((2u << lane) - 1) : 0;
        int next = first + LANES < contacts ? first + LANES : contacts;  // lanes go over as many contacts together
        if (behind) next = first + first_lane(behind);
#if LANES == 1
        if (next < contacts) {
            const real *C = contact_of<FITS>(w, c), *other = contact_of<FITS>(w, next);
            if (C[C_BODY] == other[C_BODY] && C[C_BODY + 1] == other[C_BODY + 1]) next = (int)other[C_NEXT];
        }
#endif
        if (c < contacts) contact_of<FITS>(w, c)[C_NEXT] = next;
    }
}

// Wrenches of the rows of all contacts, and what else they need.
template <bool FITS>
FN void contact_rows(World& w, int count, int lane) {
    group_contacts<FITS>(w, count, lane);
    EACH(c, count) {
        const real *C = contact_of<FITS>(w, c), *friction = C + C_FRICTION;
        const int dim = (int)C[C_DIM], r = (int)C[C_ROW], size = rows_of(C);
        const Vec at = load(C + C_POS), n = load(C + C_NORMAL), t = load(C + C_TANGENT), other = cross(n, t);
        const real D = dim == 1 ? 1 / C[C_R] : 1 / (2 * C[C_MU] * C[C_MU] * C[C_R]);
        ROLLED for (int i = 0; i < size; i++) {
            const int k = i / 2;  // of the friction coefficients: two of sliding, a torsional and two of rolling
            const real along = dim == 1 ? 0 : i % 2 ? -friction[k] : friction[k];
            const Vec axis = along * (k == 2 ? n : k == 0 || k == 3 ? t : other);
            const Vec force = k < 2 ? n + axis : n, torque = k < 2 ? Vec{0, 0, 0} : axis;
            real* o = row_of<FITS>(w, r + i);
            set_row(o, INEQUALITY, D, C[C_DAMPING], C[C_STIFFNESS], 0);
            store_spatial(o + R_WRENCH, Spatial{torque + cross(at, force), force});
        }
    }
    SYNC();
}

// The twist of a group for velocities x of the degrees of freedom.
FN Spatial twist_of(const World& w, const Group& g, const real* x, int lane) {
    Spatial v{{0, 0, 0}, {0, 0, 0}};
    EACH(i, NV) {
        const real sign = sign_of(g, i);
        if (sign != 0) v = v + sign * x[i] * motion_of(w, i);
    }
    real sums[6] = {v.a.x, v.a.y, v.a.z, v.l.x, v.l.y, v.l.z};
    sum_each<6>(sums);
    return load_spatial(sums);
}

// use(row, J x) for all rows.
template <bool FITS, class Use>
FN void multiply_rows(World& w, const real* x, int rows, int contacts, int lane, Use use) {
    EACH(r, joint_rows_of<FITS>(w, rows, contacts)) {
        real* o = row_of<FITS>(w, r);
        use(o, o[R_SIGN] * x[(int)o[R_DOF]]);
    }
    for (int c = 0; c < contacts;) {
        const Group g = group_of<FITS>(w, c, rows, contacts);
        c = g.next;
        const Spatial v = twist_of(w, g, x, lane);
        ROLLED for (int r = g.row + lane; r < g.end; r += LANES) {
            real* o = row_of<FITS>(w, r);
            use(o, dot(load_spatial(o + R_WRENCH), v));
        }
    }
    SYNC();
}

// e = J a - reference acceleration of all rows.
template <bool FITS>
FN void complete_rows(World& w, int rows, int contacts, int lane) {
    multiply_rows<FITS>(w, w.v, rows, contacts, lane, [](real* o, real x) { o[R_E] += o[R_JS] * x; });
    multiply_rows<FITS>(w, w.a, rows, contacts, lane, [](real* o, real x) { o[R_E] += x; });
}

// Subtract J' force of all rows from the gradient.
template <bool FITS>
FN void subtract_forces(World& w, int rows, int contacts, int lane) {
    const int joint_rows = joint_rows_of<FITS>(w, rows, contacts);
    if (joint_rows)
        EACH(i, NV) {
            real sum = 0;
            for (int r = 0; r < joint_rows; r++) {
                const real* o = row_of<FITS>(w, r);
                if ((int)o[R_DOF] == i) sum += o[R_SIGN] * o[R_F];
            }
            w.g[i] -= sum;
        }
    for (int c = 0; c < contacts;) {
        const Group g = group_of<FITS>(w, c, rows, contacts);
        c = g.next;
        real sums[6] = {0, 0, 0, 0, 0, 0};
        ROLLED for (int r = g.row + lane; r < g.end; r += LANES) {
            const real *o = row_of<FITS>(w, r), force = o[R_F];
            UNROLLED for (int k = 0; k < 6; k++) sums[k] += force * o[R_WRENCH + k];
        }
        sum_each<6>(sums);
        const Spatial wrench = load_spatial(sums);
        EACH(i, NV) {
            const real sign = sign_of(g, i);
            if (sign != 0) w.g[i] -= sign * dot(motion_of(w, i), wrench);
        }
    }
}

// K of a group.
template <bool FITS>
FN void add_up_stiffness(World& w, const Group& g, int lane) {
    SYNC();  // the last group's has been read
    EACH(t, 21) {
        int b = t, a = 0;
        while (b > a) b -= ++a;
        real sum = 0;
#pragma unroll 4
        for (int r = g.row; r < g.end; r++) {
            const real* o = row_of<FITS>(w, r);
            sum += o[R_WEIGHT] * o[R_WRENCH + a] * o[R_WRENCH + b];
        }
        w.stiffness[6 * a + b] = w.stiffness[6 * b + a] = sum;
    }
    SYNC();
}
// K s.
FN Spatial stiffness_times(const World& w, Spatial s) {
    const real x[6] = {s.a.x, s.a.y, s.a.z, s.l.x, s.l.y, s.l.z};
    real y[6] = {0, 0, 0, 0, 0, 0};
    UNROLLED for (int i = 0; i < 9; i++) {
        const Four four = ((const Four*)w.stiffness)[i];
        UNROLLED for (int k = 0; k < 4; k++) y[(4 * i + k) / 6] += four.x[k] * x[(4 * i + k) % 6];
    }
    return load_spatial(y);
}

}  // namespace fused
#endif
