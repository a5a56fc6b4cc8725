/* A closed surface -> smooth voxels: quadrature points, spread through a window and summed along the last axis.
 *
 * Axes are (u, v, w), w that of the sum. WU, WV: points of the window on the first two; PU, PV: the same in whole
 * vectors, and PW that on the last. The window's weights are polynomials of degree DEGREE in the place within a cell,
 * x = -1 .. 1; `polynomials` holds their coefficients, per axis from the highest power down, PU, PV or PW reals each.
 * shape: points on u, v, w, and reals in a row, whole vectors.
 *
 * Each work-item owns a grid and a share of the pieces, so nothing is added by two of them and the order is fixed.
 */
#include "real.h"

/* Points whose weights are made before any of them is added: loads of the grid then do not wait for arithmetic. */
#define BLOCK 64
#define VU (PU / LANES)
#define VV (PV / LANES)
#define VW (PW / LANES)

typedef struct {
    int u[BLOCK], v[BLOCK], w[BLOCK];
    real x[BLOCK], y[BLOCK], z[BLOCK], strength[BLOCK];
} Points;

void weigh(vec *weights, __global const real *restrict coefficients, const int vectors, const real x)
{
    for (int k = 0; k < vectors; ++k) {
        vec sum = LOADV(coefficients + k * LANES);
        for (int power = 1; power <= DEGREE; ++power)
            sum = sum * x + LOADV(coefficients + (power * vectors + k) * LANES);
        weights[k] = sum;
    }
}

void add_points(__global real *restrict grid, const Points *points, const int count,
                __global const real *restrict polynomials, const int4 shape)
{
    vec u_weights[BLOCK * VU], v_weights[BLOCK * VV], w_weights[BLOCK * VW];
    __global const real *for_v = polynomials + (DEGREE + 1) * PU, *for_w = for_v + (DEGREE + 1) * PV;
    for (int p = 0; p < count; ++p) {
        weigh(u_weights + p * VU, polynomials, VU, points->x[p]);
        weigh(v_weights + p * VV, for_v, VV, points->y[p]);
        weigh(w_weights + p * VW, for_w, VW, points->z[p]);
        for (int k = 0; k < VU; ++k)
            u_weights[p * VU + k] *= points->strength[p];
    }
    const real *us = (const real *)u_weights, *vs = (const real *)v_weights;
    for (int p = 0; p < count; ++p) {
        __global real *corner = grid + ((size_t)points->u[p] * shape.y + points->v[p]) * shape.w + points->w[p];
        for (int u = 0; u < WU; ++u, corner += (size_t)shape.y * shape.w) {
            const real along = us[p * PU + u];
            __global real *row = corner;
            for (int v = 0; v < WV; ++v, row += shape.w) {
                const real factor = along * vs[p * PV + v];
                for (int k = 0; k < VW; ++k)
                    STOREV(factor * w_weights[p * VW + k] + LOADV(row + k * LANES), row + k * LANES);
            }
        }
    }
}

/* cell, fraction: corners, in cells; pieces: three corners and a rule; rules: begin and end in rule_points, which hold
 * the barycentric coordinates of the second and third corner, and the weight. half_width: of the windows.
 */
__kernel void spread(__global const int4 *restrict cell, __global const real4 *restrict fraction,
                     __global const int4 *restrict pieces, __global const real *restrict strengths,
                     __global const int2 *restrict rules, __global const real4 *restrict rule_points,
                     __global const int *restrict share, __global const real *restrict polynomials,
                     __global real *restrict grids, const int4 shape, const real4 half_width)
{
    const size_t item = get_global_id(0);
    const size_t size = (size_t)shape.x * shape.y * shape.w;
    __global real *grid = grids + item * size;
    for (size_t g = 0; g < size; g += LANES)
        STOREV((vec)(0), grid + g);
    Points points;
    int count = 0;
    for (int t = share[item]; t < share[item + 1]; ++t) {
        const int4 piece = pieces[t], base = cell[piece.x];
        const real4 start = fraction[piece.x] - half_width;
        const int4 to_b = cell[piece.y] - base, to_c = cell[piece.z] - base;
        const real4 b = (real4)(to_b.x, to_b.y, to_b.z, 0) + (fraction[piece.y] - fraction[piece.x]);
        const real4 c = (real4)(to_c.x, to_c.y, to_c.z, 0) + (fraction[piece.z] - fraction[piece.x]);
        const int2 rule = rules[piece.w];
        for (int q = rule.x; q < rule.y; ++q) {
            const real4 at = rule_points[q];
            const real4 place = start + at.x * b + at.y * c, first = ceil(place);
            const real4 x = 2 * (first - place) - 1;
            points.u[count] = base.x + (int)first.x;
            points.v[count] = base.y + (int)first.y;
            points.w[count] = base.z + (int)first.z;
            points.x[count] = x.x;
            points.y[count] = x.y;
            points.z[count] = x.z;
            points.strength[count] = at.z * strengths[t];
            if (++count == BLOCK) {
                add_points(grid, &points, count, polynomials, shape);
                count = 0;
            }
        }
    }
    add_points(grid, &points, count, polynomials, shape);
}

/* All grids together, summed along w; stride: of u, v and w in `out`. */
__kernel void accumulate(__global const real *restrict grids, const int items, __global real *restrict out,
                         const int4 shape, const int4 stride)
{
    const int u = get_global_id(0);
    const size_t size = (size_t)shape.x * shape.y * shape.w;
    for (int v = 0; v < shape.y; ++v) {
        __global const real *row = grids + ((size_t)u * shape.y + v) * shape.w;
        __global real *to = out + (size_t)u * stride.x + (size_t)v * stride.y;
        real sum = 0;
        for (int w = 0; w < shape.z; w += LANES) {
            vec all = LOADV(row + w);
            for (int item = 1; item < items; ++item)
                all += LOADV(row + item * size + w);
            const real *each = (const real *)&all;
            for (int k = 0; k < min(LANES, shape.z - w); ++k) {
                sum += each[k];
                to[(size_t)(w + k) * stride.z] = sum;
            }
        }
    }
}
