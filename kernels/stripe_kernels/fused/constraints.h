// SPDX-License-Identifier: Apache-2.0
// Constraints: rows of equalities, friction losses, joint limits and contacts, with their regularisation and reference
// acceleration.
// Formulas: MuJoCo's documentation, chapter "Computation", sections "Constraint model" and "Solver parameters".

namespace fused {

// What a row needs beside its Jacobian, for `complete_rows`.
FN void set_row(real* o, RowKind kind, real D, real damping, real stiffness, real loss) {
    o[R_D] = D, o[R_KIND] = kind, o[R_LOSS] = loss, o[R_JS] = damping, o[R_E] = stiffness;
}

#if !WRENCH_ROWS
// e = J a - reference acceleration of all rows.
template <bool FITS>
FN void complete_rows(World& w, int rows, int, int lane) {
    EACH(r, rows) {
        real* o = row_of<FITS>(w, r);
        o[R_E] += product(o, w.a) + o[R_JS] * product(o, w.v);
    }
    SYNC();
}
#endif

// Row of a joint coordinate: J = sign at one degree of freedom.
FN real* joint_row(World& w, int r, int dof, real sign) {
    real* o = row(w, r);
#if WRENCH_ROWS
    o[R_DOF] = dof, o[R_SIGN] = sign;
#else
    for (int k = 0; k < NV; k++) o[k] = 0;
    o[dof] = sign;
#endif
    return o;
}

// Row of an equality of joints: q1 - q1_0 = c_0 + c_1 (q2 - q2_0) + ... + c_4 (q2 - q2_0)^4.
FN void joint_equality_row(World& w, const Parameters& P, int e, int r) {
    int j1 = equality_joint(2 * e), j2 = equality_joint(2 * e + 1);
    const real* c = P.equality() + EQUALITY_DATA * e;
    real pos = w.q[joint_q(j1)] - P.qpos0()[joint_q(j1)] - c[0], weight = P.dof_weight()[joint_v(j1)];
    real* o = joint_row(w, r, joint_v(j1), 1);
    if (j2 >= 0) {
        real x = w.q[joint_q(j2)] - P.qpos0()[joint_q(j2)];
        pos -= x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])));
        o[joint_v(j2)] = -(c[1] + x * (2 * c[2] + x * (3 * c[3] + x * 4 * c[4])));
        weight += P.dof_weight()[joint_v(j2)];
    }
    Impedance z = impedance(P, P.solref_equality() + 2 * e, P.solimp_equality() + 5 * e, pos);
    set_row(o, EQUALITY, 1 / regularization(z.imp, weight), z.b, z.k * z.imp * pos, 0);
}

#if NATTACHMENTS
FN void attachment_rows(World& w, int lane);
#endif

// Rows of the equalities that are active, in their order. Returns their number.
FN int equality_rows(World& w, const Parameters& P, int lane) {
    int rows = 0;
    for (int first = 0; first < NEQ; first += LANES) {
        int e = first + lane, mine = 0, before = 0, all;
        if (e < NEQ && ((const unsigned char*)P.m.eq_active)[(long long)P.id * NEQ + e]) mine = equality_size(e);
        all = mine;
        BEFORE(mine, before, all);
        int r = rows + before;
#if NATTACHMENTS
        if (e < NEQ && equality_attachment(e) >= 0)
            w.attachments[ATTACHMENT_SIZE * equality_attachment(e) + A_ROW] = mine ? r : -1;
        if (e < NEQ && equality_attachment(e) >= 0) mine = 0;
#endif
        if (mine && r < MAX_ROWS) joint_equality_row(w, P, e, r);
        rows += all;
    }
#if NATTACHMENTS
    SYNC();
    attachment_rows(w, lane);
#endif
    return rows;
}

// Rows of friction losses and of limits, behind the first `rows` ones. Returns the number of all, the same for all lanes.
FN int joint_rows(World& w, const Parameters& P, int rows, int lane) {
    for (int first = 0; first < NV; first += LANES) {
        int i = first + lane, mine = 0, before = 0, all;
        if (i < NV) mine = P.loss()[i] > 0;
        all = mine;
        BEFORE(mine, before, all);
        int r = rows + before;
        if (mine && r < MAX_ROWS) {
            Impedance z = impedance(P, P.solref_loss() + 2 * i, P.solimp_loss() + 5 * i, 0);
            real D = 1 / regularization(z.imp, P.dof_weight()[i]);
            set_row(joint_row(w, r, i, 1), FRICTION_LOSS, D, z.b, 0, P.loss()[i]);
        }
        rows += all;
    }
    for (int first = 0; first < NJ; first += LANES) {
        int j = first + lane, mine = 0, before = 0, all, size = 0;
        real margin = 0, pos[2] = {0, 0}, sign[2] = {1, -1};
        Vec axis{1, 0, 0};
        if (j < NJ && joint_limited(j)) {
            const real *range = P.range() + 2 * j, *q = w.q + joint_q(j);
            margin = P.limit_margin()[j];
            if (joint_type(j) == BALL) {  // the angle of its rotation must not exceed the larger end of the range
                Quat r = normalized(load_quat(q));
                if (r.w < 0) r = Quat{-r.w, -r.x, -r.y, -r.z};
                Vec v{r.x, r.y, r.z};
                real n = SQRT(dot(v, v)), angle = 2 * ATAN2(n, r.w);
                if (n > (real)1e-15) axis = (1 / n) * v;
                pos[0] = larger(range[0], range[1]) - angle, size = 1;
            } else
                pos[0] = q[0] - range[0], pos[1] = range[1] - q[0], size = 2;
            for (int side = 0; side < size; side++) mine += pos[side] < margin;
        }
        all = mine;
        BEFORE(mine, before, all);
        int r = rows + before;
        ROLLED for (int side = 0; side < size; side++) {
            if (!(pos[side] < margin)) continue;
            if (r < MAX_ROWS) {
                int d = joint_v(j);
                real* o = joint_row(w, r, d, sign[side]);
                if (joint_type(j) == BALL) store(o + d, -1 * axis);
                Impedance z = impedance(P, P.solref_limit() + 2 * j, P.solimp_limit() + 5 * j, pos[side] - margin);
                real D = 1 / regularization(z.imp, P.dof_weight()[d]);
                set_row(o, INEQUALITY, D, z.b, z.k * z.imp * (pos[side] - margin), 0);
            }
            r++;
        }
        rows += all;
    }
    SYNC();
    return rows;
}

