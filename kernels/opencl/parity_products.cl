/* The matrix products between voxels and lattice; layouts and names are those of parity_transform.cl.
 *
 * A body is often 0 over much of its box. Products stop where its voxels stop: `fold` records how far along the last
 * axis each row reaches, `last_nonzero` then how far the rows of a plane, and the planes, do.
 */
#include "real.h"

/* How far each row of `inner` reaches: 1 + the last index that is not 0, or 0. */
__kernel void last_nonzero(__global const int *restrict inner, __global int *restrict outer, const int count)
{
    const size_t row = get_global_id(0);
    int last = 0;
    for (int t = 0; t < count; ++t)
        last = inner[row * count + t] ? t + 1 : last;
    outer[row] = last;
}

/* out[r, c] = Σ_{t < T} a[r, t] b[t, c] for many small matrices: two parities of the contracted axis × rest × plane.
 *
 * Blocks are ROWS rows by two vectors of columns. T is as far as the voxels of its rows reach: beyond, a body is 0.
 * Strides: a (parity, rest, plane, row, t), b (parity, rest, plane, t), out (parity, rest, plane, row),
 * reach (body, plane, row); sizes: rows, columns (whole vectors), rests per body.
 */
#define ROWS 5
#define EACH_ROW(DO) DO(0) DO(1) DO(2) DO(3) DO(4)
#define POINT(r) \
    const int row##r = min(first + r, sizes.x - 1); \
    __global const real *a##r = a + row##r * a_at.s3; \
    reached = max(reached, reach[row##r * reach_at.z]);
#define ZERO(r) vec low##r = (vec)(0), high##r = (vec)(0);
#define MULTIPLY(r) \
    { \
        const real factor = a##r[t * a_at.s4]; \
        low##r = factor * b_low + low##r; \
        high##r = factor * b_high + high##r; \
    }
#define KEEP(r) \
    STOREV(low##r, out + row##r * out_at.w + c); \
    STOREV(high##r, out + row##r * out_at.w + c + LANES);
#define ZERO_ONE(r) vec low##r = (vec)(0);
#define MULTIPLY_ONE(r) low##r = a##r[t * a_at.s4] * b_low + low##r;
#define KEEP_ONE(r) STOREV(low##r, out + row##r * out_at.w + c);

__kernel void contract(__global const real *a, __global const real *b, __global real *out, __global const int *reach,
                       const long8 a_at, const long4 b_at, const long4 out_at, const long4 reach_at, const int4 sizes)
{
    const size_t plane = get_global_id(1), parity = get_global_id(2) & 1, rest = get_global_id(2) >> 1;
    a += parity * a_at.s0 + rest * a_at.s1 + plane * a_at.s2;
    b += parity * b_at.x + rest * b_at.y + plane * b_at.z;
    out += parity * out_at.x + rest * out_at.y + plane * out_at.z;
    reach += (rest / sizes.z) * reach_at.x + plane * reach_at.y;

    /* Rows beyond the last are the last again: they store what is stored there already. */
    for (int first = get_global_id(0) * ROWS; first < sizes.x; first += get_global_size(0) * ROWS) {
        int reached = 0;
        EACH_ROW(POINT)
        int c = 0;
        for (; c + 2 * LANES <= sizes.y; c += 2 * LANES) {
            __global const real *b_row = b + c;
            EACH_ROW(ZERO)
            for (int t = 0; t < reached; ++t, b_row += b_at.w) {
                const vec b_low = LOADV(b_row), b_high = LOADV(b_row + LANES);
                EACH_ROW(MULTIPLY)
            }
            EACH_ROW(KEEP)
        }
        if (c < sizes.y) {
            __global const real *b_row = b + c;
            EACH_ROW(ZERO_ONE)
            for (int t = 0; t < reached; ++t, b_row += b_at.w) {
                const vec b_low = LOADV(b_row);
                EACH_ROW(MULTIPLY_ONE)
            }
            EACH_ROW(KEEP_ONE)
        }
    }
}
