/* coadjoint.h: the exact motion of a free rigid body, without drift at any step. C99 or C++11; needs sqrt only.

MIT License

Copyright (c) 2026 The coadjoint developers

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions: The above copyright notice and
this permission notice shall be included in all copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.

Conventions. x[3] is the angular momentum along the principal axes of the body and m[3] the inverse principal moments of
inertia, of any order and sign; 0 forbids rotation about the axis, as for a rod. w[i] = m[i] x[i] is the angular
velocity, and x' = x cross w. The attitude takes body to space coordinates: a unit quaternion q = (w, x, y, z), or a
matrix A[9] in rows with A' = A hat(w). The time h has either sign. Results replace x and the attitude. Units are those
of the caller, such as kg m^2/s, 1/(kg m^2) and s; angles are in radians. The names of float versions end in f.

    coadjoint_body_step(m, h, x, q)             momentum and quaternion, which is normalized
    coadjoint_body_step_matrix(m, h, x, A)      momentum and matrix, whose columns are made orthonormal to rounding; NaN
                                                if they are far from that: an entry of A^T A - 1 is 0.3 or more
    coadjoint_body_step_velocity(I, h, w, q)    the same from moments I and angular velocity; I[i] = 0 sets w[i] = 0
    coadjoint_body_rotation(m, h, x, r)         momentum, and the rotation in the step: A(h) = A(0) R(r)
    coadjoint_body_jacobian(m, h, x, r, J, G)   also the derivatives by x(0): J[9] of x(h), and G[9] of the rotation, a
                                                vector in body axes at the end: R(x + dx) = R(x) exp(hat(G dx)) + ...

Each returns the number of pieces of time that were computed: the largest |m[j] - m[k]| |x| |h| / 0.1875 (float: 0.5),
rounded up. Where this is more than 64, it is for whole periods of the momentum, of which one is computed, and the rest:
some hundred, and near the separatrix at most 1500. With u = 2^-53 (float: 2^-24), rounding in a piece is at most 3 u
|x| in x and 10 u (1 + angle) in the matrix R. Beyond 2^30 radians (float: 2^20) of the rotation about the momentum, or
of the motion of the momentum, and for numbers that are not finite, it returns 0, and all results are NaN. So are J and
G, alone, after whole periods beside the separatrix, where they are not resolved. Nothing is allocated or shared between
calls, the stack needs less than 4 kilobytes, and every loop is bounded: the time of a step is proportional to the
number of pieces.

Method: the addition theorem of Weierstrass's elliptic functions, and Lobatto's rule for the angle about the momentum.
Sines and cosines are computed here: without fused products (-ffp-contract=off) all compilers give the same bits. Do not
compile with -ffast-math. Names that do not begin with coadjoint_body_ are internal. */
#ifndef COADJOINT_H
#define COADJOINT_H
#include <math.h>
#define COADJOINT_BITS 64
#include "coadjoint.h"
#define COADJOINT_BITS 32
#include "coadjoint.h"

