/* Sums and differences of mirrored points, by one work-item: what halves or quarters tensor_transform's products.
 *
 * An axis is an int4 (n points, parts, points per part, rows per part). On points y that mirror about 0, cos(m y) only
 * sees v(y) + v(-y) and sin(m y) only v(y) - v(-y): 2 parts, even then odd, each on the first half of the points. If the
 * axis also spans one period, y -> half a period - y splits either part again by the parity of m: 4 parts (cos with
 * even m, cos odd, sin odd, sin even), each on the first quarter. An axis of 1 part is left as it is. `mask` holds a
 * factor per point.
 */
#ifndef SHAPEGEN_TENSOR_FOLD_H
#define SHAPEGEN_TENSOR_FOLD_H

#define POINTS(axis) ((axis).s0)
#define PARTS(axis) ((axis).s1)
#define HALF(axis) ((axis).s2)
#define ROWS(axis) ((axis).s3)
#define TOTAL(axis) (PARTS(axis) * ROWS(axis))

/* `DO` at j = 0, LANES, 2 LANES, ..; a last vector that would not fit ends with the row instead. Needs cols >= LANES. */
#define FOR_VECTORS(j, cols, DO) \
    { \
        int j = 0; \
        for (; j + LANES <= (cols); j += LANES) { DO } \
        if (j < (cols)) { j = (cols) - LANES; DO } \
    }
/* Rows shorter than a vector go element by element, through the same expressions. */
#define FOR_ELEMENTS(j, cols, DO) for (int j = 0; j < (cols); ++j) { DO }
#define GET(p) (*(p))
#define PUT(v, p) (*(p) = (v))

/* Mirrored rows to the even and odd row, and back. */
#define FOLD_2(T, LOAD, STORE) \
    const T left = ma * LOAD(a + j), right = mb * LOAD(b + j); \
    STORE(left + right, even + j); \
    STORE(left - right, odd + j);
#define UNFOLD_2(T, LOAD, STORE) \
    const T e = LOAD(even + j), o = LOAD(odd + j); \
    STORE(ma * (e + o), a + j); \
    STORE(mb * (e - o), b + j);

/* The four mirror images of a row, a and b about the centre, c and d likewise, c mirrors a within the half period. */
#define FOLD_4(T, LOAD, STORE) \
    const T l = ma * LOAD(a + j), r = mb * LOAD(b + j), il = mc * LOAD(c + j), ir = md * LOAD(d + j); \
    STORE((l + r) + (il + ir), even + j); \
    STORE((l + r) - (il + ir), even + j + step); \
    STORE((l - r) + (il - ir), odd + j); \
    STORE((l - r) - (il - ir), odd + j + step);
#define UNFOLD_4(T, LOAD, STORE) \
    const T e0 = LOAD(even + j), e1 = LOAD(even + j + step), o0 = LOAD(odd + j), o1 = LOAD(odd + j + step); \
    STORE(ma * ((e0 + e1) + (o0 + o1)), a + j); \
    STORE(mb * ((e0 + e1) - (o0 + o1)), b + j); \
    STORE(mc * ((e0 - e1) + (o0 - o1)), c + j); \
    STORE(md * ((e0 - e1) - (o0 - o1)), d + j);

#define OVER_ROW(DO) \
    if (cols >= LANES) FOR_VECTORS(j, cols, DO(vec, LOADV, STOREV)) \
    else FOR_ELEMENTS(j, cols, DO(real, GET, PUT))

/* Rows of `in` (its first `cols` columns, `ldi` apart) -> parts, of rows `ld` apart. Not for 1 part. */
static inline void fold_rows(const int4 axis, const int cols, __global const real *in, const int ldi,
                      __global const real *mask, __global real *out, const int ld)
{
    const int n = POINTS(axis), middle = (n + 1) / 2, step = HALF(axis) * ld;
    for (int g = 0; g < HALF(axis); ++g) {
        const int mirror = n - 1 - g;
        __global const real *a = in + (size_t)g * ldi, *b = in + (size_t)mirror * ldi;
        __global real *even = out + g * ld, *odd = even + middle * ld;
        /* The middle point of an odd axis is its own mirror and counts once. */
        const real ma = mask[g], mb = mirror == g ? 0 : mask[mirror];
        if (PARTS(axis) == 4) {
            __global const real *c = in + (size_t)(middle - 1 - g) * ldi, *d = in + (size_t)(middle + g) * ldi;
            const real mc = mask[middle - 1 - g], md = mask[middle + g];
            OVER_ROW(FOLD_4)
        } else
            OVER_ROW(FOLD_2)
    }
}

/* The transpose: parts -> rows. */
static inline void unfold_rows(const int4 axis, const int cols, __global const real *in, const int ld,
                        __global const real *mask, __global real *out, const int ldo)
{
    const int n = POINTS(axis), middle = (n + 1) / 2, step = HALF(axis) * ld;
    for (int g = 0; g < HALF(axis); ++g) {
        const int mirror = n - 1 - g;
        __global const real *even = in + g * ld, *odd = even + middle * ld;
        /* Where both are the middle point, its odd part is 0 and they agree. */
        __global real *a = out + (size_t)g * ldo, *b = out + (size_t)mirror * ldo;
        const real ma = mask[g], mb = mask[mirror];
        if (PARTS(axis) == 4) {
            __global real *c = out + (size_t)(middle - 1 - g) * ldo, *d = out + (size_t)(middle + g) * ldo;
            const real mc = mask[middle - 1 - g], md = mask[middle + g];
            OVER_ROW(UNFOLD_4)
        } else
            OVER_ROW(UNFOLD_2)
    }
}

/* The same for 2 parts along the columns of each row: in[r, n] -> out[r, 2 * half]. */
static inline void fold_columns(const int4 axis, const int rows, __global const real *in, const int ldi,
                         __global const real *mask, __global real *out)
{
    const int n = POINTS(axis), span = HALF(axis);
    for (int r = 0; r < rows; ++r, in += ldi, out += 2 * span) {
        __global real *odd = out + span;
        if (span >= LANES)
            FOR_VECTORS(j, span, const vec left = LOADV(mask + j) * LOADV(in + j);
                        const vec right = REVERSE(LOADV(mask + n - LANES - j) * LOADV(in + n - LANES - j));
                        STOREV(left + right, out + j); STOREV(left - right, odd + j);)
        else
            FOR_ELEMENTS(j, span, const real left = mask[j] * in[j]; const real right = mask[n - 1 - j] * in[n - 1 - j];
                         out[j] = left + right; odd[j] = left - right;)
        if (n & 1) out[span - 1] = mask[span - 1] * in[span - 1];
    }
}

static inline void unfold_columns(const int4 axis, const int rows, __global const real *in, __global const real *mask,
                           __global real *out, const int ldo)
{
    const int n = POINTS(axis), span = HALF(axis);
    for (int r = 0; r < rows; ++r, in += 2 * span, out += ldo) {
        __global const real *odd = in + span;
        if (span >= LANES)
            FOR_VECTORS(j, span, const vec e = LOADV(in + j); const vec o = LOADV(odd + j);
                        STOREV(LOADV(mask + j) * (e + o), out + j);
                        STOREV(LOADV(mask + n - LANES - j) * REVERSE(e - o), out + n - LANES - j);)
        else
            FOR_ELEMENTS(j, span, const real e = in[j]; const real o = odd[j]; out[j] = mask[j] * (e + o);
                         out[n - 1 - j] = mask[n - 1 - j] * (e - o);)
    }
}

#endif
