/* tensor_transform: a tensor grid contracted with one small real matrix per axis, and back.
 *
 *   forward:  v[b,x,y,z] -> y, z per plane x -> x -> combine -> F[b,ξ]        adjoint: the same road back
 *
 * Axis j has H_j = N_j + 1 frequencies m >= 0 and a row for cos(m θ) and for sin(m θ), in parts as tensor_fold.h says;
 * sin 0 is a row of zeros, and so is what fills up the parts of an odd H_j: they keep the parts alike. A 2-D grid has
 * the axes x and z only: y is then (1, 1, 1, 1). z has at most 2 parts: its frequencies stay in order.
 * P = parts × rows of an axis; matrices are [part][row][point], or their transposes per part.
 *
 * Loops over tasks are shared out among groups of one work-item, each with its own stretch of `scratch`, `slot` reals
 * long. No task's result depends on which group took it, or on another's.
 */
#include "real.h"
#include "tensor_fold.h"
#include "tensor_gemm.h"

/* DIM is 2 or 3. Tables of body b start at b * stride; stride 0 means that all bodies share one. */
#define OF_BODY(table) (table + (size_t)body * table##_stride)
#define TABLE(name) __global const real *name, const int name##_stride

/* in[rows, n3] -> out[rows, P3] and back; `room` takes the folded rows. */
static inline void last_axis_forward(const int4 z, const int rows, __global const real *in, const int ldi,
                              __global const real *matrix, __global const real *mask, __global real *room,
                              __global real *out)
{
    if (PARTS(z) == 2) fold_columns(z, rows, in, ldi, mask, room);
    for (int part = 0; part < PARTS(z); ++part)
        gemm(rows, ROWS(z), HALF(z), PARTS(z) == 2 ? room + part * HALF(z) : in, PARTS(z) == 2 ? 2 * HALF(z) : ldi,
             matrix + (size_t)part * HALF(z) * ROWS(z), ROWS(z), out + part * ROWS(z), TOTAL(z));
}

static inline void last_axis_adjoint(const int4 z, const int rows, __global const real *in, __global const real *matrix,
                              __global const real *mask, __global real *room, __global real *out, const int ldo)
{
    for (int part = 0; part < PARTS(z); ++part)
        gemm(rows, HALF(z), ROWS(z), in + part * ROWS(z), TOTAL(z), matrix + (size_t)part * ROWS(z) * HALF(z), HALF(z),
             PARTS(z) == 2 ? room + part * HALF(z) : out, PARTS(z) == 2 ? 2 * HALF(z) : ldo);
    if (PARTS(z) == 2) unfold_columns(z, rows, room, mask, out, ldo);
}

/* in[n, cols] -> out[P, cols] and back, for an axis that is not the last; `room` takes parts × half rows of `ld`. */
static inline void axis_forward(const int4 axis, const int cols, __global const real *in, const int ldi,
                         __global const real *matrix, __global const real *mask, __global real *room, const int ld,
                         __global real *out, const int ldo)
{
    const bool folds = PARTS(axis) > 1;
    if (folds) fold_rows(axis, cols, in, ldi, mask, room, ld);
    for (int part = 0; part < PARTS(axis); ++part)
        gemm(ROWS(axis), cols, HALF(axis), matrix + (size_t)part * ROWS(axis) * HALF(axis), HALF(axis),
             folds ? room + part * HALF(axis) * ld : in, folds ? ld : ldi, out + (size_t)part * ROWS(axis) * ldo, ldo);
}

static inline void axis_adjoint(const int4 axis, const int cols, __global const real *in, const int ldi,
                         __global const real *matrix, __global const real *mask, __global real *room, const int ld,
                         __global real *out, const int ldo)
{
    const bool folds = PARTS(axis) > 1;
    for (int part = 0; part < PARTS(axis); ++part)
        gemm(HALF(axis), cols, ROWS(axis), matrix + (size_t)part * HALF(axis) * ROWS(axis), ROWS(axis),
             in + (size_t)part * ROWS(axis) * ldi, ldi, folds ? room + part * HALF(axis) * ld : out, folds ? ld : ldo);
    if (folds) unfold_rows(axis, cols, room, ld, mask, out, ldo);
}