#elif defined(COADJOINT_BITS) /* from here on: included above, for double and for float */
#if COADJOINT_BITS == 64
#define coadjoint_real double
#define coadjoint_(name) coadjoint_##name
#define coadjoint_n(digits) digits
#define coadjoint_sqrt sqrt
#define COADJOINT_UNIT 18446744073709551616.0 /* of scaling: 2^64 */
#define COADJOINT_TURN 1073741824.0           /* the largest angle */
#define COADJOINT_MOST 1e100                  /* the largest |m_i| |x| |h|, whose squares are in range */
#define COADJOINT_PIECE 0.1875                /* the longest piece, over the largest |m_j - m_k| |x| */
#define COADJOINT_GAP 8.6736173798840355e-19  /* the least difference of the two largest roots that is resolved */
#define COADJOINT_NEAR 7.450580596923828e-9   /* the error of a matrix whose square is rounding: 2^-27 */
#define COADJOINT_POINTS 4                    /* of Lobatto's rule, besides the start of the piece */
#define COADJOINT_NODES 0.17267316464601143, 0.5, 0.82732683535398857, 1.0
#define COADJOINT_WEIGHTS 0.27222222222222222, 0.35555555555555556, 0.27222222222222222, 0.05
#define COADJOINT_HALF_PI 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
#else
#define coadjoint_real float
#define coadjoint_(name) coadjoint_##name##f
#define coadjoint_n(digits) digits##f
#define coadjoint_sqrt sqrtf
#define COADJOINT_UNIT 65536.0f
#define COADJOINT_TURN 1048576.0f
#define COADJOINT_MOST 1e15f
#define COADJOINT_PIECE 0.5f
#define COADJOINT_GAP 9.3132257e-10f
#define COADJOINT_NEAR 1.220703125e-4f
#define COADJOINT_POINTS 3
#define COADJOINT_NODES 0.276393202250021030f, 0.723606797749978970f, 1.0f
#define COADJOINT_WEIGHTS 0.416666666666666667f, 0.416666666666666667f, 0.0833333333333333333f
#define COADJOINT_HALF_PI 1.5703125f, 4.837512969970703125e-4f, 7.549789954891882e-8f
#endif

static inline coadjoint_real coadjoint_(dot)(const coadjoint_real u[3], const coadjoint_real v[3]) {
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
}

static inline void coadjoint_(cross)(const coadjoint_real u[3], const coadjoint_real v[3], coadjoint_real w[3]) {
    w[0] = u[1] * v[2] - u[2] * v[1];
    w[1] = u[2] * v[0] - u[0] * v[2];
    w[2] = u[0] * v[1] - u[1] * v[0];
}

/* R(r) - 1. */
static inline void coadjoint_(turn)(const coadjoint_real r[4], coadjoint_real E[9]) {
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const coadjoint_real *v = r + 1;
        E[4 * i] = -2 * (v[j] * v[j] + v[k] * v[k]);
        E[3 * i + j] = 2 * (v[i] * v[j] - r[0] * v[k]);
        E[3 * j + i] = 2 * (v[i] * v[j] + r[0] * v[k]);
    }
}

/* A B, or the transpose of A times B. */
static inline void coadjoint_(product)(const coadjoint_real A[9], int transposed, const coadjoint_real B[9],
                                       coadjoint_real C[9]) {
    const int down = transposed ? 1 : 3, right = transposed ? 3 : 1;
    for (int i = 0; i < 3; ++i)
        for (int l = 0; l < 3; ++l)
            C[3 * i + l] = A[down * i] * B[l] + A[down * i + right] * B[3 + l] + A[down * i + 2 * right] * B[6 + l];
}

/* a times the k-th power of the unit of scaling. */
static inline coadjoint_real coadjoint_(power)(coadjoint_real a, long k) {
    for (; k > 0 && a != 0; --k) a *= COADJOINT_UNIT;
    for (; k < 0 && a != 0; ++k) a /= COADJOINT_UNIT;
    return a;
}

/* Divide v by a power of the unit of scaling, whose exponent is returned: the largest number is from 1 to the unit. */
static inline long coadjoint_(scale)(coadjoint_real *v, int n) {
    coadjoint_real size = 0;
    long k = 0;
    for (int i = 0; i < n; ++i) size = v[i] > size ? v[i] : -v[i] > size ? -v[i] : size;
    for (; k < 32 && size > COADJOINT_UNIT; ++k) size /= COADJOINT_UNIT;
    for (; k > -32 && size > 0 && size < 1; --k) size *= COADJOINT_UNIT;
    for (int i = 0; i < n && k != 0; ++i) v[i] = coadjoint_(power)(v[i], -k);
    return k;
}

