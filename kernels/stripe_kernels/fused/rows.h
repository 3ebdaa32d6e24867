// SPDX-License-Identifier: Apache-2.0
// Rows: arrays in the memory of the device that have a row for each world. The lanes of a warp read and write the rows of its
// worlds together, so that each access is to numbers that lie side by side: the few lanes of a world would take a part of
// 32 bytes each, of which a GPU always moves all.

namespace fused {

// The worlds whose rows these lanes handle together: `first` and those behind it, of which the first has the number `id`. Each
// lane begins at the number `start` of all rows and goes on by `step`.
struct Rows {
    World* first;
    int id, worlds, start, step;
};
FN Rows rows_of(World& w, const Parameters& P, int lane) {
#if IN_SHARED && defined(__CUDA_ARCH__) && LANES < 32
    const int own = threadIdx.x % 32 / LANES, id = P.id - own, left = P.num_worlds - id;
    const int worlds = left < 32 / LANES ? left : 32 / LANES;  // lanes without a world have left
    return Rows{&w - own, id, worlds, (int)threadIdx.x % 32, worlds * LANES};
#else
    return Rows{&w, P.id, 1, lane, LANES};
#endif
}

#ifdef __CUDA_ARCH__
enum { IN_FLIGHT = 8, FEW_IN_FLIGHT = 3 };  // loads of a lane that wait for the memory together
#else
enum { IN_FLIGHT = 1, FEW_IN_FLIGHT = 1 };
#endif

// put(world, id, i, get(world, id, i)) for the numbers i < N of the row of each world, which has the number `id`.
template <int N, int AT_ONCE = IN_FLIGHT, class Get, class Put>
FN void read_rows(const Rows& r, Get get, Put put) {
    ROLLED for (int at = r.start; at < r.worlds * N; at += AT_ONCE * r.step) {
        real x[AT_ONCE];
        UNROLLED for (int k = 0; k < AT_ONCE; k++) {
            const int i = at + k * r.step;
            x[k] = i < r.worlds * N ? get(r.first[i / N], r.id + i / N, i % N) : 0;
        }
        UNROLLED for (int k = 0; k < AT_ONCE; k++) {
            const int i = at + k * r.step;
            if (i < r.worlds * N) put(r.first[i / N], r.id + i / N, i % N, x[k]);
        }
    }
}
// put(world, id, i) for the same.
template <int N, class Put>
FN void write_rows(const Rows& r, Put put) {
    ROLLED for (int i = r.start; i < r.worlds * N; i += r.step) put(r.first[i / N], r.id + i / N, i % N);
}
// Number of a row of an array with a stride.
#define IN_ROW(name, id, i) (((real*)P.m.name)[(long long)(id) * P.m.name##_stride + (i)])

}  // namespace fused
