/* The free rigid body x' = (M x) cross x by a Gauss-Legendre method whose stages are the lanes of vectors.

   gauss_legendre STEPS h m1 m2 m3 x1 x2 x3, then s weights, s * s coefficients and s * s of the starting values,
   compiled with STAGES and CAREFUL. Careless: X_i = x + sum_j (h a_ij) f_j, iterated until no component moves by more
   than 1e-15 |x|. Careful: X_i = x + sum_j mu_ij L_j with L_j = h b_j f_j, iterated until corrections stop falling, and
   the sum of the steps compensated. Both test only from where the step before says that it may be the last iteration.
   Printed: nanoseconds a step, the state, iterations a step, the largest relative change of energy and of |x|^2 at 64
   times. */
#include "program.h"

#include <stdint.h>
#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define WIDTH (STAGES <= 2 ? 2 : STAGES <= 4 ? 4 : 8)
#define BLOCKS ((STAGES + WIDTH - 1) / WIDTH)
#define LANES (WIDTH * BLOCKS)
#define MOST 192
#define FIRST_TEST 3

typedef double Vector __attribute__((vector_size(8 * WIDTH)));
typedef int64_t Bits __attribute__((vector_size(8 * WIDTH)));

/* One number for every stage; lanes beyond the last repeat it. */
typedef struct {
    Vector part[BLOCKS];
} Stages;

static inline double lane(const Stages *y, int i) { return y->part[i / WIDTH][i % WIDTH]; }

static Stages of(const double *from, int stride) {
    Stages y;
    for (int i = 0; i < LANES; i++) y.part[i / WIDTH][i % WIDTH] = from[(i < STAGES ? i : STAGES - 1) * stride];
    return y;
}

static inline int some(Bits bits) {
#if defined(__AVX512F__)
    if (sizeof(bits) == 64) {
        __m512i all;
        memcpy(&all, &bits, sizeof(bits));
        return _mm512_test_epi64_mask(all, all) != 0;
    }
#endif
#if defined(__AVX2__)
    if (sizeof(bits) == 32) {
        __m256i all;
        memcpy(&all, &bits, sizeof(bits));
        return !_mm256_testz_si256(all, all);
    }
#endif
    int64_t total = 0;
    for (int i = 0; i < WIDTH; i++) total |= bits[i];
    return total != 0;
}

static inline Vector smaller(Vector a, Vector b) {
    Bits below = a < b;
    return (Vector)(((Bits)a & below) | ((Bits)b & ~below));
}

/* y_c = start_c + sum_j coefficient_j slope_cj: two sums for each component, so that none waits long for another. */
static inline void mix(const Stages *coefficient, const Stages *slopes, const double *start, Stages *y) {
    Vector even[BLOCKS][3], odd[BLOCKS][3];
    for (int b = 0; b < BLOCKS; b++)
        for (int c = 0; c < 3; c++) even[b][c] = start[c] - (Vector){0}, odd[b][c] = (Vector){0};
#pragma GCC unroll 16
    for (int j = 0; j < STAGES; j += 2)
        for (int c = 0; c < 3; c++)
            for (int b = 0; b < BLOCKS; b++) {
                even[b][c] += coefficient[j].part[b] * lane(&slopes[c], j);
                if (j + 1 < STAGES) odd[b][c] += coefficient[j + 1].part[b] * lane(&slopes[c], j + 1);
            }
    for (int b = 0; b < BLOCKS; b++)
        for (int c = 0; c < 3; c++) y[c].part[b] = even[b][c] + odd[b][c];
}

/* L_c = h b (M x cross x)_c, without h b unless careful. */
static inline void slopes_at(const Stages *X, const double *m, const Stages *length, Stages *L) {
    for (int b = 0; b < BLOCKS; b++) {
        Vector x0 = X[0].part[b], x1 = X[1].part[b], x2 = X[2].part[b];
        Vector u0 = m[0] * x0, u1 = m[1] * x1, u2 = m[2] * x2;
        L[0].part[b] = u1 * x2 - u2 * x1;
        L[1].part[b] = u2 * x0 - u0 * x2;
        L[2].part[b] = u0 * x1 - u1 * x0;
        for (int c = 0; CAREFUL && c < 3; c++) L[c].part[b] *= length->part[b];
    }
}

/* The stages from the slopes: the sums, and, if they are of increments alone, the state. */
static inline void stages_from(const Stages *coefficient, const Stages *L, const double *x, const double *owed,
                               Stages *y) {
    mix(coefficient, L, CAREFUL ? owed : x, y);
    for (int c = 0; CAREFUL && c < 3; c++)
        for (int b = 0; b < BLOCKS; b++) y[c].part[b] += x[c];
}