/* Sine and cosine: pi/2 is subtracted in three parts, and the polynomials are those of fdlibm. */
static inline void coadjoint_(sincos)(coadjoint_real t, coadjoint_real *sine, coadjoint_real *cosine) {
    static const coadjoint_real P[] = {COADJOINT_HALF_PI};
    static const coadjoint_real S[] = {-coadjoint_n(1.66666666666666324e-1), coadjoint_n(8.33333333332248946e-3),
                                       -coadjoint_n(1.98412698298579493e-4), coadjoint_n(2.75573137070700677e-6),
                                       -coadjoint_n(2.50507602534068634e-8), coadjoint_n(1.58969099521155010e-10)};
    static const coadjoint_real C[] = {coadjoint_n(4.16666666666666019e-2), -coadjoint_n(1.38888888888741096e-3),
                                       coadjoint_n(2.48015872894767294e-5), -coadjoint_n(2.75573143513906633e-7),
                                       coadjoint_n(2.08757232129817483e-9), -coadjoint_n(1.13596475577881948e-11)};
    const coadjoint_real turns = t * coadjoint_n(0.63661977236758134308);
    const long n = (long)(turns + (turns < 0 ? -coadjoint_n(0.5) : coadjoint_n(0.5)));
    const coadjoint_real k = (coadjoint_real)n, y = t - k * P[0] - k * P[1] - k * P[2], u = y * y;
    coadjoint_real odd = S[5], even = C[5];
    for (int i = 4; i >= 0; --i) {
        odd = odd * u + S[i];
        even = even * u + C[i];
    }
    odd = y + y * (u * odd);
    even = 1 - (u * coadjoint_n(0.5) - u * u * even);
    *sine = n & 1 ? even : odd;
    *cosine = n & 1 ? odd : even;
    if (n & 2) *sine = -*sine;
    if ((n + 1) & 2) *cosine = -*cosine;
}

/* One piece of time, of length 1: x_i(s) = (z_i C_j C_k + s a_i C_i z_j z_k)/D with D = s^2 (P(s) - middle) and
   C_i^2 = D + s^2 p_i, and Weierstrass's function s^2 P(s) = 1 + c0 s^4 + c1 s^6 + ... with the roots e_i. */
struct coadjoint_(piece) {
    coadjoint_real m[3], a[3], z[3], w[3], across[3], p[3], e[3], middle, energy, length2, c0, c1;
};

/* sqrt(1 + x) - 1 by the binomial series: |x| is below 0.024 (float: 0.17). */
static inline coadjoint_real coadjoint_(root)(coadjoint_real x) {
    const coadjoint_real first = coadjoint_n(0.5) - x * coadjoint_n(0.125);
    const coadjoint_real second = coadjoint_n(0.0625) - x * coadjoint_n(0.0390625);
    const coadjoint_real third = coadjoint_n(0.02734375) - x * coadjoint_n(0.0205078125);
    const coadjoint_real fourth = coadjoint_n(0.01611328125) - x * coadjoint_n(0.013092041015625);
    return x * (first + x * x * second + x * x * (x * x) * (third + x * x * fourth));
}

/* At the time s: the change of the momentum, and the rate of rotation about it, over |x|. Unless d is 0, their
   derivatives by the momentum are d[9] and the gradient. */