/* w[b, x, p2, p3] = Σ_yz R2[p2, y] R3[z, p3] v[b, x, y, z]; in 2-D a task is a band of rows x instead of a plane. */
__kernel void planes_forward(const int tasks, const int4 x, const int4 y, const int4 z, const int band, TABLE(r2),
                             TABLE(mask2), TABLE(r3), TABLE(mask3), __global real *scratch, const int slot,
                             __global const real *values, __global real *w)
{
    __global real *room = scratch + (size_t)get_global_id(0) * slot;
#if DIM == 3
    const int ldz = (POINTS(z) + LANES - 1) / LANES * LANES;
    __global real *t = room, *rest = room + TOTAL(y) * ldz;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / POINTS(x);
        axis_forward(y, POINTS(z), values + (size_t)task * POINTS(y) * POINTS(z), POINTS(z), OF_BODY(r2),
                     OF_BODY(mask2), rest, ldz, t, ldz);
        last_axis_forward(z, TOTAL(y), t, ldz, OF_BODY(r3), OF_BODY(mask3), rest,
                          w + (size_t)task * TOTAL(y) * TOTAL(z));
    }
#else
    const int bands = (POINTS(x) + band - 1) / band;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / bands, first = task % bands * band;
        const size_t row = (size_t)body * POINTS(x) + first;
        last_axis_forward(z, min(band, POINTS(x) - first), values + row * POINTS(z), POINTS(z), OF_BODY(r3),
                          OF_BODY(mask3), room, w + row * TOTAL(z));
    }
#endif
}

/* v[b, x, y, z] = Σ_p2,p3 R2[y, p2] R3[p3, z] w[b, x, p2, p3]. */
__kernel void planes_adjoint(const int tasks, const int4 x, const int4 y, const int4 z, const int band, TABLE(r2),
                             TABLE(mask2), TABLE(r3), TABLE(mask3), __global real *scratch, const int slot,
                             __global const real *w, __global real *values)
{
    __global real *room = scratch + (size_t)get_global_id(0) * slot;
#if DIM == 3
    const int ldz = (POINTS(z) + LANES - 1) / LANES * LANES;
    __global real *t = room, *rest = room + TOTAL(y) * ldz;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / POINTS(x);
        last_axis_adjoint(z, TOTAL(y), w + (size_t)task * TOTAL(y) * TOTAL(z), OF_BODY(r3), OF_BODY(mask3), rest, t, ldz);
        axis_adjoint(y, POINTS(z), t, ldz, OF_BODY(r2), OF_BODY(mask2), rest, ldz,
                     values + (size_t)task * POINTS(y) * POINTS(z), POINTS(z));
    }
#else
    const int bands = (POINTS(x) + band - 1) / band;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / bands, first = task % bands * band;
        const size_t row = (size_t)body * POINTS(x) + first;
        last_axis_adjoint(z, min(band, POINTS(x) - first), w + row * TOTAL(z), OF_BODY(r3), OF_BODY(mask3), room,
                          values + row * POINTS(z), POINTS(z));
    }
#endif
}

/* w[b, p1, c] = Σ_x R1[p1, x] w[b, x, c] and back; a task is a band of columns c of one body. */
__kernel void first_forward(const int tasks, const int4 x, const int cols, const int band, TABLE(r1), TABLE(mask1),
                            __global real *scratch, const int slot, __global const real *in, __global real *out)
{
    const int bands = (cols + band - 1) / band;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / bands, c = task % bands * band;
        axis_forward(x, min(band, cols - c), in + (size_t)body * POINTS(x) * cols + c, cols, OF_BODY(r1),
                     OF_BODY(mask1), scratch + (size_t)get_global_id(0) * slot, band,
                     out + (size_t)body * TOTAL(x) * cols + c, cols);
    }
}

__kernel void first_adjoint(const int tasks, const int4 x, const int cols, const int band, TABLE(r1), TABLE(mask1),
                            __global real *scratch, const int slot, __global const real *in, __global real *out)
{
    const int bands = (cols + band - 1) / band;
    for (int task = get_global_id(0); task < tasks; task += get_global_size(0)) {
        const int body = task / bands, c = task % bands * band;
        axis_adjoint(x, min(band, cols - c), in + (size_t)body * TOTAL(x) * cols + c, cols, OF_BODY(r1),
                     OF_BODY(mask1), scratch + (size_t)get_global_id(0) * slot, band,
                     out + (size_t)body * POINTS(x) * cols + c, cols);
    }
}
