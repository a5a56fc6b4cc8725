/* C = L · M on row-major matrices, by one work-item: the arithmetic of tensor_transform.
 *
 * L is read a scalar at a time and M a vector at a time, so neither needs packing. A block of C is BLOCK_ROWS rows by
 * two vectors, held in named accumulators over the whole sum; sums run over k upwards, whatever the block, so a value
 * never depends on where blocks fall. The last block of columns is moved left to end with the matrix and computes a
 * few columns again: reads never pass a row's end, which for a caller's array may be the end of memory.
 */
#ifndef SHAPEGEN_TENSOR_GEMM_H
#define SHAPEGEN_TENSOR_GEMM_H

#define BLOCK_ROWS 6

#define FOR_ROWS(h, DO) \
    DO(0) if (h > 1) { DO(1) } if (h > 2) { DO(2) } if (h > 3) { DO(3) } if (h > 4) { DO(4) } if (h > 5) { DO(5) }
#define DECLARE(i) vec a##i = (vec)0, b##i = (vec)0;
#define MULTIPLY_WIDE(i) { const real l = L[i * ldl + k]; a##i += l * m0; b##i += l * m1; }
#define MULTIPLY(i) a##i += L[i * ldl + k] * m0;
#define STORE_WIDE(i) STOREV(a##i, C + i * ldc); STOREV(b##i, C + i * ldc + LANES);
#define STORE_NARROW(i) STOREV(a##i, C + i * ldc);

/* h is a literal at every call, so that inlining leaves exactly h rows. */
static inline void block_wide(const int h, const int depth, __global const real *L, const int ldl,
                       __global const real *M, const int ldm, __global real *C, const int ldc)
{
    DECLARE(0) DECLARE(1) DECLARE(2) DECLARE(3) DECLARE(4) DECLARE(5)
    for (int k = 0; k < depth; ++k) {
        const vec m0 = LOADV(M + (size_t)k * ldm);
        const vec m1 = LOADV(M + (size_t)k * ldm + LANES);
        FOR_ROWS(h, MULTIPLY_WIDE)
    }
    FOR_ROWS(h, STORE_WIDE)
}

static inline void block_narrow(const int h, const int depth, __global const real *L, const int ldl,
                         __global const real *M, const int ldm, __global real *C, const int ldc)
{
    DECLARE(0) DECLARE(1) DECLARE(2) DECLARE(3) DECLARE(4) DECLARE(5)
    for (int k = 0; k < depth; ++k) {
        const vec m0 = LOADV(M + (size_t)k * ldm);
        FOR_ROWS(h, MULTIPLY)
    }
    FOR_ROWS(h, STORE_NARROW)
}

#define FOR_HEIGHT(h, BLOCK, ...) \
    switch (h) { \
        case 1: BLOCK(1, __VA_ARGS__); break; \
        case 2: BLOCK(2, __VA_ARGS__); break; \
        case 3: BLOCK(3, __VA_ARGS__); break; \
        case 4: BLOCK(4, __VA_ARGS__); break; \
        case 5: BLOCK(5, __VA_ARGS__); break; \
        default: BLOCK(6, __VA_ARGS__); \
    }

/* rows × depth times depth × cols; ldl, ldm, ldc are row lengths in memory. */
static inline void gemm(const int rows, const int cols, const int depth, __global const real *L, const int ldl,
                 __global const real *M, const int ldm, __global real *C, const int ldc)
{
    for (int r = 0; r < rows; r += BLOCK_ROWS) {
        const int h = min(BLOCK_ROWS, rows - r);
        __global const real *l = L + (size_t)r * ldl;
        __global real *c = C + (size_t)r * ldc;
        if (cols < LANES) {
            for (int i = 0; i < h; ++i)
                for (int j = 0; j < cols; ++j) {
                    real sum = 0;
                    for (int k = 0; k < depth; ++k) sum += l[i * ldl + k] * M[(size_t)k * ldm + j];
                    c[(size_t)i * ldc + j] = sum;
                }
            continue;
        }
        int j = 0;
        for (; j + 2 * LANES <= cols; j += 2 * LANES) FOR_HEIGHT(h, block_wide, depth, l, ldl, M + j, ldm, c + j, ldc)
        for (; j < cols; j += LANES) {
            const int at = min(j, cols - LANES);
            FOR_HEIGHT(h, block_narrow, depth, l, ldl, M + at, ldm, c + at, ldc)
        }
    }
}

#endif