static inline coadjoint_real coadjoint_(point)(const struct coadjoint_(piece) *b, coadjoint_real s,
                                               coadjoint_real *change, coadjoint_real *d, coadjoint_real *gradient) {
    const coadjoint_real *m = b->m, *a = b->a, *z = b->z, c0 = b->c0, c1 = b->c1, s2 = s * s, s4 = s2 * s2;
    const coadjoint_real c2 = c0 * c0 * coadjoint_n(0.33333333333333333);
    const coadjoint_real c3 = c0 * c1 * coadjoint_n(0.27272727272727273);
    const coadjoint_real c4 = (2 * c0 * c2 + c1 * c1) * coadjoint_n(0.076923076923076923);
    const coadjoint_real less = s4 * (c0 + s2 * c1 + s4 * (c2 + s2 * c3 + s4 * c4)) - s2 * b->middle; /* D - 1 */
    const coadjoint_real inverse = 1 / (1 + less);
    const coadjoint_real u = coadjoint_(root)(less + s2 * b->p[0]), v = coadjoint_(root)(less + s2 * b->p[1]);
    const coadjoint_real w = coadjoint_(root)(less + s2 * b->p[2]), root[3] = {u, v, w}; /* C_i - 1 */
    const coadjoint_real along[3] = {v + w + v * w - less, w + u + w * u - less, u + v + u * v - less};
    coadjoint_real length2, rate;
    change[0] = (z[0] * along[0] + s * (b->across[0] + b->across[0] * u)) * inverse;
    change[1] = (z[1] * along[1] + s * (b->across[1] + b->across[1] * v)) * inverse;
    change[2] = (z[2] * along[2] + s * (b->across[2] + b->across[2] * w)) * inverse;
    length2 = 2 * b->length2 + coadjoint_(dot)(z, change);
    rate = (2 * b->energy + coadjoint_(dot)(b->w, change)) / length2;
    if (d) {
        const coadjoint_real by_c0 = s4 * (1 + s4 * (2 * c0 / 3 + 3 * s2 * c1 / 11 + 2 * s4 * c0 * c0 / 13));
        const coadjoint_real by_c1 = s4 * (s2 + s4 * (3 * s2 * c0 / 11 + 2 * s4 * c1 / 13));
        for (int l = 0; l < 3; ++l) {
            const int n = (l + 1) % 3, o = (l + 2) % 3;
            const coadjoint_real p = 2 * a[n] * a[o] * z[l]; /* derivatives by z_l of p_l, of D, and of C_i */
            const coadjoint_real f = p * (-s2 / 3 - by_c0 * b->e[l] / 5 - by_c1 * (b->e[n] * b->e[o] + 5 * c0 / 3) / 7);
            coadjoint_real g[3];
            for (int i = 0; i < 3; ++i) g[i] = (i == l ? f + s2 * p : f) / (2 + 2 * root[i]);
            gradient[l] = (m[l] - rate) * (change[l] + 4 * z[l]);
            for (int i = 0; i < 3; ++i) {
                const int j = (i + 1) % 3, k = (i + 2) % 3;
                const coadjoint_real own = i == l ? along[i] : s * a[i] * z[3 - i - l] * (1 + root[i]);
                const coadjoint_real sum = g[j] * (1 + root[k]) + g[k] * (1 + root[j]) - f;
                d[3 * i + l] = (own + z[i] * sum + s * b->across[i] * g[i] - change[i] * f) * inverse;
                gradient[l] += (m[i] - rate) * z[i] * d[3 * i + l];
            }
            gradient[l] /= length2;
        }
    }
    return rate;
}

