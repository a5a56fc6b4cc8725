/* The nodes' end of tensor_transform: products of cosines and sines <-> complex values on the whole lattice.
 *
 *   exp(-i Σ_j s_j θ_j) = Π_j (cos θ_j - i s_j sin θ_j),    θ_j = m_j step_j x_j >= 0 in m_j, signs s_j = ±1
 *
 * w[b, p1, p2, p3] holds the sums over the grid of all such products, rows ordered as in tensor_fold.h; H_j = h.s012
 * counts the frequencies of axis j (1 for the axis y that a 2-D grid lacks). With SHIFTED, θ is counted from a centre of
 * the body's own, and `phase` holds exp(-i m_j step_j centre_j) for all m_j of the three axes in turn.
 */
#include "real.h"
#include "tensor_fold.h"

/* LANES reals, or `count` of them and zeros. */
static inline vec get(__global const real *p, const int count)
{
    if (count >= LANES) return LOADV(p);
    real lanes[LANES];
    for (int i = 0; i < LANES; ++i) lanes[i] = i < count ? p[i] : 0;
    return JOIN(vload, LANES)(0, lanes);
}

static inline void put(const vec v, __global real *p, const int count)
{
    if (count >= LANES) {
        STOREV(v, p);
        return;
    }
    real lanes[LANES];
    JOIN(vstore, LANES)(v, 0, lanes);
    for (int i = 0; i < count; ++i) p[i] = lanes[i];
}

/* The same for complex numbers at p, p + step, p + 2 step, ..; step is 1 or -1. */
static inline void get_pairs(__global const real2 *p, const int step, const int count, vec *re, vec *im)
{
    if (count >= LANES) {
        const pairs v = LOAD_PAIRS((__global const real *)(step > 0 ? p : p - LANES + 1));
        *re = step > 0 ? v.even : REVERSE(v.even);
        *im = step > 0 ? v.odd : REVERSE(v.odd);
        return;
    }
    real r[LANES], i[LANES];
    for (int k = 0; k < LANES; ++k) {
        r[k] = k < count ? p[k * step].x : 0;
        i[k] = k < count ? p[k * step].y : 0;
    }
    *re = JOIN(vload, LANES)(0, r);
    *im = JOIN(vload, LANES)(0, i);
}

static inline void put_pairs(const vec re, const vec im, __global real2 *p, const int step, const int count)
{
    if (count >= LANES) {
        pairs v;
        v.even = step > 0 ? re : REVERSE(re);
        v.odd = step > 0 ? im : REVERSE(im);
        STORE_PAIRS(v, (__global real *)(step > 0 ? p : p - LANES + 1));
        return;
    }
    real r[LANES], i[LANES];
    JOIN(vstore, LANES)(re, 0, r);
    JOIN(vstore, LANES)(im, 0, i);
    for (int k = 0; k < count; ++k) p[k * step] = (real2)(r[k], i[k]);
}

/* (re, im) *= (cr, sign * ci) */
static inline void multiply(vec *re, vec *im, const vec cr, const vec ci, const real sign)
{
    const vec r = *re * cr - sign * (*im * ci);
    *im = sign * (*re * ci) + *im * cr;
    *re = r;
}

