// SPDX-License-Identifier: Apache-2.0
// Constraints: rows of friction losses, joint limits and contacts, with their regularisation and reference acceleration.
// Formulas: MuJoCo's documentation, chapter "Computation", sections "Constraint model" and "Solver parameters".

namespace fused {

enum RowKind { EQUALITY, FRICTION_LOSS, INEQUALITY, ELLIPTIC };  // an elliptic contact has several rows, the first is its normal

// A contact as collision detection finds it: CONTACT_SIZE numbers.
enum ContactField {
    C_DIST = 0,       // distance, negative inside [m]
    C_POS = 1,        // point, relative to the origin of the second body's tree [m]
    C_FRAME = 4,      // normal from the first to the second geom, and two tangents
    C_FRICTION = 13,  // two tangential, one torsional, two rolling coefficients
    C_SOLREF = 18,
    C_SOLREF_FRICTION = 20,
    C_SOLIMP = 22,
    C_MARGIN = 27,    // distance below which it is active [m]
    C_DIM = 28,
    C_BODY = 29,      // two bodies
    CONTACT_SIZE = 31,
};

struct Impedance {
    real k, b, imp;  // stiffness, damping and impedance of a row
};

// Impedance of a row at the distance `pos` from its reference.
FN Impedance impedance(const Parameters& P, const real* solref, const real* solimp, real pos) {
    const real least = (real)1e-4, most = (real)0.9999;
    real dmin = clamped(solimp[0], least, most), dmax = clamped(solimp[1], least, most);
    real width = larger(solimp[2], (real)1e-15), middle = clamped(solimp[3], least, most), power = larger(solimp[4], 1);
    real x = FABS(pos) / width, y = x;
    if (x >= 1) y = 1;
    else if (power == 2) y = x <= middle ? x * x / middle : 1 - (1 - x) * (1 - x) / (1 - middle);
    else if (power > 1)
        y = x <= middle ? POW(x, power) / POW(middle, power - 1) : 1 - POW(1 - x, power) / POW(1 - middle, power - 1);
    Impedance r;
    r.imp = dmin == dmax || solimp[2] <= (real)1e-15 ? (real)0.5 * (dmin + dmax) : dmin + y * (dmax - dmin);
    if (solref[0] > 0) {
        real time = REFSAFE ? larger(solref[0], 2 * P.timestep[0]) : solref[0], ratio = solref[1];
        r.k = 1 / larger((real)1e-15, dmax * dmax * time * time * ratio * ratio);
        r.b = 2 / larger((real)1e-15, dmax * time);
    } else
        r.k = -solref[0] / (dmax * dmax), r.b = -solref[1] / dmax;
    return r;
}

FN real regularization(real imp, real weight) { return larger((real)1e-15, (1 - imp) / imp * weight); }

// Complete row r, whose Jacobian is there: D = 1/R, and e = J a - reference acceleration.
FN void complete_row(World& w, int r, RowKind kind, real D, const Impedance& z, real pos, real loss) {
    const real* J = w.J + r * LD;
    real speed = 0, x = 0;
    for (int k = 0; k < NV; k++) speed += J[k] * w.v[k], x += J[k] * w.a[k];
    w.D[r] = D, w.kind[r] = kind, w.loss[r] = loss;
    w.e[r] = x + z.b * speed + z.k * z.imp * pos;
}

// Row of a joint coordinate: J = sign at one degree of freedom.
FN void joint_row(World& w, int r, int dof, real sign) {
    for (int k = 0; k < NV; k++) w.J[r * LD + k] = 0;
    w.J[r * LD + dof] = sign;
}

// Rows of equalities of joints: q1 - q1_0 = c_0 + c_1 (q2 - q2_0) + ... + c_4 (q2 - q2_0)^4. Returns their number.
FN int equality_rows(World& w, const Parameters& P, int lane) {
    EACH(r, NEQ) {
        int j1 = equality_joint[2 * r], j2 = equality_joint[2 * r + 1];
        const real* c = P.equality + 11 * r;
        real pos = w.q[joint_q[j1]] - P.qpos0[joint_q[j1]] - c[0], weight = P.dof_weight[joint_v[j1]];
        joint_row(w, r, joint_v[j1], 1);
        if (j2 >= 0) {
            real x = w.q[joint_q[j2]] - P.qpos0[joint_q[j2]];
            pos -= x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])));
            w.J[r * LD + joint_v[j2]] = -(c[1] + x * (2 * c[2] + x * (3 * c[3] + x * 4 * c[4])));
            weight += P.dof_weight[joint_v[j2]];
        }
        Impedance z = impedance(P, P.solref_equality + 2 * r, P.solimp_equality + 5 * r, pos);
        complete_row(w, r, EQUALITY, 1 / regularization(z.imp, weight), z, pos, 0);
    }
    return NEQ;
}