/* One piece of time, by which m and a are multiplied: z is moved, r is the rotation; J and G as above, or both 0. */
static inline void coadjoint_(move)(const coadjoint_real *m, const coadjoint_real *a, coadjoint_real *z,
                                    coadjoint_real *r, coadjoint_real *J, coadjoint_real *G) {
    static const coadjoint_real NODES[] = {COADJOINT_NODES}, WEIGHTS[] = {COADJOINT_WEIGHTS};
    enum { LAST = COADJOINT_POINTS - 1 };
    struct coadjoint_(piece) b;
    coadjoint_real x[3], c[COADJOINT_POINTS][3], d[COADJOINT_POINTS][9], gradient[COADJOINT_POINTS][3];
    coadjoint_real rates[COADJOINT_POINTS], start, u[3], v[3], Q, sine, cosine, whole, length, *change = c[LAST];
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        b.m[i] = m[i];
        b.a[i] = a[i];
        b.z[i] = z[i];
        b.w[i] = m[i] * z[i];
        b.across[i] = a[i] * (z[j] * z[k]);
        b.p[i] = a[j] * a[k] * (z[i] * z[i]);
    }
    b.middle = (b.p[0] + b.p[1] + b.p[2]) * coadjoint_n(0.33333333333333333);
    for (int i = 0; i < 3; ++i) b.e[i] = b.middle - b.p[i];
    b.energy = coadjoint_(dot)(b.w, z);
    b.length2 = coadjoint_(dot)(z, z);
    start = b.energy / b.length2;
    b.c0 = coadjoint_(dot)(b.e, b.e) * coadjoint_n(0.1);
    b.c1 = b.e[0] * b.e[1] * b.e[2] * coadjoint_n(0.14285714285714286);
    if (J)
        for (int k = 0; k <= LAST; ++k) rates[k] = coadjoint_(point)(&b, NODES[k], c[k], d[k], gradient[k]);
    else
        for (int k = 0; k <= LAST; ++k) rates[k] = coadjoint_(point)(&b, NODES[k], c[k], 0, 0);
    Q = WEIGHTS[LAST] * start;
    for (int k = 0; k <= LAST; ++k) Q += WEIGHTS[k] * rates[k];
    length = coadjoint_sqrt(b.length2);
    coadjoint_(sincos)(length * Q / 2, &sine, &cosine);
    sine /= length;
    /* About the new momentum, and then from it to the old one by the shortest rotation. */
    whole = coadjoint_sqrt(1 - coadjoint_(dot)(change, change) / (4 * b.length2));
    for (int i = 0; i < 3; ++i) x[i] = z[i] + change[i];
    coadjoint_(cross)(change, z, u);
    for (int i = 0; i < 3; ++i) v[i] = u[i] / (2 * b.length2 * whole);
    coadjoint_(cross)(v, x, r + 1);
    r[0] = cosine * whole;
    for (int i = 0; i < 3; ++i) r[1 + i] = whole * sine * x[i] + (cosine * v[i] + sine * r[1 + i]);
    if (J) { /* x . G dz is that of the angle, and x cross G dz = (J - R^T) dz, since R x is constant */
        coadjoint_real E[9];
        coadjoint_(turn)(r, E);
        for (int l = 0; l < 3; ++l) {
            coadjoint_real column[3], across[3], U = 2 * u[l];
            coadjoint_real along = WEIGHTS[LAST] * 2 * (m[l] - start) * z[l] / b.length2; /* of the start */
            for (int i = 0; i < 3; ++i) {
                column[i] = d[LAST][3 * i + l] - E[3 * l + i];
                U += u[i] * d[LAST][3 * i + l];
            }
            for (int k = 0; k <= LAST; ++k) along += WEIGHTS[k] * gradient[k][l];
            along = along * b.length2 + Q * z[l] - U / (coadjoint_(dot)(z, x) + b.length2);
            coadjoint_(cross)(x, column, across);
            for (int i = 0; i < 3; ++i) {
                G[3 * i + l] = (x[i] * along - across[i]) / b.length2;
                J[3 * i + l] = d[LAST][3 * i + l] + (i == l);
            }
        }
    }
    for (int i = 0; i < 3; ++i) z[i] = x[i];
}

/* The time t in pieces, whose number is returned: z is moved, and r, J and G are those of the time. */
static inline long coadjoint_(pieces)(const coadjoint_real m[3], const coadjoint_real d[3], coadjoint_real t,
                                      coadjoint_real reach, coadjoint_real *z, coadjoint_real r[4], coadjoint_real *J,
                                      coadjoint_real *G) {
    const long count = (long)(reach * (t < 0 ? -t : t)) + 1;
    coadjoint_real n[3], a[3];
    for (int i = 0; i < 3; ++i) {
        n[i] = m[i] * t / (coadjoint_real)count;
        a[i] = d[i] * t / (coadjoint_real)count;
    }
    coadjoint_(move)(n, a, z, r, J, G);
    for (long piece = 1; piece < count; ++piece) {
        coadjoint_real p[4], q[4] = {r[0], r[1], r[2], r[3]}, Jp[9], Gp[9], E[9], one[9], other[9];
        coadjoint_(move)(n, a, z, p, J ? Jp : 0, Gp);
        coadjoint_(cross)(q + 1, p + 1, r + 1);
        r[0] = q[0] * p[0] - coadjoint_(dot)(q + 1, p + 1);
        for (int i = 1; i < 4; ++i) r[i] += q[0] * p[i] + p[0] * q[i];
        if (J) {
            coadjoint_(turn)(p, E);
            coadjoint_(product)(E, 1, G, one);
            coadjoint_(product)(Gp, 0, J, other);
            for (int i = 0; i < 9; ++i) G[i] += one[i] + other[i];
            coadjoint_(product)(Jp, 0, J, other);
            for (int i = 0; i < 9; ++i) J[i] = other[i];
        }
    }
    return count;
}