static inline real2 times(const real2 a, const real2 b)
{
    return (real2)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

static inline real2 conjugate(const real2 a)
{
    return (real2)(a.x, -a.y);
}

/* Row of cos m (odd = 0) or sin m (odd = 1) among the rows of an axis with h frequencies. */
static inline int row_of(const int4 axis, const int h, const int m, const int odd)
{
    return PARTS(axis) == 4 ? (2 * odd + ((m ^ odd) & 1)) * ROWS(axis) + m / 2 : odd * h + m;
}

/* Offset in w of cos m1 or sin m1 times cos m2 or sin m2. */
static inline size_t w_at(const int4 x, const int4 y, const int4 z, const int4 h, const int body, const int row1,
                   const int m2, const int odd2)
{
    return (((size_t)body * TOTAL(x) + row1) * TOTAL(y) + row_of(y, h.s1, m2, odd2)) * TOTAL(z);
}

/* Index of the node (s1 m1, s2 m2, 0) in a body's lattice. */
static inline int lattice_row(const int4 h, const int s1m1, const int s2m2)
{
    return ((h.s0 - 1 + s1m1) * (2 * h.s1 - 1) + h.s1 - 1 + s2m2) * (2 * h.s2 - 1) + h.s2 - 1;
}

static inline int nodes_of(const int4 h)
{
    return (2 * h.s0 - 1) * (2 * h.s1 - 1) * (2 * h.s2 - 1);
}

/* c times the phases of axes 1 and 2 is what a row's nodes share: (re, im) *= c phase12 phase3^sign, or its conjugate. */
#if SHIFTED
#define WEIGH(re, im, node, step, conj) \
    get_pairs(c + (node), step, count, &cr, &ci); \
    multiply(&cr, &ci, (vec)(shared.x), (vec)(shared.y), 1); \
    multiply(&cr, &ci, pr, pi, step); \
    multiply(&re, &im, cr, ci, conj);
#define SHARE(s1, s2) \
    const real2 phase1 = s1 > 0 ? phase[m1] : conjugate(phase[m1]); \
    const real2 phase2 = s2 > 0 ? phase[h.s0 + m2] : conjugate(phase[h.s0 + m2]); \
    const real2 shared = times(phase1, phase2);
#define PHASE_OF_BLOCK vec pr, pi; get_pairs(phase + h.s0 + h.s1 + at, 1, count, &pr, &pi);
#define PHASE_OF_BODY phase += (size_t)body * (h.s0 + h.s1 + h.s2);
#else
#define WEIGH(re, im, node, step, conj) \
    get_pairs(c + (node), step, count, &cr, &ci); \
    multiply(&re, &im, cr, ci, conj);
#define SHARE(s1, s2)
#define PHASE_OF_BLOCK
#define PHASE_OF_BODY
#endif

/* F[±m1, ±m2, ±m3] from the 8 sums (4 in 2-D), times c. One work-item per (m2, m1, body). */
__kernel void combine(const int4 x, const int4 y, const int4 z, const int4 h, __global const real *w,
                      __global const real2 *c, __global const real2 *phase, __global real2 *out)
{
    const int m2 = get_global_id(0), m1 = get_global_id(1), body = get_global_id(2);
    const int cos1 = row_of(x, h.s0, m1, 0), sin1 = row_of(x, h.s0, m1, 1), count = min(LANES, h.s2);
    __global const real *w00 = w + w_at(x, y, z, h, body, cos1, m2, 0);
    __global const real *w10 = w + w_at(x, y, z, h, body, sin1, m2, 0);
#if DIM == 3
    __global const real *w01 = w + w_at(x, y, z, h, body, cos1, m2, 1);
    __global const real *w11 = w + w_at(x, y, z, h, body, sin1, m2, 1);
#endif
    out += (size_t)body * nodes_of(h);
    PHASE_OF_BODY
    for (real s1 = 1; s1 >= (m1 ? -1 : 1); s1 -= 2)
        for (real s2 = 1; s2 >= (m2 ? -1 : 1); s2 -= 2) {
            const int zero = lattice_row(h, s1 * m1, s2 * m2);
            SHARE(s1, s2)
            for (int m3 = 0; m3 < h.s2; m3 += LANES) {
                const int at = max(0, min(m3, h.s2 - LANES));
                /* Re and Im of the sum over axes 1 and 2, with cos θ3 and with sin θ3. */
                vec rc = get(w00 + at, count), rs = get(w00 + h.s2 + at, count);
                vec ic = -s1 * get(w10 + at, count), is = -s1 * get(w10 + h.s2 + at, count), cr, ci;
#if DIM == 3
                rc -= s1 * s2 * get(w11 + at, count);
                rs -= s1 * s2 * get(w11 + h.s2 + at, count);
                ic -= s2 * get(w01 + at, count);
                is -= s2 * get(w01 + h.s2 + at, count);
#endif
                PHASE_OF_BLOCK
                vec re = rc - is, im = ic + rs;
                WEIGH(re, im, zero - at, -1, 1)
                put_pairs(re, im, out + zero - at, -1, count);
                re = rc + is, im = ic - rs;
                WEIGH(re, im, zero + at, 1, 1)
                put_pairs(re, im, out + zero + at, 1, count);
            }
        }
}

/* w: what each product contributes to Re Σ_ξ conj(c_ξ) u_ξ Π_j (cos θ_j + i s_j sin θ_j). `centre` holds
 * each body's u at ξ = 0, and `skip_zero` leaves that node out. One work-item per (m2, m1, body), where m counts up to
 * whole parts: there is no frequency beyond h, and its rows of w become 0. */
__kernel void split(const int4 x, const int4 y, const int4 z, const int4 h, __global const real2 *u,
                    __global const real2 *c, __global const real2 *phase, __global const real2 *centre,
                    const int skip_zero, __global real *w)
{
    const int m2 = get_global_id(0), m1 = get_global_id(1), body = get_global_id(2);
    const int cos1 = row_of(x, h.s0, m1, 0), sin1 = row_of(x, h.s0, m1, 1), count = min(LANES, h.s2);
    const bool exists = m1 < h.s0 && m2 < h.s1;
    __global real *w00 = w + w_at(x, y, z, h, body, cos1, m2, 0);
    __global real *w10 = w + w_at(x, y, z, h, body, sin1, m2, 0);
#if DIM == 3
    __global real *w01 = w + w_at(x, y, z, h, body, cos1, m2, 1);
    __global real *w11 = w + w_at(x, y, z, h, body, sin1, m2, 1);
#endif
    u += (size_t)body * nodes_of(h);
    PHASE_OF_BODY
    for (int m3 = 0; m3 < h.s2; m3 += LANES) {
        const int at = max(0, min(m3, h.s2 - LANES));
        vec c00 = 0, c10 = 0, s00 = 0, s10 = 0;
#if DIM == 3
        vec c01 = 0, c11 = 0, s01 = 0, s11 = 0;
#endif
        for (real s1 = 1; exists && s1 >= (m1 ? -1 : 1); s1 -= 2)
            for (real s2 = 1; s2 >= (m2 ? -1 : 1); s2 -= 2) {
                const int zero = lattice_row(h, s1 * m1, s2 * m2);
                vec ur, ui, dr, di, cr, ci;
                get_pairs(u + zero + at, 1, count, &ur, &ui);
                get_pairs(u + zero - at, -1, count, &dr, &di);
                if (at == 0) dr.s0 = di.s0 = 0; /* ξ3 = 0 is there once */
                if (at + m1 + m2 == 0) {
                    const real2 u0 = skip_zero ? (real2)0 : centre[body];
                    ur.s0 = u0.x;
                    ui.s0 = u0.y;
                }
                SHARE(s1, s2)
                PHASE_OF_BLOCK
                WEIGH(ur, ui, zero + at, 1, -1)
                WEIGH(dr, di, zero - at, -1, -1)
                /* cos θ3 goes with up + down, sin θ3 with i (up - down). */
                const vec cos_re = ur + dr, cos_im = ui + di, sin_re = di - ui, sin_im = ur - dr;
                c00 += cos_re;
                s00 += sin_re;
                c10 -= s1 * cos_im;
                s10 -= s1 * sin_im;
#if DIM == 3
                c01 -= s2 * cos_im;
                s01 -= s2 * sin_im;
                c11 -= s1 * s2 * cos_re;
                s11 -= s1 * s2 * sin_re;
#endif
            }
        put(c00, w00 + at, count);
        put(s00, w00 + h.s2 + at, count);
        put(c10, w10 + at, count);
        put(s10, w10 + h.s2 + at, count);
#if DIM == 3
        put(c01, w01 + at, count);
        put(s01, w01 + h.s2 + at, count);
        put(c11, w11 + at, count);
        put(s11, w11 + h.s2 + at, count);
#endif
    }
}

/* The slot ξ = 0 from the zero row of the first axis: c_0 Σ_x row[x] w[b, x, 0, 0]. One work-item per body. */
__kernel void zero_forward(const int n1, const int plane, __global const real2 *row, const int row_stride,
                           __global const real2 *c, const int nodes, __global const real *w, __global real2 *out)
{
    const int body = get_global_id(0);
    real2 sum = (real2)0;
    for (int x = 0; x < n1; ++x) sum += row[(size_t)body * row_stride + x] * w[((size_t)body * n1 + x) * plane];
    out[(size_t)body * nodes + nodes / 2] = times(c[nodes / 2], sum);
}

/* w[b, x, 0, 0] += Re(conj(c_0 row[x]) centre_b): the zero row's part of the adjoint. One work-item per (x, body). */
__kernel void zero_adjoint(const int n1, const int plane, __global const real2 *row, const int row_stride,
                           __global const real2 *c, const int nodes, __global const real2 *centre, __global real *w)
{
    const int x = get_global_id(0), body = get_global_id(1);
    const real2 weight = conjugate(times(c[nodes / 2], row[(size_t)body * row_stride + x]));
    w[((size_t)body * n1 + x) * plane] += times(weight, centre[body]).x;
}
