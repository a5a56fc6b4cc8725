/* A lattice of wavenumbers <-> scattered nodes: a node sees a few lattice points per axis through a window.
 *
 * width: points seen on the first two axes; WINDOW_Z, in whole vectors, on the last. Nodes are sorted by their first
 * lattice point. A node's record in `nodes`, RECORD reals:
 *     weights on the last axis, zero padded; on the first; on the middle;
 *     factor (re, im); and -1 where the node was mirrored, κ -> -κ, else 1.
 * `place` holds its first lattice point (x, y, z), counted from the lattice's corner, and its place in the output.
 * lattice: [x][y][re, im][z], rows of `row` reals; span: points on the first two axes.
 */
#include "real.h"

#define VECTORS (WINDOW_Z / LANES)
#define RECORD (WINDOW_Z + width.x + width.y + 3)

real total(vec v)
{
#if LANES == 8
    const real4 four = v.lo + v.hi;
#else
    const real4 four = v;
#endif
    const real2 two = four.lo + four.hi;
    return two.x + two.y;
}

/* û at NODES_PER_ITEM nodes of one body. */
__kernel void gather(__global const real *restrict lattice, __global const int4 *restrict place,
                     __global const real *restrict nodes, __global real *restrict out, const int count, const int2 span,
                     const int2 width, const int row)
{
    const size_t body = get_global_id(1);
    const int begin = get_global_id(0) * NODES_PER_ITEM, end = min(begin + NODES_PER_ITEM, count);
    const size_t step_x = (size_t)span.y * 2 * row;
    lattice += body * span.x * step_x;
    out += body * 2 * count;
    for (int node = begin; node < end; ++node) {
        const int4 at = place[node];
        __global const real *record = nodes + (size_t)node * RECORD;
        __global const real *corner = lattice + at.x * step_x + (size_t)at.y * 2 * row + at.z;
        vec re[VECTORS], im[VECTORS];
        for (int v = 0; v < VECTORS; ++v)
            re[v] = im[v] = (vec)(0);
        for (int x = 0; x < width.x; ++x) {
            vec plane_re[VECTORS], plane_im[VECTORS];
            for (int v = 0; v < VECTORS; ++v)
                plane_re[v] = plane_im[v] = (vec)(0);
            __global const real *line = corner + x * step_x;
            for (int y = 0; y < width.y; ++y, line += 2 * row) {
                const real weight = record[WINDOW_Z + width.x + y];
                for (int v = 0; v < VECTORS; ++v) {
                    plane_re[v] = weight * LOADV(line + LANES * v) + plane_re[v];
                    plane_im[v] = weight * LOADV(line + row + LANES * v) + plane_im[v];
                }
            }
            const real weight = record[WINDOW_Z + x];
            for (int v = 0; v < VECTORS; ++v) {
                re[v] = weight * plane_re[v] + re[v];
                im[v] = weight * plane_im[v] + im[v];
            }
        }
        vec sum_re = LOADV(record) * re[0], sum_im = LOADV(record) * im[0];
        for (int v = 1; v < VECTORS; ++v) {
            sum_re = LOADV(record + LANES * v) * re[v] + sum_re;
            sum_im = LOADV(record + LANES * v) * im[v] + sum_im;
        }
        __global const real *factor = record + WINDOW_Z + width.x + width.y;
        const real u_re = total(sum_re), u_im = factor[2] * total(sum_im);
        out[2 * at.w] = factor[0] * u_re - factor[1] * u_im;
        out[2 * at.w + 1] = factor[0] * u_im + factor[1] * u_re;
    }
}

/* The transpose of a node's factor: conj(factor) u, mirrored back, in the nodes' sorted order. */
__kernel void weigh(__global const real *restrict u, __global const int4 *restrict place,
                    __global const real *restrict nodes, __global real *restrict strengths, const int count,
                    const int2 width)
{
    const size_t body = get_global_id(1);
    const int begin = get_global_id(0) * NODES_PER_ITEM, end = min(begin + NODES_PER_ITEM, count);
    for (int node = begin; node < end; ++node) {
        __global const real *factor = nodes + (size_t)node * RECORD + WINDOW_Z + width.x + width.y;
        __global const real *from = u + 2 * (body * count + place[node].w);
        __global real *to = strengths + 2 * (body * count + node);
        to[0] = factor[0] * from[0] + factor[1] * from[1];
        to[1] = factor[2] * (factor[0] * from[1] - factor[1] * from[0]);
    }
}

/* sum[at] += term; where nodes crowd, what rounding takes away is gathered in lost[at] (Knuth's two-sum). */
void add(__global real *sum, __global real *lost, const size_t at, const vec term)
{
    const vec old = LOADV(sum + at), now = old + term;
    STOREV(now, sum + at);
#if COMPENSATED
    const vec added = now - old;
    STOREV(LOADV(lost + at) + ((old - (now - added)) + (term - added)), lost + at);
#endif
}

/* The transpose of the window: each work-item owns ROWS_PER_ITEM neighbouring lattice rows of one x and adds the
 * nodes that see them, in order.
 *
 * The nodes whose first point is (x, y) are start[x · bins.y + y] .. start[.. + 1]; those of neighbouring y follow.
 * lost: scratch like the lattice.
 */
__kernel void spread(__global const real *restrict strengths, __global const int4 *restrict place,
                     __global const real *restrict nodes, __global const int *restrict start,
                     __global real *restrict lattice, __global real *restrict lost, const int count,
                     const int2 span, const int2 width, const int2 bins, const int row)
{
    const int first = get_global_id(0) * ROWS_PER_ITEM, last = min(first + ROWS_PER_ITEM, span.y) - 1;
    const int x = get_global_id(1);
    const size_t body = get_global_id(2);
    strengths += 2 * body * count;
    const size_t begin = ((body * span.x + x) * span.y + first) * 2 * row;
    const size_t end = begin + (size_t)(last - first + 1) * 2 * row;
    for (size_t t = begin; t < end; ++t) {
        lattice[t] = 0;
#if COMPENSATED
        lost[t] = 0;
#endif
    }
    const int from_y = max(first - width.y + 1, 0), to_y = min(last, bins.y - 1);
    for (int bin = max(x - width.x + 1, 0); bin <= min(x, bins.x - 1); ++bin) {
        const int stop = start[bin * bins.y + to_y + 1];
        for (int node = start[bin * bins.y + from_y]; node < stop; ++node) {
            __global const real *record = nodes + (size_t)node * RECORD, *weight = record + WINDOW_Z + width.x;
            const int4 at = place[node];
            const real x_weight = record[WINDOW_Z + x - at.x];
            const real here_re = x_weight * strengths[2 * node], here_im = x_weight * strengths[2 * node + 1];
            vec window_re[VECTORS], window_im[VECTORS];
            for (int v = 0; v < VECTORS; ++v) {
                window_re[v] = here_re * LOADV(record + LANES * v);
                window_im[v] = here_im * LOADV(record + LANES * v);
            }
            for (int y = max(first, at.y); y <= min(last, at.y + width.y - 1); ++y) {
                const real y_weight = weight[y - at.y];
                const size_t re = begin + (size_t)(y - first) * 2 * row + at.z, im = re + row;
                for (int v = 0; v < VECTORS; ++v) {
                    add(lattice, lost, re + LANES * v, y_weight * window_re[v]);
                    add(lattice, lost, im + LANES * v, y_weight * window_im[v]);
                }
            }
        }
    }
#if COMPENSATED
    for (size_t t = begin; t < end; ++t)
        lattice[t] += lost[t];
#endif
}
