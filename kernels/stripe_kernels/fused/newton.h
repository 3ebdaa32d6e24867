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
FN Cone cone_at(const World& w, int c, const real* e, real step, const real* js) {
    int r = w.cone_row[c];
    const real* s = w.cone + 6 * c;
    Cone o;
    real tt = 0;
    for (int i = 1; i < w.cone_dim[c]; i++) {
        real u = s[i] * (e[r + i] + step * js[r + i]);
        tt += u * u;
    }
    o.mu = s[0], o.N = s[0] * (e[r] + step * js[r]), o.T = SQRT(tt);
    o.scale = w.D[r] / (o.mu * o.mu * (1 + o.mu * o.mu));
    if (o.N >= o.mu * o.T) o.zone = 0;
    else o.zone = o.mu * o.N + o.T <= 0 ? 1 : 2;
    return o;
}

// Forces of all rows at the present `e`, and their weights in the Hessian. Rows of a cone's surface have the weights of
//     scale (P P' + k (I - Q Q')),  P = (1, -mu U/T),  Q = U/T,  k = mu (mu - N/T)
// where I, P and Q are in coordinates scaled by mu and the frictions; P and Q are the two rows behind the others.
FN void update_rows(World& w, int rows, int lane) {
    EACH(i, rows) {
        real e = w.e[i], D = w.D[i];
        bool active = e < 0 || w.kind[i] == EQUALITY;
        w.f[i] = active ? -D * e : 0, w.weight[i] = active ? D : 0;
        if (w.kind[i] == FRICTION_LOSS) {
            active = D * FABS(e) < w.loss[i];
            w.f[i] = active ? -D * e : (e < 0 ? w.loss[i] : -w.loss[i]), w.weight[i] = active ? D : 0;
        }
    }
    if (!ELLIPTIC_CONES) {
        SYNC();
        return;
    }
    SYNC();
    EACH(c, w.cones) {
        Cone o = cone_at(w, c, w.e, 0, w.e);
        int r = w.cone_row[c], dim = w.cone_dim[c];
        const real* s = w.cone + 6 * c;
        w.weight[MAX_ROWS + 2 * c] = w.weight[MAX_ROWS + 2 * c + 1] = 0;
        for (int i = 0; i < dim; i++) {
            if (o.zone == 0) w.f[r + i] = 0, w.weight[r + i] = 0;
            else if (o.zone == 1) w.f[r + i] = -w.D[r + i] * w.e[r + i], w.weight[r + i] = w.D[r + i];
            else {
                real push = -o.scale * (o.N - o.mu * o.T) * o.mu, k = o.mu * (o.mu - o.N / o.T);
                w.f[r + i] = i ? -push / o.T * s[i] * s[i] * w.e[r + i] : push;
                w.weight[r + i] = i ? o.scale * k * s[i] * s[i] : 0;
                w.weight[MAX_ROWS + 2 * c] = o.scale, w.weight[MAX_ROWS + 2 * c + 1] = -o.scale * k;
            }
        }
    }
    SYNC();
    for (int c = 0; c < w.cones; c++) {
        if (w.weight[MAX_ROWS + 2 * c] == 0) continue;
        Cone o = cone_at(w, c, w.e, 0, w.e);
        int r = w.cone_row[c];
        const real* s = w.cone + 6 * c;
        EACH(k, NV) {
            real q = 0;
            for (int i = 1; i < w.cone_dim[c]; i++) q += s[i] * s[i] * w.e[r + i] / o.T * w.J[(r + i) * LD + k];
            w.J[(MAX_ROWS + 2 * c) * LD + k] = o.mu * w.J[r * LD + k] - o.mu * q;
            w.J[(MAX_ROWS + 2 * c + 1) * LD + k] = q;
        }
    }
    SYNC();
}

// Lower triangle of M - h dF/dv in w.H: damping, and of actuators what couples i with itself and with its ancestors.
FN void add_damping(World& w, const Parameters& P, int lane) {
    for (int i = 0; i < NV; i++) EACH(j, i + 1) w.H[i * LD + j] = w.M[i * LD + j];
    SYNC();
    EACH(i, NV) {
        w.H[i * LD + i] += P.timestep[0] * P.damping[i];
        if (IMPLICIT)
            for (int t = coupling_start[i]; t < coupling_start[i + 1]; t++) {
                int u = coupling_actuator[t];
                real gear = P.gear[6 * u];
                w.H[i * LD + coupling_dof[t]] -= P.timestep[0] * coupling_factor[t] * gear * gear * w.slope[u];
            }
    }
    SYNC();
}

