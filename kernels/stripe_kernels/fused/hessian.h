// SPDX-License-Identifier: Apache-2.0
// Hessian: A = M + the sum of weight J' J of the constraint rows, in tiles of a few rows and four columns. Each lane computes
// one tile of the lower triangle, for which it needs few numbers of a row.

#if IN_REGISTERS && !WRENCH_ROWS
namespace fused {

enum {
    BLOCKS = NFOURS * (NFOURS + 1) / 2,  // of four rows and columns
    TILE_ROWS = 2 * BLOCKS <= LANES ? 2 : 4,
    TILES = BLOCKS * 4 / TILE_ROWS,
};
struct alignas(4 * TILE_ROWS) Some {
    real x[TILE_ROWS];
};
struct Tile {
    real x[TILE_ROWS][4];
};

// Add D J to the rows of a tile, with the D of each row, of which `J` is the part for its columns.
FN void add_product(Tile& A, const real* J, Some D) {
    Four four = *(const Four*)J;
    UNROLLED for (int n = 0; n < TILE_ROWS; n++)
        UNROLLED for (int k = 0; k < 4; k++) A.x[n][k] += D.x[n] * four.x[k];
}

#if ELLIPTIC_CONES
// Add the Hessians of contacts on the surfaces of their cones to the tile at the row `a` and the column `c`.
template <bool FITS>
FN void add_surfaces(Tile& A, const World& w, int contacts, int a, int c) {
    ROLLED for (int i = 0; i < contacts; i++) {
        const real* C = contact_of<FITS>(w, i);
        if (C[C_CONE] == 0) continue;
        const int first = (int)C[C_ROW], dim = (int)C[C_DIM];
        const real scale = C[C_CONE], along = C[C_CONE + 1], mu = C[C_MU], *normal = row_of<FITS>(w, first);
        Some q{}, D = *(const Some*)(normal + a);
        UNROLLED for (int k = 1; k < 6; k++) {
            if (k >= dim) break;
            const real* o = row_of<FITS>(w, first + k);
            Some J = *(const Some*)(o + a);
            UNROLLED for (int n = 0; n < TILE_ROWS; n++) q.x[n] += o[R_JS] * J.x[n];
        }
        UNROLLED for (int n = 0; n < TILE_ROWS; n++)
            D.x[n] = scale * (D.x[n] - mu * q.x[n]), q.x[n] = mu * D.x[n] + along * q.x[n];
        add_product(A, normal + c, D);
        UNROLLED for (int k = 1; k < 6; k++) {
            if (k >= dim) break;
            const real* o = row_of<FITS>(w, first + k);
            D = *(const Some*)(o + a);
            UNROLLED for (int n = 0; n < TILE_ROWS; n++) D.x[n] = along * D.x[n] - o[R_JS] * q.x[n];
            add_product(A, o + c, D);
        }
    }
}
#endif

// A, above the diagonal of M, and its diagonal in w.s.
template <bool FITS>
FN void assemble(World& w, int rows, int contacts, int lane) {
    ROLLED for (int done = 0; done < TILES; done += LANES) {
        const int tile = done + lane < TILES ? done + lane : TILES - 1;  // some lanes do the same
        int block = tile * TILE_ROWS / 4, across = 0;
        while (block > across) block -= ++across;
        const int a = 4 * across + tile * TILE_ROWS % 4, c = 4 * block;
        Tile A;
        UNROLLED for (int n = 0; n < TILE_ROWS; n++) {
            Four four = *(const Four*)(w.M + (a + n < NV ? a + n : 0) * LD + c);
            UNROLLED for (int k = 0; k < 4; k++) A.x[n][k] = four.x[k];
        }
        ROLLED for (int first = 0; first < rows; first += LANES) {
            const bool counts = first + lane < rows && row_of<FITS>(w, first + lane)[R_WEIGHT] != 0;
            ROLLED for (unsigned votes = BALLOT(counts); votes; votes &= votes - 1) {
                const real* J = row_of<FITS>(w, first + first_lane(votes));
                Some D = *(const Some*)(J + a);
                UNROLLED for (int n = 0; n < TILE_ROWS; n++) D.x[n] *= J[R_WEIGHT];
                add_product(A, J + c, D);
            }
        }
#if ELLIPTIC_CONES
        add_surfaces<FITS>(A, w, contacts, a, c);
#endif
        UNROLLED for (int n = 0; n < TILE_ROWS; n++)
            UNROLLED for (int k = 0; k < 4; k++) {
                if (a + n >= NV) continue;
                if (c + k < a + n) w.M[(c + k) * LD + a + n] = A.x[n][k];
                if (c + k == a + n) w.s[a + n] = A.x[n][k];
            }
    }
    SYNC();
}

}  // namespace fused
#endif
