/* An ensemble of free rigid bodies x' = (M x) cross x, order 2, parts 1 2 3, on the processor's vector registers.

   ensemble STEPS h m1 m2 m3 MEMBERS START END      START, END: files of 3 * MEMBERS doubles, all x1, then all x2, all x3

   VECTORS registers of members stay in registers over all steps. With -DLIBMVEC sine and cosine are glibc's vector
   functions; otherwise they are computed here, to 1.5 units in the last place. Prints CPU nanoseconds a step of one
   member. */
#include "program.h"
#include <stdint.h>

#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif
#ifndef VECTORS
#define VECTORS 8
#endif

typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t bits __attribute__((vector_size(8 * LANES)));

#ifdef LIBMVEC
#ifdef __AVX512F__
vec _ZGVeN8v_sin(vec);
vec _ZGVeN8v_cos(vec);
#define vector_sin _ZGVeN8v_sin
#define vector_cos _ZGVeN8v_cos
#else
vec _ZGVdN4v_sin(vec);
vec _ZGVdN4v_cos(vec);
#define vector_sin _ZGVdN4v_sin
#define vector_cos _ZGVdN4v_cos
#endif
static inline void sine_cosine(vec angle, vec *s, vec *c) { *s = vector_sin(angle), *c = vector_cos(angle); }
#else
/* The nearest multiple n of pi/2 by adding 1.5 * 2^52, whose last bits are then n; pi/2 in two parts; the minimax
   polynomials of FDLIBM on the rest; odd n exchanges sine and cosine, the second bit of n and of n + 1 is the sign. */
static inline void sine_cosine(vec angle, vec *s, vec *c) {
    const vec shift = (vec){} + 0x1.8p52;
    vec shifted = angle * 0x1.45f306dc9c883p-1 + shift;
    vec n = shifted - shift;
    bits quarter = (bits)shifted;
    vec r = angle - n * 0x1.921fb54442d18p0;
    r = r - n * 0x1.1a62633145c07p-54;
    vec z = r * r;
    vec p = 1.58969099521155010221e-10 * z - 2.50507602534068634195e-08;
    vec q = -1.13596475577881948265e-11 * z + 2.08757232129817482790e-09;
    p = p * z + 2.75573137070700676789e-06, q = q * z - 2.75573143513906633035e-07;
    p = p * z - 1.98412698298579493134e-04, q = q * z + 2.48015872894767294178e-05;
    p = p * z + 8.33333333332248946124e-03, q = q * z - 1.38888888888741095749e-03;
    p = p * z - 1.66666666666666324348e-01, q = q * z + 4.16666666666666019037e-02;
    vec sine = r + r * z * p, cosine = 1.0 + z * (q * z - 0.5);
    bits odd = -(quarter & 1);
    bits swap = ((bits)sine ^ (bits)cosine) & odd, first = (bits)sine ^ swap, second = (bits)cosine ^ swap;
    *s = (vec)(first ^ ((quarter & 2) << 62));
    *c = (vec)(second ^ (((quarter + 1) & 2) << 62));
}
#endif

static inline void rotate(double scale, const vec *axis, vec *a, vec *b) {
    for (int v = 0; v < VECTORS; v++) {
        vec s, c, old = a[v];
        sine_cosine(scale * axis[v], &s, &c);
        a[v] = c * old - s * b[v];
        b[v] = s * old + c * b[v];
    }
}

static void advance(long steps, const double *h, vec x[3][VECTORS]) {
    vec a[VECTORS], b[VECTORS], c[VECTORS];
    memcpy(a, x[0], sizeof a), memcpy(b, x[1], sizeof b), memcpy(c, x[2], sizeof c);
    rotate(0.5 * h[0], a, b, c);
    for (long k = 0;;) {
        rotate(0.5 * h[1], b, c, a);
        rotate(h[2], c, a, b);
        rotate(0.5 * h[1], b, c, a);
        if (++k == steps) break;
        rotate(h[0], a, b, c);
    }
    rotate(0.5 * h[0], a, b, c);
    memcpy(x[0], a, sizeof a), memcpy(x[1], b, sizeof b), memcpy(x[2], c, sizeof c);
}

static void transfer(const char *path, const char *mode, double *x, long count) {
    FILE *file = fopen(path, mode);
    long done = file == NULL ? 0 : (long)(*mode == 'r' ? fread(x, 8, count, file) : fwrite(x, 8, count, file));
    if (file == NULL || done != count || fclose(file) != 0) {
        fprintf(stderr, "%s: not %ld numbers\n", path, count);
        exit(2);
    }
}

static double cpu_seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1), members = (long)number(argc, argv, 6);
    double h[3];
    for (int i = 0; i < 3; i++) h[i] = number(argc, argv, 2) * number(argc, argv, 3 + i);
    if (argc < 9 || members % (LANES * VECTORS) != 0) {
        fprintf(stderr, "ensemble: %d arguments, members a multiple of %d\n", 8, LANES * VECTORS);
        return 2;
    }
    double *x = malloc(24 * members);
    transfer(argv[7], "rb", x, 3 * members);
    double begun = cpu_seconds();
    for (long first = 0; first < members; first += LANES * VECTORS) {
        vec block[3][VECTORS];
        for (int i = 0; i < 3; i++) memcpy(block[i], x + i * members + first, sizeof block[i]);
        advance(steps, h, block);
        for (int i = 0; i < 3; i++) memcpy(x + i * members + first, block[i], sizeof block[i]);
    }
    double elapsed = cpu_seconds() - begun;
    transfer(argv[8], "wb", x, 3 * members);
    printf("%.6f\n", 1e9 * elapsed / steps / members);
    return 0;
}