// Velocity of a contact point of a body for a unit speed of a degree of freedom, and its angular velocity. The point is
// relative to `origin`.
FN Spatial point_motion(const World& w, int body, int dof, Vec at, Vec origin) {
    if (!((body_dofs(body) >> dof) & 1)) return Spatial{{0, 0, 0}, {0, 0, 0}};
    Spatial s = load_spatial(w.S + 6 * dof);
    return Spatial{s.a, s.l + cross(s.a, at + (origin - origin_of(w, body)))};
}

FN int rows_of(const real* C) {
    int dim = (int)C[C_DIM];
    return dim == 1 || ELLIPTIC_CONES ? dim : 2 * (dim - 1);
}

// Places of the contacts' rows behind the first `rows` ones. Returns the number of all. A contact that does not fit is
// `dropped` whole, and so are those behind it.
FN int place_rows(World& w, int& count, int rows, bool& dropped, int lane) {
    const int start = rows;
    for (int first = 0; first < count; first += LANES) {
        real* C = contact(w, first + lane < count ? first + lane : 0);
        int mine = first + lane < count ? rows_of(C) : 0, before = 0, all = mine;
        BEFORE(mine, before, all);
        if (mine) C[C_ROW] = rows + before + mine <= MAX_ROWS ? rows + before : -1;
        rows += all;
    }
    SYNC();
    if (rows > MAX_ROWS) {
        dropped = true;
        for (rows = start; count > 0 && contact(w, count - 1)[C_ROW] < 0;) count--;
        if (count) rows = (int)contact(w, count - 1)[C_ROW] + rows_of(contact(w, count - 1));
    }
    return rows;
}

#if !WRENCH_ROWS
template <bool FITS>
FN void contact_rows(World& w, int count, int lane) {
    EACH(t, count * NV) {
        int c = t / NV, k = t % NV;
        const real *C = contact_of<FITS>(w, c), *friction = C + C_FRICTION;
        int dim = (int)C[C_DIM], b1 = (int)C[C_BODY], b2 = (int)C[C_BODY + 1], r = (int)C[C_ROW];
        Vec at = load(C + C_POS), origin = origin_of(w, b1, b2), n = load(C + C_NORMAL), t1 = load(C + C_TANGENT);
        Vec frame[3] = {n, t1, cross(n, t1)};
        Spatial m1 = point_motion(w, b1, k, at, origin), m2 = point_motion(w, b2, k, at, origin);
        Vec u = m2.l - m1.l, turning = m2.a - m1.a;
        real normal = dot(n, u);
        if (dim == 1 || ELLIPTIC_CONES) row_of<FITS>(w, r)[k] = dim == 1 ? normal : C[C_MU] * normal;
#pragma unroll
        for (int i = 1; i < 6; i++) {
            if (i >= dim) break;
            real along = i < 3 ? dot(frame[i], u) : dot(frame[i - 3], turning);
            if (ELLIPTIC_CONES) row_of<FITS>(w, r + i)[k] = friction[i - 1] * along;
            else {
                row_of<FITS>(w, r + 2 * i - 2)[k] = normal + friction[i - 1] * along;
                row_of<FITS>(w, r + 2 * i - 1)[k] = normal - friction[i - 1] * along;
            }
        }
    }
    EACH(c, count) {
        const real *C = contact_of<FITS>(w, c), *friction = C + C_FRICTION;
        int dim = (int)C[C_DIM], r = (int)C[C_ROW], size = rows_of(C);
        real R = C[C_R], mu = C[C_MU];
        if (ELLIPTIC_CONES) contact_of<FITS>(w, c)[C_CONE] = 0;
        if (dim == 1) set_row(row_of<FITS>(w, r), INEQUALITY, 1 / R, C[C_DAMPING], C[C_STIFFNESS], 0);
        else if (!ELLIPTIC_CONES)
            ROLLED for (int i = 0; i < size; i++)
                set_row(row_of<FITS>(w, r + i), INEQUALITY, 1 / (2 * mu * mu * R), C[C_DAMPING], C[C_STIFFNESS], 0);
        else  // scaled, see cones.h
            ROLLED for (int i = 0; i < dim; i++)
                set_row(row_of<FITS>(w, r + i), ELLIPTIC, 1 / (mu * mu * R), C[C_DAMPING + (i > 0)], i ? 0 : mu * C[C_STIFFNESS], c);
    }
    SYNC();
}
#endif

}  // namespace fused
