/* Voxels <-> a lattice of wavenumbers, by parity.
 *
 * Coordinates are taken from the grid's centre, so each axis splits into an even and an odd half: the even half
 * needs only cos(m θ), the odd one only sin(m θ), for m >= 0. The sum over voxels of v exp(-i m·θ) becomes
 * 2^d independent real chains of half-size matrix products, an eighth of the complex work in 3-D:
 *
 *     fold -> contract last axis -> contract middle axis -> contract first axis -> combine
 *
 * and the adjoint is the transpose of each step in reverse (split, contract, unfold); `contract` is in
 * parity_products.cl. A grid whose first axis has one point (LEADING = 0: every 2-D grid) has no odd half there and
 * skips the first axis.
 *
 * Layouts, per body; p = 0 even, 1 odd; half indices i, j, k count from the centre out; m counts wavenumbers >= 0:
 *     folded  [px][py][pz][i][j][k]        after last   [px][py][i][j][pz][mz]
 *     middle  [px][i][py][my][pz][mz]      first        [px][mx][py][my][pz][mz]
 *     lattice [signed mx][signed my][re, im][signed mz, zero padded]
 */
#include "real.h"

#define PARITIES (LEADING ? 8 : 4)

#if REAL_BITS == 64
#define BITS8(v) as_long8(v)
typedef long8 bits8;
typedef long4 bits4;
typedef long2 bits2;
#else
#define BITS8(v) as_int8(v)
typedef int8 bits8;
typedef int4 bits4;
typedef int2 bits2;
#endif

/* Even and odd sums over the signs of j, then of i, of the row sums `of`, for r = 0 .. 3: (+,+), (+,-), (-,+), (-,-). */
#if LEADING
#define FOLD_ROWS(of, to) \
    { \
        real8 sum[4]; \
        for (int r = 0; r < 4; ++r) \
            sum[r] = of; \
        const real8 even_j = sum[0] + sum[1], odd_j = sum[0] - sum[1]; \
        const real8 even_j_left = sum[2] + sum[3], odd_j_left = sum[2] - sum[3]; \
        STORE8(even_j + even_j_left, to); \
        STORE8(odd_j + odd_j_left, (to) + 2 * part); \
        STORE8(even_j - even_j_left, (to) + 4 * part); \
        STORE8(odd_j - odd_j_left, (to) + 6 * part); \
    }
#else
#define FOLD_ROWS(of, to) \
    { \
        real8 sum[2]; \
        for (int r = 0; r < 2; ++r) \
            sum[r] = of; \
        STORE8(sum[0] + sum[1], to); \
        STORE8(sum[0] - sum[1], (to) + 2 * part); \
    }
#endif

typedef struct {
    __global const real *right, *left; /* voxels k = 0 of both halves of a row; k counts outwards */
    bool present;
} row_halves;

row_halves halves(__global const real *row, const int n, const bool present)
{
    const row_halves both = {row + n / 2, row + (n - 1) / 2, present};
    return both;
}

/* Voxels k .. k+7 to the right and to the left, 0 where there is none. */
void load_halves(const row_halves row, const int k, const int side, real8 *right, real8 *left)
{
    *right = *left = (real8)(0);
    if (!row.present)
        return;
    if (k + 8 <= side) {
        *right = LOAD8(row.right + k);
        *left = LOAD8(row.left - k - 7).s76543210;
    } else {
        real tail_right[8] = {0, 0, 0, 0, 0, 0, 0, 0}, tail_left[8] = {0, 0, 0, 0, 0, 0, 0, 0};
        for (int t = 0; k + t < side; ++t) {
            tail_right[t] = row.right[k + t];
            tail_left[t] = row.left[-k - t];
        }
        *right = vload8(0, tail_right);
        *left = vload8(0, tail_left);
    }
    if (k == 0 && row.right == row.left)
        (*left).s0 = 0;
}

bool any_bit(const bits8 v)
{
    const bits4 four = v.lo | v.hi;
    const bits2 two = four.lo | four.hi;
    return (two.x | two.y) != 0;
}

/* v[±i, ±j, ±k] -> the eight (four) parities, and how far along k each row (i, j) has voxels that are not 0.
 *
 * n: voxels per axis. side: (n + 1) / 2 per axis, and the row length of `folded`. The centre plane of an odd axis
 * is its own mirror: it goes to both parities once, and the odd one meets sin 0 = 0.
 */
