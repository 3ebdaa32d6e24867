// SPDX-License-Identifier: Apache-2.0
// Wrench solve: the linear system of a Newton iteration where contacts have no Jacobians (wrench_rows.h), in the registers of
// a world's lanes. Lane i has row ABOVE + i of A = M + J' D J. The first ABOVE rows are more than there are lanes: each has
// only as many numbers up to the diagonal, and the first lanes have one of them, too.

#if WRENCH_ROWS && IN_REGISTERS
namespace fused {

enum {
    ABOVE = NV > LANES ? NV - LANES : 0,
    ABOVE_SIZE = ABOVE ? ABOVE : 1,
    START = (ABOVE + 3) / 4 * 4,             // the first column of those that are eliminated in a loop
    NARROW = (START / 4 + NFOURS + 1) / 2,   // the four from which on half of a row is left
};
FN int lowest(unsigned long long bits) { return __ffsll(bits) - 1; }

// Add the Hessian of the constraints to the rows of a lane: above the diagonal of M to that of the degree of freedom `own`,
// whose turn is `turn`, and to its diagonal, and to `t`, of `above`.
template <bool FITS>
FN void add_constraints(World& w, int rows, int contacts, int own, int turn, int above, real& diagonal, real* t, int lane) {
    const int joint_rows = joint_rows_of<FITS>(w, rows, contacts);
    ROLLED for (int i = 0; i < joint_rows; i++) {
        const real *o = row_of<FITS>(w, i), weight = o[R_WEIGHT];
        if ((int)o[R_DOF] == own) diagonal += weight;
        UNROLLED for (int j = 0; j < ABOVE; j++) if ((int)o[R_DOF] == j && above == j) t[j] += weight;
    }
    UNROLLED for (int j = 0; j < NV; j++) if (turn > j) w.M[j * LD + turn] = 0;
    ROLLED for (int c = 0; c < contacts;) {
        const Group g = group_of<FITS>(w, c, rows, contacts);
        c = g.next;
        add_up_stiffness<FITS>(w, g, lane);
        const Spatial s = sign_of(g, own) * motion_of(w, own), U = stiffness_times(w, s);
        diagonal += dot(s, U);
        ROLLED for (unsigned long long both = g.first | g.second; both; both &= both - 1) {
            const int j = lowest(both);
            const real x = sign_of(g, j) * dot(motion_of(w, j), U);
            if (turn > j) w.M[j * LD + turn] += x;
        }
        if (ABOVE) {
            const Spatial T = stiffness_times(w, sign_of(g, above) * motion_of(w, above));
            UNROLLED for (int j = 0; j < ABOVE; j++) t[j] += sign_of(g, j) * dot(motion_of(w, j), T);
        }
    }
}

// Eliminate fours of columns, of which `r` has the numbers from the first one on, 4 WIDTH of them. A loop, as the instructions
// for all columns would take longer to fetch than to execute.
template <int WIDTH>
FN void eliminate(World& w, int four, int last, real* r, real& diagonal, real& y, real& own_scale, int turn) {
    ROLLED for (; four < last; four++) {
        UNROLLED for (int q = 0; q < 4; q++) {
            const int j = 4 * four + q;
            if (4 * NFOURS > NV && j >= NV) break;
            real* column = w.M + j * LD;
            if (turn > j) column[turn] = r[q];
            const real pivot = from_lane(diagonal, j - ABOVE), yj = from_lane(y, j - ABOVE);
            const real scale = RECIPROCAL(larger(pivot, (real)1e-30)), l = r[q] * scale;
            y -= l * yj, diagonal -= l * r[q];
            if (turn == j) own_scale = scale;
            w.s[j] = scale * yj;  // all lanes write the same
            SYNC();
            UNROLLED for (int g = (q + 1) / 4; g < WIDTH; g++) {  // beyond the end of the row is memory that does no harm
                const Four x = ((const Four*)(column + 4 * four))[g];
                UNROLLED for (int k = 0; k < 4; k++) if (4 * g + k > q) r[4 * g + k] -= l * x.x[k];
            }
        }
        UNROLLED for (int k = 0; k < 4 * WIDTH - 4; k++) r[k] = r[k + 4];
    }
}

// Solve A w.s = sign b, with b the field `right`, by A = L D L'. Columns of L D are kept above the diagonal of M, and the lanes
// read them as fours. They do not wait for 1/D, which takes as long to compute as they take to be there. What a lane has
// beyond the turn of its row is of no use, and is not masked.
template <bool FITS>
ONE_COPY void solve(World& of, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    World& w = in_place(of);
    const bool has_row = ABOVE + lane < NV;
    const int own = has_row ? ABOVE + lane : 0, turn = has_row ? own : -1, above = lane < ABOVE ? lane : 0;
    real r[4 * NFOURS], t[ABOVE_SIZE];
    UNROLLED for (int j = 0; j < ABOVE; j++) t[j] = w.M[above * LD + j];
    real diagonal = w.M[own * LD + own], y = sign * (w.*right)[own], z = sign * (w.*right)[above];
    if (rows) add_constraints<FITS>(w, rows, contacts, own, turn, above, diagonal, t, lane);
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four four = ((const Four*)(w.M + own * LD))[g];
        UNROLLED for (int k = 0; k < 4; k++) r[4 * g + k] = four.x[k];
    }
    if (rows) UNROLLED for (int j = 0; j < NV; j++) if (turn > j) r[j] += w.M[j * LD + own];
    SYNC();  // all have read their rows
    real own_scale = 0, scales[ABOVE_SIZE] = {0};
    UNROLLED for (int j = 0; j < START; j++) {
        const bool is_above = j < ABOVE;
        const int a = is_above ? j : 0;
        if (turn > j) w.M[j * LD + turn] = r[j];
        if (lane > j && lane < ABOVE) w.M[j * LD + lane] = t[a];
        const real pivot = is_above ? from_lane(t[a], j) : from_lane(diagonal, j - ABOVE);
        const real yj = is_above ? from_lane(z, j) : from_lane(y, j - ABOVE);
        const real scale = RECIPROCAL(larger(pivot, (real)1e-30)), l = r[j] * scale, m = t[a] * scale;
        y -= l * yj, diagonal -= l * r[j];
        if (is_above) scales[a] = scale;
        else if (turn == j) own_scale = scale;
        if (is_above && lane > j) z -= m * yj;
        w.s[j] = scale * yj;  // all lanes write the same
        SYNC();
        UNROLLED for (int g = (j + 1) / 4; g < NFOURS; g++) {
            const Four four = ((const Four*)(w.M + j * LD))[g];
            UNROLLED for (int k = 0; k < 4; k++) {
                if (4 * g + k <= j) continue;
                r[4 * g + k] -= l * four.x[k];
                if (4 * g + k < ABOVE) t[4 * g + k < ABOVE ? 4 * g + k : 0] -= m * four.x[k];
            }
        }
    }
    UNROLLED for (int k = 0; k < 4 * NFOURS - START; k++) r[k] = r[k + START];
    eliminate<NFOURS - START / 4>(w, START / 4, NARROW, r, diagonal, y, own_scale, turn);
    eliminate<NFOURS - NARROW>(w, NARROW, NFOURS, r, diagonal, y, own_scale, turn);
    // x = D^-1 y - (L' - 1) x, with rows of L' in a lane.
    y = w.s[own];
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four four = ((const Four*)(w.M + own * LD))[g];
        UNROLLED for (int k = 0; k < 4; k++) r[4 * g + k] = own_scale * four.x[k];
    }
    UNROLLED for (int j = NV - 1; j >= ABOVE; j--) {
        const real x = from_lane(y, j - ABOVE);
        w.s[j] = x;
        y -= r[j] * x;
    }
    SYNC();
    if (ABOVE) {
        real x[ABOVE_SIZE], sums[ABOVE_SIZE] = {0};
        UNROLLED for (int j = 0; j < ABOVE; j++) x[j] = w.s[j], sums[j] = has_row ? w.M[j * LD + own] * w.s[own] : 0;
        sum_each<ABOVE_SIZE>(sums);
        UNROLLED for (int j = ABOVE - 1; j >= 0; j--) {
            UNROLLED for (int k = j + 1; k < ABOVE; k++) sums[j] += w.M[j * LD + k] * x[k];
            x[j] -= scales[j] * sums[j];
        }
        SYNC();
        UNROLLED for (int j = 0; j < ABOVE; j++) w.s[j] = x[j];
        SYNC();
    }
}

// M x into `product`, which may lie where the lanes have just read something else.
FN void multiply(const World& w, const real* x, real* product, int lane) {
    const bool has_row = ABOVE + lane < NV;
    const int own = has_row ? ABOVE + lane : 0;
    real sum = 0, sums[ABOVE_SIZE] = {0};
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four row = ((const Four*)(w.M + own * LD))[g], four = ((const Four*)x)[g];
        UNROLLED for (int k = 0; k < 4; k++) {
            const int j = 4 * g + k;
            if (j < NV) sum += (j <= own ? row.x[k] : w.M[j * LD + own]) * four.x[k];
            if (j < ABOVE) sums[j < ABOVE ? j : 0] = has_row ? row.x[k] * x[own] : 0;
        }
    }
    if (ABOVE) {
        sum_each<ABOVE_SIZE>(sums);
        UNROLLED for (int i = 0; i < ABOVE; i++)
            UNROLLED for (int j = 0; j < ABOVE; j++) sums[i] += mass_matrix(w, i, j) * x[j];
    }
    SYNC();
    UNROLLED for (int i = 0; i < ABOVE; i++) product[i] = sums[i];  // all lanes write the same
    if (has_row) product[own] = sum;
    SYNC();
}

}  // namespace fused
#endif