// Solve A x = sign b by Cholesky's factorisation, with A = M + the rows' weight_i J_i' J_i, or with `P` A = M - h dF/dv.
#if LANES == 32 && NV <= 32
// Lane i has row i in registers.
FN void solve(World& w, const Parameters* P, int rows, const real* b, real sign, real* x, int lane) {
    const unsigned all = 0xffffffffu;
    const int row = lane < NV ? lane : 0;
    real r[NV], inverse[NV];
    if (P) add_damping(w, *P, lane);
#pragma unroll
    for (int c = 0; c < NV; c++)
        r[c] = P ? w.H[(row > c ? row : c) * LD + (row > c ? c : row)] : w.M[c * LD + row];
    for (int part = 0; part < (ELLIPTIC_CONES ? 2 : 1); part++) {
        int first = part ? MAX_ROWS : 0, last = part ? MAX_ROWS + 2 * w.cones : rows;
        if (part && !rows) break;
        for (int k = first; k < last; k++) {
            real D = w.weight[k];
            if (D == 0) continue;
            D *= w.J[k * LD + row];
#pragma unroll
            for (int c = 0; c < NV; c++) r[c] += D * w.J[k * LD + c];
        }
    }
    real y = sign * b[row];
#pragma unroll
    for (int j = 0; j < NV; j++) {
        real inv = rsqrtf(larger(__shfl_sync(all, r[j], j), (real)1e-30)), l = r[j] * inv;
        inverse[j] = inv, r[j] = l;
        real yj = __shfl_sync(all, y, j) * inv;
        y = lane > j ? y - l * yj : (lane == j ? yj : y);
#pragma unroll
        for (int c = j + 1; c < NV; c++) r[c] -= l * __shfl_sync(all, l, c);
    }
    SYNC();
    if (lane < NV) {
#pragma unroll
        for (int c = 0; c < NV; c++) w.H[lane * LD + c] = r[c];
    }
    SYNC();
#pragma unroll
    for (int j = NV - 1; j >= 0; j--) {
        real xj = __shfl_sync(all, y, j) * inverse[j];
        y = lane < j ? y - w.H[j * LD + row] * xj : (lane == j ? xj : y);
    }
    if (lane < NV) x[lane] = y;
    SYNC();
}
#else
FN void solve(World& w, const Parameters* P, int rows, const real* b, real sign, real* x, int lane) {
    if (P) add_damping(w, *P, lane);
    else {
        for (int i = 0; i < NV; i++) EACH(j, i + 1) w.H[i * LD + j] = w.M[i * LD + j];
        SYNC();
    }
    if (rows)
        for (int part = 0; part < (ELLIPTIC_CONES ? 2 : 1); part++) {
            int first = part ? MAX_ROWS : 0, last = part ? MAX_ROWS + 2 * w.cones : rows;
            for (int r = first; r < last; r++) {
                real D = w.weight[r];
                if (D == 0) continue;
                const real* J = w.J + r * LD;
                for (int i = lane; i < NV; i += LANES) {
                    real Di = D * J[i];
                    if (Di != 0)
                        for (int j = 0; j <= i; j++) w.H[i * LD + j] += Di * J[j];
                }
            }
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
FN Line line_at(const World& w, int rows, real step, real q1, real q2, int lane) {
    real c0 = 0, c1 = 0, c2 = 0;
    EACH(i, rows) {
        real e = w.e[i], j = w.js[i], x = e + step * j, D = w.D[i];
        if (w.kind[i] == ELLIPTIC) continue;
        if (w.kind[i] == FRICTION_LOSS) {
            real loss = w.loss[i];
            if (D * FABS(x) < loss) c0 += (real)0.5 * D * x * x, c1 += D * x * j, c2 += D * j * j;
            else c0 += loss * FABS(x) - (real)0.5 * loss * loss / D, c1 += x < 0 ? -loss * j : loss * j;
            c0 -= D * FABS(e) < loss ? (real)0.5 * D * e * e : loss * FABS(e) - (real)0.5 * loss * loss / D;
        } else {
            bool always = w.kind[i] == EQUALITY;
            if (x < 0 || always) c0 += (real)0.5 * D * x * x, c1 += D * x * j, c2 += D * j * j;
            if (e < 0 || always) c0 -= (real)0.5 * D * e * e;
        }
    }
    if (ELLIPTIC_CONES)
        EACH(c, w.cones) {
            int r = w.cone_row[c], dim = w.cone_dim[c];
            const real* s = w.cone + 6 * c;
            for (int at_start = 0; at_start < 2; at_start++) {
                Cone o = cone_at(w, c, w.e, at_start ? 0 : step, w.js);
                real sign = at_start ? -1 : 1, push = o.N - o.mu * o.T;
                if (o.zone == 1)
                    for (int i = 0; i < dim; i++) {
                        real x = w.e[r + i] + (at_start ? 0 : step) * w.js[r + i], D = w.D[r + i];
                        c0 += sign * (real)0.5 * D * x * x;
                        if (!at_start) c1 += D * x * w.js[r + i], c2 += D * w.js[r + i] * w.js[r + i];
                    }
                if (o.zone == 2) {
                    c0 += sign * (real)0.5 * o.scale * push * push;
                    if (at_start) continue;
                    real uv = 0, vv = 0;
                    for (int i = 1; i < dim; i++) {
                        real v = s[i] * w.js[r + i];
                        uv += s[i] * (w.e[r + i] + step * w.js[r + i]) * v, vv += v * v;
                    }
                    real T1 = uv / o.T, T2 = (vv - T1 * T1) / o.T, p1 = o.mu * w.js[r] - o.mu * T1;
                    c1 += o.scale * push * p1, c2 += o.scale * (p1 * p1 - push * o.mu * T2);
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
FN real line_search(const World& w, int rows, real q1, real q2, real accuracy, real& gain, int lane) {
    real low = 0, high = -1, step = 1, best = 0;
    gain = 0;
    for (int i = 0; i < LINE_STEPS; i++) {
        Line line = line_at(w, rows, step, q1, q2, lane);
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

// Accelerations w.a under the constraints, from those in w.a. Returns the number of iterations.
FN int constrained_acceleration(World& w, int rows, int lane) {
    const real scale = (real)1 / (MEAN_INERTIA * NV);
    EACH(i, NV) {
        real x = 0;
        for (int k = 0; k < NV; k++) x += w.M[i * LD + k] * w.a[k];
        w.Ma[i] = x;
    }
    SYNC();
    int iterations = 0;
    for (;; iterations++) {
        update_rows(w, rows, lane);
        real norm = 0;
        EACH(i, NV) {
            real x = w.Ma[i] - w.smooth[i];
            for (int r = 0; r < rows; r++) x -= w.J[r * LD + i] * w.f[r];
            w.g[i] = x, norm += x * x;
        }
        norm = SUM(norm);
        SYNC();
        if (iterations >= MAX_ITERATIONS || (iterations && scale * SQRT(norm) < TOLERANCE)) break;
        solve(w, 0, rows, w.g, -1, w.s, lane);
        real q1 = 0, q2 = 0, fall = 0;
        EACH(i, NV) {
            real x = 0;
            for (int k = 0; k < NV; k++) x += w.M[i * LD + k] * w.s[k];
            w.Ms[i] = x, q1 += w.s[i] * (w.Ma[i] - w.smooth[i]), q2 += w.s[i] * x, fall -= w.s[i] * w.g[i];
        }
        q1 = SUM(q1), q2 = SUM(q2), fall = SUM(fall);
        EACH(r, rows) {
            real x = 0;
            for (int k = 0; k < NV; k++) x += w.J[r * LD + k] * w.s[k];
            w.js[r] = x;
        }
        SYNC();
        real gain, step = 1;
        if (rows) step = line_search(w, rows, q1, q2, LINE_TOLERANCE * (2 * FABS(q1) + fall), gain, lane);
        else gain = (real)0.5 * fall;
        EACH(i, NV) w.a[i] += step * w.s[i], w.Ma[i] += step * w.Ms[i];
        EACH(r, rows) w.e[r] += step * w.js[r];
        SYNC();
        if (step == 0 || scale * gain < TOLERANCE) {
            if (step != 0) iterations++, update_rows(w, rows, lane);
            break;
        }
    }
    return iterations;
}

}  // namespace fused
