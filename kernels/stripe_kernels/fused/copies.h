// SPDX-License-Identifier: Apache-2.0
// Copies: rows of arrays from the memory of the device into the states of a warp's worlds, and back, by code that is there
// once. What a launch begins and ends with runs once, so that fetching instructions would take longer than the copies.

namespace fused {

#if IN_SHARED && defined(__CUDA_ARCH__)
#ifndef COPY_ASYNC  // of a processor that stands for a GPU in tests
#if __CUDA_ARCH__ >= 800
#define COPY_ASYNC(to, from)                                                                                       \
    asm volatile("cp.async.ca.shared.global [%0], [%1], 4;" ::"r"((unsigned)__cvta_generic_to_shared(to)), "l"(from) \
                 : "memory")
#define AWAIT_COPIES() asm volatile("cp.async.wait_all;" ::: "memory")
#else
#define COPY_ASYNC(to, from) *(to) = *(from)
#define AWAIT_COPIES()
#endif
#endif
// `size` numbers from the rows of the worlds, of which the first begins at `from`, to the same place of their states.
COLD void copy_in(float* to, const float* from, long long stride, int size, int worlds) {
    ROLLED for (int i = threadIdx.x % 32; i < size; i += worlds * LANES)
        UNROLLED for (int k = 0; k < WORLDS_OF_WARP; k++)
            if (k == 0 || k < worlds) COPY_ASYNC((float*)((World*)to + k) + i, from + k * stride + i);
}
COLD void copy_out(float* to, const float* from, long long stride, int size, int worlds) {
    ROLLED for (int i = threadIdx.x % 32; i < size; i += worlds * LANES)
        UNROLLED for (int k = 0; k < WORLDS_OF_WARP; k++)
            if (k == 0 || k < worlds) to[k * stride + i] = ((const float*)((const World*)from + k))[i];
}
// Ask for a row of each world; `to` is in the state of the first one, `from` the row of that. `await_rows` waits for all.
FN void ask_row(const Rows& r, real* to, const real* from, long long stride, int size) { copy_in(to, from, stride, size, r.worlds); }
FN void await_rows() {
    AWAIT_COPIES();
    SYNC_WARP();
}
FN void send_row(const Rows& r, real* to, const real* from, long long stride, int size) { copy_out(to, from, stride, size, r.worlds); }
#else
template <class From>
FN void ask_row(const Rows& r, real* to, const From* from, long long, int size) {
    for (int i = r.start; i < size; i += r.step) to[i] = from[i];
}
FN void await_rows() { SYNC_WARP(); }
template <class To>
FN void send_row(const Rows& r, To* to, const real* from, long long, int size) {
    for (int i = r.start; i < size; i += r.step) to[i] = from[i];
}
#endif

// The row of the first of these worlds in an array of MuJoCo's, with its stride, and where it goes to from the state; its row
// in one of Newton's.
#define ROW_OF(name) (real*)P.m.name + (long long)r.id * P.m.name##_stride, P.m.name##_stride
#define ROW_TO(name, field) (real*)P.m.name + (long long)r.id * P.m.name##_stride, r.first->field, P.m.name##_stride
#define NEWTON_ROW_OF(array, size) in_newton(array, r.id, size, 0)

}  // namespace fused