/* The time 1, if it is long: whole periods of the momentum, in which the body rotates about it, and the rest. A period
   is 2 pi over the arithmetic-geometric mean of the roots of e_1 - e_3, which bounds all p_i on the way, and e_1 - e_2.
   0 if it has too many. */
static inline long coadjoint_(periods)(const coadjoint_real m[3], const coadjoint_real a[3], coadjoint_real *z,
                                       coadjoint_real r[4], coadjoint_real *J, coadjoint_real *G) {
    const coadjoint_real start[3] = {z[0], z[1], z[2]}, length2 = coadjoint_(dot)(z, z);
    const coadjoint_real length = coadjoint_sqrt(length2), full = coadjoint_n(6.2831853071795865);
    coadjoint_real p[3], f, g, df[3], dg[3], wide, reach, period, rest, turns, cosine, sine, size, whole = 1, about = 0;
    coadjoint_real q[4], along[3], E[9], first[9];
    int o[3] = {0, 1, 2};
    long count;
    for (int i = 0; i < 3; ++i) p[i] = (a[(i + 1) % 3] * z[i]) * (a[(i + 2) % 3] * z[i]);
    for (int k = 0; k < 3; ++k)
        if (p[o[(k & 1) + 1]] < p[o[k & 1]]) {
            const int i = o[k & 1];
            o[k & 1] = o[(k & 1) + 1];
            o[(k & 1) + 1] = i;
        }
    wide = p[o[2]] - p[o[0]];
    f = coadjoint_sqrt(wide);
    if (!(f < COADJOINT_TURN)) return 0;
    reach = f / COADJOINT_PIECE;
    g = p[o[1]] - p[o[0]];
    g = coadjoint_sqrt(g < wide * COADJOINT_GAP ? wide * COADJOINT_GAP : g);
    for (int i = 0; i < 3; ++i) {
        const coadjoint_real dp = a[(i + 1) % 3] * (a[(i + 2) % 3] * z[i]);
        df[i] = i == o[2] ? dp / f : i == o[0] ? -dp / f : 0;
        dg[i] = i == o[1] ? dp / g : i == o[0] ? -dp / g : 0;
        if (p[o[1]] - p[o[0]] < wide * COADJOINT_GAP) dg[i] = (coadjoint_real)NAN; /* not resolved */
    }
    for (int k = 0; k < 9; ++k) {
        const coadjoint_real mean = (f + g) / 2, root = coadjoint_sqrt(f * g);
        for (int i = 0; i < 3; ++i) {
            const coadjoint_real d = (df[i] * g + f * dg[i]) / (2 * root);
            df[i] = (df[i] + dg[i]) / 2;
            dg[i] = d;
        }
        f = mean;
        g = root;
    }
    period = full / f;
    turns = (coadjoint_real)(long)(1 / period + coadjoint_n(0.5));
    if (reach <= 64 || turns == 0) return coadjoint_(pieces)(m, a, 1, reach, z, r, J, G);
    rest = 1 - turns * period;
    count = coadjoint_(pieces)(m, a, period, reach, z, q, J, G);
    cosine = q[0];
    sine = coadjoint_(dot)(q + 1, start) / length;
    size = coadjoint_sqrt(cosine * cosine + sine * sine);
    cosine /= size;
    sine /= size;
    for (long left = (long)turns; left > 0; left /= 2) { /* the power of a unit complex number, by squares */
        coadjoint_real next, twice;
        if (left % 2) {
            next = whole * cosine - about * sine;
            about = whole * sine + about * cosine;
            whole = next;
        }
        next = cosine * cosine - sine * sine;
        twice = 2 * cosine * sine;
        size = coadjoint_n(1.5) - (next * next + twice * twice) / 2;
        cosine = next * size;
        sine = twice * size;
    }
    q[0] = whole;
    for (int i = 0; i < 3; ++i) q[1 + i] = about * start[i] / length;
    if (J) { /* of the angle, by the angular velocity along the momentum; the momentum returns, whatever it is */
        coadjoint_real w[3];
        for (int i = 0; i < 3; ++i) w[i] = m[i] * start[i];
        coadjoint_(turn)(q, E);
        for (int l = 0; l < 3; ++l) {
            const coadjoint_real column[3] = {-E[3 * l], -E[3 * l + 1], -E[3 * l + 2]};
            coadjoint_real across[3], sum = coadjoint_(dot)(w, start) * (-period * df[l] / f);
            for (int i = 0; i < 3; ++i) sum += start[i] * G[3 * i + l];
            along[l] = turns * period * df[l] / f; /* of the rest of the time */
            coadjoint_(cross)(start, column, across);
            for (int i = 0; i < 3; ++i) first[3 * i + l] = (start[i] * turns * sum - across[i]) / length2;
        }
    }
    for (int i = 0; i < 3; ++i) z[i] = start[i];
    count += coadjoint_(pieces)(m, a, rest, reach, z, r, J, G);
    if (J) {
        coadjoint_real w[3], v[3], one[9];
        for (int i = 0; i < 3; ++i) w[i] = m[i] * z[i];
        coadjoint_(cross)(z, w, v);
        coadjoint_(turn)(r, E);
        coadjoint_(product)(E, 1, first, one);
        for (int i = 0; i < 9; ++i) {
            J[i] += v[i / 3] * along[i % 3];
            G[i] += first[i] + one[i] + w[i / 3] * along[i % 3];
        }
    }
    for (int i = 0; i < 4; ++i) E[i] = r[i];
    coadjoint_(cross)(q + 1, E + 1, r + 1);
    r[0] = q[0] * E[0] - coadjoint_(dot)(q + 1, E + 1);
    for (int i = 1; i < 4; ++i) r[i] += q[0] * E[i] + E[0] * q[i];
    return count;
}

