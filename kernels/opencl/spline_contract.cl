/* out[target[row], :] = Σ_t weight[row, t] source[column[t], :], rows that share their columns taken together.
 *
 * A block is up to ROWS such rows; its weights lie as [t][ROWS]. A group is a run of blocks with the same columns.
 * One work item takes a group through a strip of the K columns of `source`: the first block brings that part of each
 * source row into the cache, the others find it there. Within a block WIDTH columns of all rows stay in registers while
 * t runs, so each number of `source` is loaded once per block.
 *
 * Every row is summed over t in the order given, by the same a*b + c, however many rows its block has and wherever
 * its strip begins: strips are multiples of WIDTH columns, so a column meets either always the vector or always
 * the scalar loop. A row's bits do not depend on its company.
 */
#include "real.h"

#define ROWS 6
#define WIDTH (2 * LANES)

/* X applied to the first N rows of a block: accumulators are named, because arrays of them end up in memory. */
#define EACH_1(X) X(0)
#define EACH_2(X) EACH_1(X) X(1)
#define EACH_3(X) EACH_2(X) X(2)
#define EACH_4(X) EACH_3(X) X(3)
#define EACH_5(X) EACH_4(X) X(4)
#define EACH_6(X) EACH_5(X) X(5)

#define ZERO_VECTOR(r) vec low##r = (vec)(R(0.0)), high##r = (vec)(R(0.0));
#define ADD_VECTOR(r)                 \
    {                                 \
        const real w = weight[r];     \
        low##r = w * low + low##r;    \
        high##r = w * high + high##r; \
    }
#define PUT_VECTOR(r)                                              \
    {                                                              \
        __global real *row = out + target[r] * (size_t)stride + k; \
        STOREV(low##r, row);                                       \
        STOREV(high##r, row + LANES);                              \
    }
#define ZERO_SCALAR(r) real sum##r = R(0.0);
#define ADD_SCALAR(r) sum##r = weight[r] * value + sum##r;
#define PUT_SCALAR(r) out[target[r] * (size_t)stride + k] = sum##r;

#define DEFINE_BLOCK(N)                                                                                \
    static inline void block_##N(__global const int *column, int terms, __global const real *weights,  \
                          __global const int *target, __global const real *source, __global real *out, \
                          int stride, int begin, int end)                                              \
    {                                                                                                  \
        int k = begin;                                                                                 \
        for (; k + WIDTH <= end; k += WIDTH) {                                                         \
            __global const real *weight = weights;                                                     \
            EACH_##N(ZERO_VECTOR)                                                                      \
            for (int t = 0; t < terms; ++t, weight += ROWS) {                                          \
                __global const real *at = source + column[t] * (size_t)stride + k;                     \
                const vec low = LOADV(at), high = LOADV(at + LANES);                                   \
                EACH_##N(ADD_VECTOR)                                                                   \
            }                                                                                          \
            EACH_##N(PUT_VECTOR)                                                                       \
        }                                                                                              \
        for (; k < end; ++k) {                                                                         \
            __global const real *weight = weights;                                                     \
            EACH_##N(ZERO_SCALAR)                                                                      \
            for (int t = 0; t < terms; ++t, weight += ROWS) {                                          \
                const real value = source[column[t] * (size_t)stride + k];                             \
                EACH_##N(ADD_SCALAR)                                                                   \
            }                                                                                          \
            EACH_##N(PUT_SCALAR)                                                                       \
        }                                                                                              \
    }

DEFINE_BLOCK(1)
DEFINE_BLOCK(2)
DEFINE_BLOCK(3)
DEFINE_BLOCK(4)
DEFINE_BLOCK(5)
DEFINE_BLOCK(6)

#define BLOCK_CASE(N)                                                               \
    case N:                                                                         \
        block_##N(column, terms, weights, target, source, out, stride, begin, end); \
        break;

/* block: first column index, number of terms, first weight, first row, number of rows.
 * group: first block of each group, and one past the last. Global size: groups × strips.
 */
__kernel void spline_contract(__global const ulong *blocks, __global const int *groups, __global const int *columns,
                              __global const real *packed, __global const int *targets, __global const real *source,
                              __global real *out, const int stride, const int strip)
{
    const size_t group = get_global_id(0);
    const int begin = get_global_id(1) * strip, end = min(begin + strip, stride);
    for (int b = groups[group]; b < groups[group + 1]; ++b) {
        __global const ulong *block = blocks + 5 * (size_t)b;
        __global const int *column = columns + block[0], *target = targets + block[3];
        __global const real *weights = packed + block[2];
        const int terms = block[1];
        switch ((int)block[4]) {
            BLOCK_CASE(1)
            BLOCK_CASE(2)
            BLOCK_CASE(3)
            BLOCK_CASE(4)
            BLOCK_CASE(5)
            BLOCK_CASE(6)
        }
    }
}
