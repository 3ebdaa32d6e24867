// SPDX-License-Identifier: Apache-2.0
// Newton: the acceleration that minimises MuJoCo's cost, by Newton's method with an exact line search.
//
//     cost(a) = 1/2 (a - a_smooth)' M (a - a_smooth) + sum of s_i(J_i a - reference_i)
//
// It is convex, so that the solution depends neither on the start nor on the way. Source: MuJoCo's documentation, chapter
// "Computation", sections "Reduced primal problem" and "Algorithms".

namespace fused {

// The slope at the end of a line search beside that at its start.
#define LINE_SLOPE ((real)0.05)

// Forces of all rows at the present e, and their weights in the Hessian.
template <bool FITS>
FN void update_rows(World& w, int rows, int lane) {
    EACH(i, rows) {
        real* o = row_of<FITS>(w, i);
#if ELLIPTIC_CONES
        if (o[R_KIND] == ELLIPTIC) {
            update_cone_row<FITS>(w, o, i);
            continue;
        }
#endif
        real e = o[R_E], D = o[R_D], outside = 0;
        bool active = e < 0 || o[R_KIND] == EQUALITY;
        if (o[R_KIND] == FRICTION_LOSS) active = D * FABS(e) < o[R_LOSS], outside = e < 0 ? o[R_LOSS] : -o[R_LOSS];
        o[R_F] = active ? -D * e : outside, o[R_WEIGHT] = active ? D : 0;
    }
    SYNC();
}

// Solve A w.s = sign b, with b the field `right` and A = M + the sum of weight J' J of the rows.
#if IN_REGISTERS && !WRENCH_ROWS
enum { ROWS_OF_LANE = (NV + LANES - 1) / LANES };  // of the matrix, in the registers of a lane

// A = L D L'. Lane i has row i of A in registers, and row i + LANES where there are so many, of which the part up to the diagonal
// counts. Columns of L are kept above the diagonal of M, and the lanes read them as fours. What a lane has beyond the turn of its
// row is of no use, and is not masked.
template <bool FITS>
ONE_COPY void solve(World& of, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    World& w = in_place(of);
    assemble<FITS>(w, rows, contacts, lane);
    int own[ROWS_OF_LANE], turn[ROWS_OF_LANE];
    real r[ROWS_OF_LANE][4 * NFOURS], diagonal[ROWS_OF_LANE], y[ROWS_OF_LANE];
    UNROLLED for (int q = 0; q < ROWS_OF_LANE; q++) {
        const int i = lane + q * LANES;
        own[q] = i < NV ? i : 0, turn[q] = i < NV ? i : -1;
        diagonal[q] = w.s[own[q]], y[q] = sign * (w.*right)[own[q]];
        UNROLLED for (int j = 0; j < NV; j++) r[q][j] = w.M[j * LD + own[q]];
    }
    UNROLLED for (int j = 0; j < NV; j++) {
        const int at = j / LANES, from = j % LANES;  // which row of which lane has its turn; those before are done
        const real scale = RECIPROCAL(larger(from_lane(diagonal[at], from), (real)1e-30)), yj = from_lane(y[at], from);
        UNROLLED for (int q = at; q < ROWS_OF_LANE; q++) {
            const real l = r[q][j] * scale;
            if (turn[q] > j) w.M[j * LD + turn[q]] = l;
            y[q] -= l * yj, diagonal[q] -= l * r[q][j];
        }
        w.s[j] = scale * yj;  // all lanes write the same
        SYNC();
        UNROLLED for (int g = (j + 1) / 4; g < NFOURS; g++) {
            Four four = ((const Four*)(w.M + j * LD))[g];
            UNROLLED for (int q = at; q < ROWS_OF_LANE; q++)
                UNROLLED for (int k = 0; k < 4; k++)
                    if (4 * g + k > j && 4 * g + k < NV) r[q][4 * g + k] -= r[q][j] * four.x[k];
        }
    }
    // x = D^-1 y - (L' - 1) x, with rows of L' in a lane.
    UNROLLED for (int q = 0; q < ROWS_OF_LANE; q++) {
        y[q] = w.s[own[q]];
        UNROLLED for (int g = 0; g < NFOURS; g++) {
            Four four = ((const Four*)(w.M + own[q] * LD))[g];
            UNROLLED for (int k = 0; k < 4; k++) r[q][4 * g + k] = four.x[k];
        }
    }
    UNROLLED for (int j = NV - 1; j >= 0; j--) {
        const real x = from_lane(y[j / LANES], j % LANES);
        w.s[j] = x;
        UNROLLED for (int q = 0; q <= j / LANES; q++) y[q] -= r[q][j] * x;
    }
    SYNC();
}
#elif !IN_REGISTERS
#if WRENCH_ROWS
// Add the Hessian of the constraints.
template <bool FITS>
FN void add_constraints(World& w, int rows, int contacts, int lane) {
    const int joint_rows = joint_rows_of<FITS>(w, rows, contacts);
    EACH(i, NV)
        for (int r = 0; r < joint_rows; r++)
            if ((int)row_of<FITS>(w, r)[R_DOF] == i) w.H[i * LD + i] += row_of<FITS>(w, r)[R_WEIGHT];
    for (int c = 0; c < contacts;) {
        const Group g = group_of<FITS>(w, c, rows, contacts);
        c = g.next;
        add_up_stiffness<FITS>(w, g, lane);
        EACH(i, NV) {
            if (sign_of(g, i) == 0) continue;
            const Spatial U = stiffness_times(w, sign_of(g, i) * load_spatial(w.S + 6 * i));
            for (int j = 0; j <= i; j++)
                if (sign_of(g, j) != 0) w.H[i * LD + j] += sign_of(g, j) * dot(load_spatial(w.S + 6 * j), U);
        }
    }
}
#else
FN void add_weighted(World& w, const real* J, real D, int lane) {
    if (D != 0) EACH(i, NV) {
        real Di = D * J[i];
        if (Di != 0)
            for (int j = 0; j <= i; j++) w.H[i * LD + j] += Di * J[j];
    }
}

#if ELLIPTIC_CONES
// Add the Hessian of the contacts on the surfaces of their cones.
template <bool FITS>
FN void add_surfaces(World& w, int contacts, int lane) {
    for (int c = 0; c < contacts; c++) {
        const real* C = contact_of<FITS>(w, c);
        if (C[C_CONE] == 0) continue;
        const int first = (int)C[C_ROW], dim = (int)C[C_DIM];
        EACH(i, NV) {
            real q = 0;
            for (int k = 1; k < dim; k++) q += row_of<FITS>(w, first + k)[R_JS] * row_of<FITS>(w, first + k)[i];
            const real p = C[C_CONE] * (row_of<FITS>(w, first)[i] - C[C_MU] * q), turned = C[C_MU] * p + C[C_CONE + 1] * q;
            for (int k = 0; k < dim; k++) {
                const real *o = row_of<FITS>(w, first + k), Di = k ? C[C_CONE + 1] * o[i] - o[R_JS] * turned : p;
                for (int j = 0; j <= i; j++) w.H[i * LD + j] += Di * o[j];
            }
        }
    }
}
#endif
#endif

// By Cholesky's factorisation.
template <bool FITS>
FN void solve(World& w, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    const real* b = w.*right;
    real* x = w.s;
    for (int i = 0; i < NV; i++) EACH(j, i + 1) w.H[i * LD + j] = w.M[i * LD + j];
    SYNC();
#if WRENCH_ROWS
    add_constraints<FITS>(w, rows, contacts, lane);
#else
    for (int k = 0; k < rows; k++) add_weighted(w, row_of<FITS>(w, k), row_of<FITS>(w, k)[R_WEIGHT], lane);
#if ELLIPTIC_CONES
    add_surfaces<FITS>(w, contacts, lane);
#endif
#endif
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

// Slope and curvature of the cost along the search direction.
struct Line {
    real slope, curvature;
};
template <bool FITS>
FN Line line_at(const World& w, int rows, int contacts, real step, real q1, real q2, int lane) {
    real slope = 0, curvature = 0;
    EACH(i, rows) {
        const real* o = row_of<FITS>(w, i);
        real j = o[R_JS], x = o[R_E] + step * j, D = o[R_D];
        if (ELLIPTIC_CONES && o[R_KIND] == ELLIPTIC) continue;
        bool quadratic = x < 0 || o[R_KIND] == EQUALITY;
        if (o[R_KIND] == FRICTION_LOSS) {
            quadratic = D * FABS(x) < o[R_LOSS];
            if (!quadratic) slope += x < 0 ? -o[R_LOSS] * j : o[R_LOSS] * j;
        }
        if (quadratic) slope += D * x * j, curvature += D * j * j;
    }
#if ELLIPTIC_CONES
    add_cones<FITS>(w, contacts, step, slope, curvature, lane);
#endif
    return Line{SUM(slope) + q1 + step * q2, SUM(curvature) + q2};
}

// Step along the search direction from a slope of -`fall` to one of at most `accuracy`: Newton's method, within a bracket,
// else the secant and the middle of the bracket in turn. The cost is convex, so that it is less where its slope is negative
// than at the start.
template <bool FITS>
FN real line_search(const World& w, int rows, int contacts, real q1, real q2, real fall, real accuracy, int lane) {
    real low = 0, high = -1, step = 1, below = -fall, above = 0;
    for (int i = 0; i < LINE_STEPS; i++) {
        Line line = line_at<FITS>(w, rows, contacts, step, q1, q2, lane);
        if (FABS(line.slope) <= accuracy) return step;
        if (line.slope < 0) low = step, below = line.slope;
        else high = step, above = line.slope;
        real next = step - line.slope / line.curvature;
        if (high < 0) next = next > low && line.curvature > 0 ? next : 2 * low;
        else if (!(next > low && next < high)) next = low + (high - low) * (i % 2 ? (real)0.5 : below / (below - above));
        if (next == step) break;
        step = next;
    }
    return low;
}

#if !(WRENCH_ROWS && IN_REGISTERS)
// M x into `product`.
FN void multiply(const World& w, const real* x, real* product, int lane) {
    EACH(i, NV) {
        real sum = 0;
        for (int k = 0; k < NV; k++) sum += mass_matrix(w, i, k) * x[k];
        product[i] = sum;
    }
}
#endif

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
    // The decrease of the cost that a quadratic model had promised, and the square of the gradient there.
    real fall = 0, steepness = 0;
    for (;; iterations++) {
        update_rows<FITS>(w, rows, lane);
        real square = 0;
#if WRENCH_ROWS
        EACH(i, NV) w.g[i] = w.Ma[i] - w.smooth[i];
        subtract_forces<FITS>(w, rows, contacts, lane);
        EACH(i, NV) square += w.g[i] * w.g[i];
#else
        EACH(i, NV) {
            real x = w.Ma[i] - w.smooth[i];
            for (int r = 0; r < rows; r++) x -= row_of<FITS>(w, r)[i] * row_of<FITS>(w, r)[R_F];
            w.g[i] = x, square += x * x;
        }
#endif
        square = SUM(square);
        SYNC();
        if (iterations >= MAX_ITERATIONS || (iterations && scale * SQRT(square) < TOLERANCE)) break;
        // It falls with the square of the gradient: so little that it is not worth a solution.
        if (iterations && scale * fall * square < NOTHING * steepness) break;
        steepness = square;
        solve<FITS>(w, rows, contacts, &World::g, -1, lane);
        real q1 = 0, q2 = 0;
        fall = 0;
        EACH(i, NV) q1 += w.s[i] * (w.Ma[i] - w.smooth[i]), fall -= w.s[i] * w.g[i];
        multiply(w, w.s, w.Ms, lane);  // each lane where it has just read the gradient
        EACH(i, NV) q2 += w.s[i] * w.Ms[i];
        q1 = SUM(q1), q2 = SUM(q2), fall = SUM(fall);
        if (iterations && scale * fall < NOTHING) break;
#if WRENCH_ROWS
        multiply_rows<FITS>(w, w.s, rows, contacts, lane, [](real* o, real x) { o[R_JS] = x; });
#else
        EACH(r, rows) {
            real* o = row_of<FITS>(w, r);
            o[R_JS] = product(o, w.s);
        }
        SYNC();
#endif
        real step = 1;
        if (rows) {
#if ELLIPTIC_CONES
            prepare_line<FITS>(w, contacts, lane);
#endif
            step = line_search<FITS>(w, rows, contacts, q1, q2, fall, LINE_SLOPE * fall + LINE_TOLERANCE * FABS(q1), lane);
        }
        EACH(i, NV) w.a[i] += step * w.s[i], w.Ma[i] += step * w.Ms[i];
        EACH(r, rows) row_of<FITS>(w, r)[R_E] += step * row_of<FITS>(w, r)[R_JS];
        SYNC();
        if (step == 0 || (real)0.5 * scale * step * fall < TOLERANCE) {
            if (step != 0) iterations++, update_rows<FITS>(w, rows, lane);
            break;
        }
    }
    return iterations;
}

}  // namespace fused