/* J and G may be 0 together: the next function needs neither. */
static inline long coadjoint_(body_jacobian)(const coadjoint_real m[3], coadjoint_real h, coadjoint_real x[3],
                                             coadjoint_real r[4], coadjoint_real *J, coadjoint_real *G) {
    coadjoint_real n[3] = {m[0], m[1], m[2]}, a[3], z[3] = {x[0], x[1], x[2]}, length, reach = 0, angle = 0, most = 0;
    long kx = coadjoint_(scale)(z, 3), k = kx + coadjoint_(scale)(n, 3) + coadjoint_(scale)(&h, 1), less = 0, count = 0;
    if (z[0] == 0 && z[1] == 0 && z[2] == 0) { /* at rest: below any number */
        z[0] = 1;
        k -= 1000;
        kx = -1000;
    }
    if (k < -5) { /* the motion is linear in the time to rounding; its squares would underflow */
        less = k + 5;
        k = -5;
    }
    length = coadjoint_sqrt(coadjoint_(dot)(z, z));
    for (int i = 0; i < 3; ++i) a[i] = coadjoint_(power)((n[(i + 2) % 3] - n[(i + 1) % 3]) * h, k);
    for (int i = 0; i < 3; ++i) {
        n[i] = coadjoint_(power)(n[i] * h, k);
        reach += (a[i] < 0 ? -a[i] : a[i]) * length / (2 * COADJOINT_PIECE); /* sums to twice the largest */
        angle += n[i] * z[i] * (z[i] / length);
        most += (n[i] < 0 ? -n[i] : n[i]) * length;
    }
    if ((angle < 0 ? -angle : angle) < COADJOINT_TURN && most < COADJOINT_MOST)
        count = reach < 64 ? coadjoint_(pieces)(n, a, 1, reach, z, r, J, G)
                           : coadjoint_(periods)(n, a, z, r, J, G);
    if (!count) {
        for (int i = 0; i < 3; ++i) x[i] = (coadjoint_real)NAN;
        for (int i = 0; i < 4; ++i) r[i] = (coadjoint_real)NAN;
        for (int i = 0; i < 9 && J; ++i) J[i] = G[i] = (coadjoint_real)NAN;
        return 0;
    }
    for (int i = 0; i < 3; ++i) {
        x[i] = coadjoint_(power)(z[i], kx);
        r[1 + i] = coadjoint_(power)(r[1 + i], less);
    }
    for (int i = 0; i < 9 && J; ++i) {
        G[i] = coadjoint_(power)(G[i], less - kx);
        if (i % 4) J[i] = coadjoint_(power)(J[i], less);
    }
    return count;
}