__kernel void fold(__global const real *restrict values, __global real *restrict folded, __global int *restrict reach,
                   const int4 n, const int4 side)
{
    const int i = get_global_id(1);
    const size_t body = get_global_id(2);
    const size_t plane = (size_t)n.y * n.z, part = (size_t)side.x * side.y * side.w;
    const int right_i = n.x / 2 + i, left_i = (n.x - 1) / 2 - i;
    values += body * n.x * plane;
    for (int j = get_global_id(0); j < side.y; j += get_global_size(0)) {
        const int right_j = n.y / 2 + j, left_j = (n.y - 1) / 2 - j;
        const bool both_i = right_i != left_i, both_j = right_j != left_j;
        __global const real *right_plane = values + right_i * plane, *left_plane = values + left_i * plane;
        const row_halves rr = halves(right_plane + (size_t)right_j * n.z, n.z, true);
        const row_halves rl = halves(right_plane + (size_t)left_j * n.z, n.z, both_j);
        const row_halves lr = halves(left_plane + (size_t)right_j * n.z, n.z, both_i);
        const row_halves ll = halves(left_plane + (size_t)left_j * n.z, n.z, both_i && both_j);
        __global real *to = folded + body * PARITIES * part + ((size_t)i * side.y + j) * side.w;
        int last = 0;
        for (int k = 0; k < side.z; k += 8, to += 8) {
            real8 right[4], left[4];
            load_halves(rr, k, side.z, &right[0], &left[0]);
            load_halves(rl, k, side.z, &right[1], &left[1]);
            bits8 seen = BITS8(right[0]) | BITS8(left[0]) | BITS8(right[1]) | BITS8(left[1]);
#if LEADING
            load_halves(lr, k, side.z, &right[2], &left[2]);
            load_halves(ll, k, side.z, &right[3], &left[3]);
            seen |= BITS8(right[2]) | BITS8(left[2]) | BITS8(right[3]) | BITS8(left[3]);
#endif
            last = any_bit(seen) ? min(k + 8, side.z) : last;
            FOLD_ROWS(right[r] + left[r], to)
            FOLD_ROWS(right[r] - left[r], to + part)
        }
        reach[(body * side.x + i) * side.y + j] = last;
    }
}

/* The transpose of `fold`: parities -> voxels. */
__kernel void unfold(__global const real *restrict folded, __global real *restrict values, const int4 n,
                     const int4 side)
{
    const int i = get_global_id(1);
    const size_t body = get_global_id(2);
    const size_t plane = (size_t)n.y * n.z, part = (size_t)side.x * side.y * side.w;
    values += body * n.x * plane;
    for (int j = get_global_id(0); j < side.y; j += get_global_size(0)) {
        __global const real *from = folded + body * PARITIES * part + ((size_t)i * side.y + j) * side.w;
        for (int sides = 0; sides < PARITIES / 2; ++sides) {
            const bool left_i = sides >> 1, left_j = sides & 1;
            const int at_i = left_i ? (n.x - 1) / 2 - i : n.x / 2 + i;
            const int at_j = left_j ? (n.y - 1) / 2 - j : n.y / 2 + j;
            const real sign_i = left_i ? -1 : 1, sign_j = left_j ? -1 : 1;
            __global real *row = values + at_i * plane + (size_t)at_j * n.z;
            __global real *right = row + n.z / 2, *left = row + (n.z - 1) / 2;
            for (int k = 0; k < side.z; ++k) {
                real even = from[k] + sign_j * from[k + 2 * part];
                real odd = from[k + part] + sign_j * from[k + 3 * part];
#if LEADING
                even += sign_i * (from[k + 4 * part] + sign_j * from[k + 6 * part]);
                odd += sign_i * (from[k + 5 * part] + sign_j * from[k + 7 * part]);
#endif
                left[-k] = even - odd;
                right[k] = even + odd;
            }
        }
    }
}

/* Parities at |m| -> the complex lattice at signed m: exp(-i m θ) = cos |m|θ - i sgn(m) sin |m|θ on each axis.
 *
 * low, high: signed range per axis, and (low.w) the length of a lattice row. least: the smallest |m| per axis, and
 * (least.w) the padded number of them on the last; count: the number on the first two.
 */
