// SPDX-License-Identifier: Apache-2.0
// Newton: the acceleration that minimises MuJoCo's cost, by Newton's method with an exact line search.
//
//     cost(a) = 1/2 (a - a_smooth)' M (a - a_smooth) + sum of s_i(J_i a - reference_i)
//
// It is convex, so that the solution depends neither on the start nor on the way. Source: MuJoCo's documentation, chapter
// "Computation", sections "Reduced primal problem" and "Algorithms".

namespace fused {

// Where an elliptic contact is, and what its rows need: N = mu e_0 and U_i = friction_i e_i.
struct Cone {
    real mu, N, T, scale;  // scale is D_0 / (mu^2 (1 + mu^2))
    int zone;              // 0: no force, 1: all rows quadratic, 2: on the surface of the cone
};
FN bool is_cone(const real* C) { return ELLIPTIC_CONES && C[C_DIM] > 1; }
// The friction coefficient of row i, or of the normal row mu.
FN real friction_of(const real* C, int i) { return i ? C[C_FRICTION + i - 1] : C[C_MU]; }
template <bool FITS>
FN Cone cone_at(const World& w, const real* C, real step) {
    const real* first = row_of<FITS>(w, (int)C[C_ROW]);
    Cone o;
    real tt = 0;
    ROLLED for (int i = 1; i < (int)C[C_DIM]; i++) {
        const real* along = row_of<FITS>(w, (int)C[C_ROW] + i);
        real u = friction_of(C, i) * (along[R_E] + step * along[R_JS]);
        tt += u * u;
    }
    o.mu = C[C_MU], o.N = o.mu * (first[R_E] + step * first[R_JS]), o.T = SQRT(tt);
    o.scale = first[R_D] / (o.mu * o.mu * (1 + o.mu * o.mu));
    if (o.N >= o.mu * o.T) o.zone = 0;
    else o.zone = o.mu * o.N + o.T <= 0 ? 1 : 2;
    return o;
}

// Forces of all rows at the present e, and their weights in the Hessian. Rows of a cone's surface have the weights of
//     scale (P P' + k (I - Q Q')),  P = (1, -mu U/T),  Q = U/T,  k = mu (mu - N/T)
// where I, P and Q are in coordinates scaled by mu and the frictions; P and Q are rows of their own in the contact.
template <bool FITS>
FN void update_rows(World& w, int rows, int contacts, int lane) {
    EACH(i, rows) {
        real* o = row_of<FITS>(w, i);
        real e = o[R_E], D = o[R_D], outside = 0;
        bool active = e < 0 || o[R_KIND] == EQUALITY;
        if (o[R_KIND] == FRICTION_LOSS) active = D * FABS(e) < o[R_LOSS], outside = e < 0 ? o[R_LOSS] : -o[R_LOSS];
        o[R_F] = active ? -D * e : outside, o[R_WEIGHT] = active ? D : 0;
    }
    SYNC();
    if (!ELLIPTIC_CONES) return;
    EACH(c, contacts) {
        real* C = contact_of<FITS>(w, c);
        if (!is_cone(C)) continue;
        Cone cone = cone_at<FITS>(w, C, 0);
        C[C_CONE] = C[C_CONE + 1] = 0;
        ROLLED for (int i = 0; i < (int)C[C_DIM]; i++) {
            real *o = row_of<FITS>(w, (int)C[C_ROW] + i), s = friction_of(C, i);
            if (cone.zone == 0) o[R_F] = 0, o[R_WEIGHT] = 0;
            else if (cone.zone == 1) o[R_F] = -o[R_D] * o[R_E], o[R_WEIGHT] = o[R_D];
            else {
                real push = -cone.scale * (cone.N - cone.mu * cone.T) * cone.mu, k = cone.mu * (cone.mu - cone.N / cone.T);
                o[R_F] = i ? -push / cone.T * s * s * o[R_E] : push;
                o[R_WEIGHT] = i ? cone.scale * k * s * s : 0;
                C[C_CONE] = cone.scale, C[C_CONE + 1] = -cone.scale * k;
            }
        }
    }
    SYNC();
    for (int c = 0; c < contacts; c++) {
        real* C = contact_of<FITS>(w, c);
        if (!is_cone(C) || C[C_CONE] == 0) continue;
        Cone cone = cone_at<FITS>(w, C, 0);
        EACH(k, NV) {
            real q = 0;
            ROLLED for (int i = 1; i < (int)C[C_DIM]; i++) {
                const real *o = row_of<FITS>(w, (int)C[C_ROW] + i), s = friction_of(C, i);
                q += s * s * o[R_E] / cone.T * o[k];
            }
            C[cone_row(0) + k] = cone.mu * row_of<FITS>(w, (int)C[C_ROW])[k] - cone.mu * q;
            C[cone_row(1) + k] = q;
        }
    }
    SYNC();
}

// Solve A w.s = sign b, with b the field `right` and A = M + the sum of weight J' J of the rows.
#if IN_REGISTERS
// A += weight J' J in the row of A that a lane has.
FN void add_product(real* r, const real* J, int own, real weight) {
    const Four* fours = (const Four*)J;
    real D = weight * J[own];
#pragma unroll
    for (int g = 0; g < NFOURS; g++) {
        Four four = fours[g];
#pragma unroll
        for (int k = 0; k < 4; k++)
            if (4 * g + k < NV) r[4 * g + k] += D * four.x[k];
    }
}

// A = L D L'. Lane i has row i of A in registers, of which what is left of the diagonal counts. Columns of L D are kept above
// the diagonal of M, and the lanes read them as fours.
template <bool FITS>
ONE_COPY void solve(World& of, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    World& w = in_place(of);
    const int own = lane < NV ? lane : 0;
    const Four* fours = (const Four*)(w.M + own * LD);
    real r[4 * NFOURS], y = sign * (w.*right)[own], inverse = 0;
#pragma unroll
    for (int g = 0; g < NFOURS; g++) {
        Four four = fours[g];
#pragma unroll
        for (int k = 0; k < 4; k++) r[4 * g + k] = four.x[k];
    }
#pragma unroll 1
    for (int k = 0; k < rows; k++) {
        const real* J = row_of<FITS>(w, k);
        real weight = J[R_WEIGHT];
        if (weight != 0) add_product(r, J, own, weight);
    }
    if (ELLIPTIC_CONES)
        for (int k = 0; k < 2 * contacts; k++) {
            const real* C = contact_of<FITS>(w, k / 2);
            if (is_cone(C) && C[C_CONE + k % 2] != 0) add_product(r, C + cone_row(k % 2), own, C[C_CONE + k % 2]);
        }
#pragma unroll
    for (int j = 0; j < NV; j++) {
        bool below = lane > j && lane < NV;
        if (below) w.M[j * LD + lane] = r[j];
        real scale = __fdividef(1, larger(from_lane(r[j], j), (real)1e-30)), l = below ? r[j] * scale : 0;
        if (lane == j) inverse = scale;
        y -= l * from_lane(y, j);
        SYNC();
#pragma unroll
        for (int g = (j + 1) / 4; g < NFOURS; g++) {
            Four four = ((const Four*)(w.M + j * LD))[g];
#pragma unroll
            for (int k = 0; k < 4; k++)
                if (4 * g + k > j && 4 * g + k < NV) r[4 * g + k] -= l * four.x[k];
        }
    }
    // x = D^-1 y - L' x, with a row of L' in a lane.
    y *= inverse;
#pragma unroll
    for (int g = 0; g < NFOURS; g++) {
        Four four = fours[g];
#pragma unroll
        for (int k = 0; k < 4; k++) r[4 * g + k] = lane < 4 * g + k ? four.x[k] * inverse : 0;
    }
#pragma unroll
    for (int j = NV - 1; j > 0; j--) y -= r[j] * from_lane(y, j);
    if (lane < NV) w.s[lane] = y;
    SYNC();
}
#else
FN void add_weighted(World& w, const real* J, real D, int lane) {
    if (D != 0) EACH(i, NV) {
        real Di = D * J[i];
        if (Di != 0)
            for (int j = 0; j <= i; j++) w.H[i * LD + j] += Di * J[j];
    }
}

// By Cholesky's factorisation.
template <bool FITS>
FN void solve(World& w, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    const real* b = w.*right;
    real* x = w.s;
    for (int i = 0; i < NV; i++) EACH(j, i + 1) w.H[i * LD + j] = w.M[i * LD + j];
    SYNC();
    for (int k = 0; k < rows; k++) add_weighted(w, row_of<FITS>(w, k), row_of<FITS>(w, k)[R_WEIGHT], lane);
    if (ELLIPTIC_CONES)
        for (int c = 0; c < contacts; c++) {
            const real* C = contact_of<FITS>(w, c);
            if (!is_cone(C)) continue;
            for (int k = 0; k < 2; k++) add_weighted(w, C + cone_row(k), C[C_CONE + k], lane);
        }
    SYNC();
    // Column by column: each lane computes its rows of the column from the columns before.
    for (int j = 0; j < NV; j++) {
        real square = w.H[j * LD + j];
        for (int k = 0; k < j; k++) square -= w.H[j * LD + k] * w.H[j * LD + k];
        real inverse = 1 / SQRT(larger(square, (real)1e-30));
        SYNC();
        for (int i = j + lane; i < NV; i += LANES) {
            real s = w.H[i * LD + j];
            for (int k = 0; k < j; k++) s -= w.H[i * LD + k] * w.H[j * LD + k];
            w.H[i * LD + j] = i == j ? 1 / inverse : s * inverse;
        }
        SYNC();
    }
    EACH(i, NV) x[i] = sign * b[i];
    SYNC();
    for (int j = 0; j < NV; j++) {
        real y = x[j] / w.H[j * LD + j];
        SYNC();
        EACH(i, NV) if (i >= j) x[i] = i == j ? y : x[i] - w.H[i * LD + j] * y;
        SYNC();
    }
    for (int j = NV - 1; j >= 0; j--) {
        real y = x[j] / w.H[j * LD + j];
        SYNC();
        EACH(i, NV) if (i <= j) x[i] = i == j ? y : x[i] - w.H[j * LD + i] * y;
        SYNC();
    }
}
#endif

// Value, slope and curvature of the cost along the search direction, less its value at the start.
struct Line {
    real value, slope, curvature;
};
template <bool FITS>
FN Line line_at(const World& w, int rows, int contacts, real step, real q1, real q2, int lane) {
    real c0 = 0, c1 = 0, c2 = 0;
    EACH(i, rows) {
        const real* o = row_of<FITS>(w, i);
        real e = o[R_E], j = o[R_JS], x = e + step * j, D = o[R_D];
        if (ELLIPTIC_CONES && o[R_KIND] == ELLIPTIC) continue;
        if (o[R_KIND] == FRICTION_LOSS) {
            real loss = o[R_LOSS];
            if (D * FABS(x) < loss) c0 += (real)0.5 * D * x * x, c1 += D * x * j, c2 += D * j * j;
            else c0 += loss * FABS(x) - (real)0.5 * loss * loss / D, c1 += x < 0 ? -loss * j : loss * j;
            c0 -= D * FABS(e) < loss ? (real)0.5 * D * e * e : loss * FABS(e) - (real)0.5 * loss * loss / D;
        } else {
            bool always = o[R_KIND] == EQUALITY;
            if (x < 0 || always) c0 += (real)0.5 * D * x * x, c1 += D * x * j, c2 += D * j * j;
            if (e < 0 || always) c0 -= (real)0.5 * D * e * e;
        }
    }
    if (ELLIPTIC_CONES)
        EACH(c, contacts) {
            const real* C = contact_of<FITS>(w, c);
            if (!is_cone(C)) continue;
            int r = (int)C[C_ROW], dim = (int)C[C_DIM];
            for (int at_start = 0; at_start < 2; at_start++) {
                Cone cone = cone_at<FITS>(w, C, at_start ? 0 : step);
                real sign = at_start ? -1 : 1, push = cone.N - cone.mu * cone.T;
                if (cone.zone == 1)
                    ROLLED for (int i = 0; i < dim; i++) {
                        const real* o = row_of<FITS>(w, r + i);
                        real j = o[R_JS], x = o[R_E] + (at_start ? 0 : step) * j, D = o[R_D];
                        c0 += sign * (real)0.5 * D * x * x;
                        if (!at_start) c1 += D * x * j, c2 += D * j * j;
                    }
                if (cone.zone == 2) {
                    c0 += sign * (real)0.5 * cone.scale * push * push;
                    if (at_start) continue;
                    real uv = 0, vv = 0;
                    ROLLED for (int i = 1; i < dim; i++) {
                        const real* o = row_of<FITS>(w, r + i);
                        real s = friction_of(C, i), v = s * o[R_JS];
                        uv += s * (o[R_E] + step * o[R_JS]) * v, vv += v * v;
                    }
                    real T1 = uv / cone.T, T2 = (vv - T1 * T1) / cone.T, p1 = cone.mu * row_of<FITS>(w, r)[R_JS] - cone.mu * T1;
                    c1 += cone.scale * push * p1, c2 += cone.scale * (p1 * p1 - push * cone.mu * T2);
                }
            }
        }
    Line line;
    line.value = SUM(c0) + step * q1 + (real)0.5 * step * step * q2;
    line.slope = SUM(c1) + q1 + step * q2;
    line.curvature = SUM(c2) + q2;
    return line;
}

// Step along the search direction to the least cost: Newton's method on the slope, kept within a bracket.
template <bool FITS>
FN real line_search(const World& w, int rows, int contacts, real q1, real q2, real accuracy, real& gain, int lane) {
    real low = 0, high = -1, step = 1, best = 0;
    gain = 0;
    for (int i = 0; i < LINE_STEPS; i++) {
        Line line = line_at<FITS>(w, rows, contacts, step, q1, q2, lane);
        if (-line.value > gain) gain = -line.value, best = step;
        if (FABS(line.slope) <= accuracy) break;
        if (line.slope < 0) low = step;
        else high = step;
        real next = step - line.slope / line.curvature;
        if (high < 0) next = next > low && line.curvature > 0 ? next : 2 * low;
        else if (!(next > low && next < high)) next = (real)0.5 * (low + high);
        if (next == step) break;
        step = next;
    }
    return best;
}

// M x into `product`.
FN void multiply(const World& w, const real* x, real* product, int lane) {
    EACH(i, NV) {
        real sum = 0;
        for (int k = 0; k < NV; k++) sum += mass_matrix(w, i, k) * x[k];
        product[i] = sum;
    }
}

// Accelerations w.a under the constraints, from those in w.a, and the forces of the rows. Returns the number of iterations.
template <bool FITS>
FN int constrained_acceleration(World& w, int rows, int contacts, int lane) {
    const real scale = (real)1 / (MEAN_INERTIA * NV);
    if (rows == 0) {  // one iteration: what is known of the last step must not even be in the last digit
        EACH(i, NV) w.a[i] = 0;
        SYNC();
    }
    multiply(w, w.a, w.Ma, lane);
    SYNC();
    int iterations = 0;
    for (;; iterations++) {
        update_rows<FITS>(w, rows, contacts, lane);
        real norm = 0;
        EACH(i, NV) {
            real x = w.Ma[i] - w.smooth[i];
            for (int r = 0; r < rows; r++) x -= row_of<FITS>(w, r)[i] * row_of<FITS>(w, r)[R_F];
            w.g[i] = x, norm += x * x;
        }
        norm = SUM(norm);
        SYNC();
        if (iterations >= MAX_ITERATIONS || (iterations && scale * SQRT(norm) < TOLERANCE)) break;
        solve<FITS>(w, rows, contacts, &World::g, -1, lane);
        real q1 = 0, q2 = 0, fall = 0;
        EACH(i, NV) q1 += w.s[i] * (w.Ma[i] - w.smooth[i]), fall -= w.s[i] * w.g[i];
        multiply(w, w.s, w.Ms, lane);  // each lane where it has just read the gradient
        EACH(i, NV) q2 += w.s[i] * w.Ms[i];
        q1 = SUM(q1), q2 = SUM(q2), fall = SUM(fall);
        EACH(r, rows) {
            real* o = row_of<FITS>(w, r);
            o[R_JS] = product(o, w.s);
        }
        SYNC();
        real gain, step = 1;
        if (rows) step = line_search<FITS>(w, rows, contacts, q1, q2, LINE_TOLERANCE * (2 * FABS(q1) + fall), gain, lane);
        else gain = (real)0.5 * fall;
        EACH(i, NV) w.a[i] += step * w.s[i], w.Ma[i] += step * w.Ms[i];
        EACH(r, rows) row_of<FITS>(w, r)[R_E] += step * row_of<FITS>(w, r)[R_JS];
        SYNC();
        if (step == 0 || scale * gain < TOLERANCE) {
            if (step != 0) iterations++, update_rows<FITS>(w, rows, contacts, lane);
            break;
        }
    }
    return iterations;
}

}  // namespace fused
