/* Precision and vector access, in one place.
 *
 * REAL_BITS (32 or 64) chooses the type of every real in a program. Host arrays are aligned to their element only,
 * so vectors are read and written through types of that alignment. A plain dereference compiles to one unaligned
 * move; vload8 is a real function call on some CPU runtimes (PoCL 3.0 with LLVM 14) and spills all accumulators
 * around it. USE_VLOAD=1 is for devices whose compiler may not honour the attribute: GPUs.
 *
 * `vec` holds LANES reals, 32 bytes unless the host says otherwise: one register of most CPUs. `pairs` holds LANES
 * complex numbers, where there is a vector type for as many.
 *
 * Write a*b + c, never fma() or mad(): both are library calls there, and contraction is on.
 */
#ifndef SHAPEGEN_REAL_H
#define SHAPEGEN_REAL_H

#pragma OPENCL FP_CONTRACT ON

#if REAL_BITS == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef double2 real2;
typedef double4 real4;
typedef double8 real8;
typedef double16 real16;
#define R(literal) literal
#elif REAL_BITS == 32
typedef float real;
typedef float2 real2;
typedef float4 real4;
typedef float8 real8;
typedef float16 real16;
#define R(literal) literal##f
#else
#error "REAL_BITS must be 32 or 64"
#endif

#ifndef USE_VLOAD
#define USE_VLOAD 0
#endif
#ifndef LANES
#define LANES (256 / REAL_BITS)
#endif

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
typedef JOIN(real, LANES) vec;
#if LANES <= 8
#define PAIR_LANES JOIN(TWICE_, LANES)
#define TWICE_2 4
#define TWICE_4 8
#define TWICE_8 16
typedef JOIN(real, PAIR_LANES) pairs;
#endif

/* The lanes of a vec from last to first. */
#if LANES == 4
#define REVERSE(v) ((v).s3210)
#elif LANES == 8
#define REVERSE(v) ((v).s76543210)
#elif LANES == 16
#define REVERSE(v) ((v).sfedcba9876543210)
#endif

#if USE_VLOAD
#define LOAD8(p) vload8(0, (p))
#define STORE8(v, p) vstore8((v), 0, (p))
#define LOADV(p) JOIN(vload, LANES)(0, (p))
#define STOREV(v, p) JOIN(vstore, LANES)((v), 0, (p))
#define LOAD_PAIRS(p) JOIN(vload, PAIR_LANES)(0, (p))
#define STORE_PAIRS(v, p) JOIN(vstore, PAIR_LANES)((v), 0, (p))
#else
typedef real8 real8_unaligned __attribute__((aligned(REAL_BITS / 8)));
typedef vec vec_unaligned __attribute__((aligned(REAL_BITS / 8)));
#define LOAD8(p) (*(const __global real8_unaligned *)(p))
#define STORE8(v, p) (*(__global real8_unaligned *)(p) = (v))
#define LOADV(p) (*(const __global vec_unaligned *)(p))
#define STOREV(v, p) (*(__global vec_unaligned *)(p) = (v))
#if LANES <= 8
typedef pairs pairs_unaligned __attribute__((aligned(REAL_BITS / 8)));
#define LOAD_PAIRS(p) (*(const __global pairs_unaligned *)(p))
#define STORE_PAIRS(v, p) (*(__global pairs_unaligned *)(p) = (v))
#endif
#endif

#endif