#define EACH_SIDE_OF_ROW(sz, az, ...) \
    { \
        const real sz = -1; \
        for (int mz = low.z; mz <= min(high.z, -1); ++mz) { \
            const int az = -mz - least.z; \
            __VA_ARGS__ \
        } \
    } \
    { \
        const real sz = 1; \
        for (int mz = max(low.z, 0); mz <= high.z; ++mz) { \
            const int az = mz - least.z; \
            __VA_ARGS__ \
        } \
    }

__kernel void combine(__global const real *restrict first, __global real *restrict lattice, const int4 low,
                      const int4 high, const int4 least, const int2 count)
{
    const int x = get_global_id(1), mx = low.x + x;
    const size_t body = get_global_id(2), span_x = get_global_size(1), span_y = high.y - low.y + 1;
    const size_t odd_z = least.w, odd_y = 2 * odd_z * count.y, odd_x = 2 * odd_y * count.x;
    const real sx = mx < 0 ? -1 : 1;
    first += body * (1 + LEADING) * odd_x + (abs(mx) - least.x) * 2 * odd_y;
    for (int y = get_global_id(0); y < span_y; y += get_global_size(0)) {
        const int my = low.y + y;
        const real sy = my < 0 ? -1 : 1;
        __global const real *p = first + (abs(my) - least.y) * 2 * odd_z;
        __global real *re = lattice + ((body * span_x + x) * span_y + y) * 2 * low.w, *im = re + low.w;
        EACH_SIDE_OF_ROW(sz, az, {
            real even = p[az] - sy * sz * p[az + odd_y + odd_z];
            real odd = -sy * p[az + odd_y] - sz * p[az + odd_z];
#if LEADING
            even -= sx * (sy * p[az + odd_x + odd_y] + sz * p[az + odd_x + odd_z]);
            odd -= sx * (p[az + odd_x] - sy * sz * p[az + odd_x + odd_y + odd_z]);
#endif
            re[mz - low.z] = even;
            im[mz - low.z] = odd;
        })
        for (int t = high.z - low.z + 1; t < low.w; ++t)
            re[t] = im[t] = 0;
    }
}

/* The transpose of `combine`: signed m -> parities at |m|. */
__kernel void split(__global const real *restrict lattice, __global real *restrict first, const int4 low,
                    const int4 high, const int4 least, const int2 count)
{
    const int ax = least.x + (int)get_global_id(1);
    const size_t body = get_global_id(2), span_x = high.x - low.x + 1, span_y = high.y - low.y + 1;
    const size_t odd_z = least.w, odd_y = 2 * odd_z * count.y, odd_x = 2 * odd_y * count.x;
    lattice += body * span_x * span_y * 2 * low.w;
    first += body * (1 + LEADING) * odd_x + (ax - least.x) * 2 * odd_y;
    for (int y = get_global_id(0); y < count.y; y += get_global_size(0)) {
        const int ay = least.y + y;
        __global real *p = first + y * 2 * odd_z;
        for (int part = 0; part < PARITIES; ++part)
            for (int t = 0; t < least.w; ++t)
                p[t + (part >> 2) * odd_x + (part >> 1 & 1) * odd_y + (part & 1) * odd_z] = 0;
        for (int signs = 0; signs < 4; ++signs) {
            const int mx = signs & 2 ? -ax : ax, my = signs & 1 ? -ay : ay;
            /* m = 0 is there once, and ranges need not be symmetric. */
            const bool twice = (signs & 2 && ax == 0) || (signs & 1 && ay == 0);
            if (twice || mx < low.x || mx > high.x || my < low.y || my > high.y)
                continue;
            const real sx = signs & 2 ? -1 : 1, sy = signs & 1 ? -1 : 1;
            __global const real *re = lattice + ((mx - low.x) * span_y + (my - low.y)) * 2 * low.w, *im = re + low.w;
            EACH_SIDE_OF_ROW(sz, az, {
                const real even = re[mz - low.z], odd = im[mz - low.z];
                p[az] += even;
                p[az + odd_z] -= sz * odd;
                p[az + odd_y] -= sy * odd;
                p[az + odd_y + odd_z] -= sy * sz * even;
#if LEADING
                p[az + odd_x] -= sx * odd;
                p[az + odd_x + odd_z] -= sx * sz * even;
                p[az + odd_x + odd_y] -= sx * sy * even;
                p[az + odd_x + odd_y + odd_z] += sx * sy * sz * odd;
#endif
            })
        }
    }
}