// Rows of friction losses and of limits, behind the first `rows` ones. Returns the number of all, the same for all lanes.
FN int joint_rows(World& w, const Parameters& P, int rows, int lane) {
    for (int first = 0; first < NV; first += LANES) {
        int i = first + lane, mine = 0, before = 0, all;
        if (i < NV) mine = P.loss[i] > 0;
        all = mine;
        BEFORE(mine, before, all);
        int r = rows + before;
        if (mine && r < MAX_ROWS) {
            joint_row(w, r, i, 1);
            Impedance z = impedance(P, P.solref_loss + 2 * i, P.solimp_loss + 5 * i, 0);
            z.k = 0;
            complete_row(w, r, FRICTION_LOSS, 1 / regularization(z.imp, P.dof_weight[i]), z, 0, P.loss[i]);
        }
        rows += all;
    }
    for (int first = 0; first < NJ; first += LANES) {
        int j = first + lane, mine = 0, before = 0, all, size = 0;
        real margin = 0, pos[2] = {0, 0}, sign[2] = {1, -1};
        Vec axis{1, 0, 0};
        if (j < NJ && joint_limited[j]) {
            const real *range = P.range + 2 * j, *q = w.q + joint_q[j];
            margin = P.limit_margin[j];
            if (joint_type[j] == BALL) {  // the angle of its rotation must not exceed the larger end of the range
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
        for (int side = 0; side < size; side++) {
            if (!(pos[side] < margin)) continue;
            if (r < MAX_ROWS) {
                int d = joint_v[j];
                joint_row(w, r, d, sign[side]);
                if (joint_type[j] == BALL) store(w.J + r * LD + d, -1 * axis);
                Impedance z = impedance(P, P.solref_limit + 2 * j, P.solimp_limit + 5 * j, pos[side] - margin);
                complete_row(w, r, INEQUALITY, 1 / regularization(z.imp, P.dof_weight[d]), z, pos[side] - margin, 0);
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
    Spatial s = load_spatial(w.S + 6 * dof);
    if (!((body_dofs[body] >> dof) & 1)) return Spatial{{0, 0, 0}, {0, 0, 0}};
    return Spatial{s.a, s.l + cross(s.a, at + (origin - load(w.origin + 3 * body)))};
}

// Rows of contacts behind the first `rows` ones. Returns the number of all; a contact that does not fit is `dropped` whole.
FN int contact_rows(World& w, const Parameters& P, int count, int rows, bool& dropped, int lane) {
    int cones = 0;
    for (int c = 0; c < count; c++) {
        const real *C = w.contacts + c * CONTACT_SIZE, *friction = C + C_FRICTION;
        int dim = (int)C[C_DIM], b1 = (int)C[C_BODY], b2 = (int)C[C_BODY + 1];
        int size = dim == 1 || ELLIPTIC_CONES ? dim : 2 * (dim - 1);
        if (rows + size > MAX_ROWS) {
            dropped = true;
            continue;
        }
        Vec at = load(C + C_POS), origin = load(w.origin + 3 * b2);
        Vec frame[3] = {load(C + C_FRAME), load(C + C_FRAME + 3), load(C + C_FRAME + 6)};
        EACH(k, NV) {
            Spatial m1 = point_motion(w, b1, k, at, origin), m2 = point_motion(w, b2, k, at, origin);
            Vec u = m2.l - m1.l, t = m2.a - m1.a;
            real along[6];
            for (int i = 0; i < dim; i++) along[i] = i < 3 ? dot(frame[i], u) : dot(frame[i - 3], t);
            if (dim == 1 || ELLIPTIC_CONES)
                for (int i = 0; i < dim; i++) w.J[(rows + i) * LD + k] = along[i];
            else
                for (int i = 1; i < dim; i++) {
                    w.J[(rows + 2 * i - 2) * LD + k] = along[0] + friction[i - 1] * along[i];
                    w.J[(rows + 2 * i - 1) * LD + k] = along[0] - friction[i - 1] * along[i];
                }
        }
        SYNC();
        real pos = C[C_DIST] - C[C_MARGIN];
        Impedance z = impedance(P, C + C_SOLREF, C + C_SOLIMP, pos);
        real weight = P.weight[2 * b1] + P.weight[2 * b2];
        if (dim > 1 && !ELLIPTIC_CONES) weight += friction[0] * friction[0] * weight;
        real R = regularization(z.imp, weight), mu = friction[0] * SQRT(1 / (real)IMPRATIO);
        EACH(i, size) {
            if (dim == 1) complete_row(w, rows, INEQUALITY, 1 / R, z, pos, 0);
            else if (!ELLIPTIC_CONES) complete_row(w, rows + i, INEQUALITY, 1 / (2 * mu * mu * R), z, pos, 0);
            else {
                real f = i ? friction[i - 1] : 1, own = R;
                if (i) own = R / larger((real)1e-15, IMPRATIO) * friction[0] * friction[0] / (f * f);
                Impedance y = z;
                if (i) {
                    const real* other = C + C_SOLREF_FRICTION;
                    if (other[0] != 0 || other[1] != 0) y = impedance(P, other, C + C_SOLIMP, pos);
                    y.k = 0;
                }
                complete_row(w, rows + i, ELLIPTIC, 1 / own, y, pos, 0);
                w.cone[cones * 6 + i] = i ? f : mu;
            }
        }
        if (dim > 1 && ELLIPTIC_CONES) {
            if (lane == 0) w.cone_row[cones] = rows, w.cone_dim[cones] = dim;
            cones++;
        }
        rows += size;
    }
    if (lane == 0) w.cones = cones;
    SYNC();
    return rows;
}

}  // namespace fused