static inline long coadjoint_(body_rotation)(const coadjoint_real m[3], coadjoint_real h, coadjoint_real x[3],
                                             coadjoint_real r[4]) {
    return coadjoint_(body_jacobian)(m, h, x, r, 0, 0);
}

static inline long coadjoint_(body_step)(const coadjoint_real m[3], coadjoint_real h, coadjoint_real x[3],
                                         coadjoint_real q[4]) {
    coadjoint_real r[4], v[3], size, w;
    const long count = coadjoint_(body_rotation)(m, h, x, r);
    w = q[0] * r[0] - coadjoint_(dot)(q + 1, r + 1);
    coadjoint_(cross)(q + 1, r + 1, v);
    for (int i = 0; i < 3; ++i) v[i] += q[0] * r[1 + i] + r[0] * q[1 + i];
    size = coadjoint_sqrt(w * w + coadjoint_(dot)(v, v));
    q[0] = w / size;
    for (int i = 0; i < 3; ++i) q[1 + i] = v[i] / size;
    return count;
}

static inline long coadjoint_(body_step_matrix)(const coadjoint_real m[3], coadjoint_real h, coadjoint_real x[3],
                                                coadjoint_real A[9]) {
    coadjoint_real r[4], E[9], B[9], C[9], wrong = 1;
    const long count = coadjoint_(body_rotation)(m, h, x, r);
    coadjoint_(turn)(r, E);
    coadjoint_(product)(A, 0, E, B);
    for (int i = 0; i < 9; ++i) A[i] += B[i];
    for (int k = 0; k < 8 && wrong > COADJOINT_NEAR; ++k) { /* A - A (A^T A - 1)/2 squares the error */
        coadjoint_(product)(A, 1, A, B);
        for (int i = 0; i < 3; ++i) B[4 * i] -= 1;
        wrong = 0;
        for (int i = 0; i < 9; ++i) wrong = B[i] > wrong ? B[i] : -B[i] > wrong ? -B[i] : wrong;
        if (k == 0 && !(wrong < coadjoint_n(0.3))) {
            for (int i = 0; i < 9; ++i) A[i] = (coadjoint_real)NAN;
            return 0;
        }
        coadjoint_(product)(A, 0, B, C);
        for (int i = 0; i < 9; ++i) A[i] -= C[i] / 2;
    }
    return count;
}

static inline long coadjoint_(body_step_velocity)(const coadjoint_real inertia[3], coadjoint_real h,
                                                  coadjoint_real w[3], coadjoint_real q[4]) {
    coadjoint_real m[3];
    long count;
    for (int i = 0; i < 3; ++i) {
        m[i] = inertia[i] == 0 ? 0 : 1 / inertia[i];
        w[i] *= inertia[i];
    }
    count = coadjoint_(body_step)(m, h, w, q);
    for (int i = 0; i < 3; ++i) w[i] *= m[i];
    return count;
}
#undef COADJOINT_BITS
#undef coadjoint_real
#undef coadjoint_
#undef coadjoint_n
#undef coadjoint_sqrt
#undef COADJOINT_UNIT
#undef COADJOINT_TURN
#undef COADJOINT_MOST
#undef COADJOINT_PIECE
#undef COADJOINT_GAP
#undef COADJOINT_NEAR
#undef COADJOINT_POINTS
#undef COADJOINT_NODES
#undef COADJOINT_WEIGHTS
#undef COADJOINT_HALF_PI
#endif