static inline double invariant(const double *m, const double *x) {
    return m[0] * x[0] * x[0] + m[1] * x[1] * x[1] + m[2] * x[2] * x[2];
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1), iterations = 0;
    double h = number(argc, argv, 2), m[3], x[3], ones[3] = {1, 1, 1}, drift = 0;
    for (int c = 0; c < 3; c++) m[c] = number(argc, argv, 3 + c), x[c] = number(argc, argv, 6 + c);
    double weight[STAGES], table[STAGES * STAGES], ahead[STAGES * STAGES];
    for (int i = 0; i < STAGES; i++) weight[i] = h * number(argc, argv, 9 + i);
    for (int i = 0; i < STAGES * STAGES; i++) {
        table[i] = number(argc, argv, 9 + STAGES + i) * (CAREFUL ? 1 : h);
        ahead[i] = number(argc, argv, 9 + STAGES + STAGES * STAGES + i) * (CAREFUL ? 1 : h);
    }
    Stages coefficient[STAGES], forecast[STAGES], length = of(weight, 1), X[3], L[3];
    for (int j = 0; j < STAGES; j++) coefficient[j] = of(table + j, STAGES), forecast[j] = of(ahead + j, STAGES);
    memset(L, 0, sizeof(L));
    double energy = invariant(m, x), square = invariant(ones, x), owed[3] = {0, 0, 0};
    double small = CAREFUL ? 0x1p-32 * sqrt(square) : 1e-15 * sqrt(square);
    int from = 1;
    double begun = seconds();
    for (long k = 1; k <= steps; k++) {
        stages_from(forecast, L, x, owed, X);
        int passed = 1, quiet = 0;
        for (; passed < from; passed++) {
            slopes_at(X, m, &length, L);
            stages_from(coefficient, L, x, owed, X);
        }
        Stages least[3], next[3], moved[3];
        for (int c = 0; c < 3; c++)
            for (int b = 0; b < BLOCKS; b++) least[c].part[b] = INFINITY - (Vector){0};
        for (;; passed++) {
            slopes_at(X, m, &length, L);
            stages_from(coefficient, L, x, owed, next);
            Bits far = {0}, any = {0};
            for (int c = 0; c < 3; c++)
                for (int b = 0; b < BLOCKS; b++) {
                    moved[c].part[b] = (Vector)((Bits)(next[c].part[b] - X[c].part[b]) & INT64_MAX);
                    any |= (Bits)moved[c].part[b];
                    far |= (Bits)(small - moved[c].part[b]); /* negative where it moved by more */
                    X[c].part[b] = next[c].part[b];
                }
            if (!CAREFUL && some(far >> 63)) continue;
            if (!CAREFUL || !some(any) || passed == MOST) {
                from = passed - 1;
                break;
            }
            /* Corrections below one unit in the last place count as none; done when twice none fell. */
            for (int c = 0; c < 3; c++)
                for (int b = 0; b < BLOCKS; b++) {
                    Vector unit = 0x1p-52 * (Vector)((Bits)X[c].part[b] & INT64_MAX);
                    Vector own = (Vector)((Bits)moved[c].part[b] & (moved[c].part[b] > unit));
                    far |= (Bits)(own - least[c].part[b]);
                    least[c].part[b] = smaller(own, least[c].part[b]);
                }
            quiet = some(far >> 63) || passed <= FIRST_TEST ? 0 : quiet + 1;
            if (__builtin_expect(quiet >= (passed < 12 ? 2 : passed / 4), 0)) {
                from = passed - quiet - 1;
                break;
            }
        }
        iterations += passed;
        for (int c = 0; c < 3; c++) {
            double even = CAREFUL ? owed[c] : 0, odd = 0;
#pragma GCC unroll 16
            for (int j = 0; j < STAGES; j++) {
                double term = (CAREFUL ? 1.0 : weight[j]) * lane(&L[c], j);
                if (j % 2 == 0) even += term;
                else odd += term;
            }
            double increment = even + odd, old = x[c], now = old + increment;
            if (CAREFUL) {
                double kept = now - old;
                owed[c] = (old - (now - kept)) + (increment - kept);
            }
            x[c] = now;
        }
        if (k % (steps / 64 + 1) == 0 || k == steps) {
            drift = fmax(drift, fabs(invariant(m, x) / energy - 1));
            drift = fmax(drift, fabs(invariant(ones, x) / square - 1));
        }
    }
    double elapsed = seconds() - begun, printed[5] = {x[0], x[1], x[2], (double)iterations / steps, drift};
    report(elapsed, steps, printed, 5);
    return 0;
}
