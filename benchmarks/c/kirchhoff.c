/* A body in a fluid, on e(3): H = sum m_i x_i^2 / 2 + b_i x_i over (m, p), order 2, parts 1 ... 6.
   A part of m turns both m and p about an axis; a part of p shears m by u cross p.

   kirchhoff STEPS h m1 ... m6 b1 ... b6 x1 ... x6 */
#include "program.h"

static inline void rotate(double s, double c, double *a, double *b) {
    double old = *a;
    *a = c * old - s * *b;
    *b = s * old + c * *b;
}

/* The exact flow of part i over the time tau; i is a literal. */
static inline __attribute__((always_inline)) void flow(int i, double tau, const double *m, const double *b, double *x) {
    double angle = tau * (b[i] + m[i] * x[i]);
    int axis = i % 3, j = (axis + 1) % 3, k = (axis + 2) % 3;
    if (i < 3) {
        double s, c;
        sincos(angle, &s, &c);
        rotate(s, c, &x[j], &x[k]);
        rotate(s, c, &x[3 + j], &x[3 + k]);
    } else {
        x[j] -= angle * x[3 + k];
        x[k] += angle * x[3 + j];
    }
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1);
    double h = number(argc, argv, 2), half = 0.5 * h, m[6], b[6], x[6];
    for (int i = 0; i < 6; i++) {
        m[i] = number(argc, argv, 3 + i);
        b[i] = number(argc, argv, 9 + i);
        x[i] = number(argc, argv, 15 + i);
    }
    double begun = seconds();
    flow(0, half, m, b, x);
    for (long k = 0;;) {
        flow(1, half, m, b, x);
        flow(2, half, m, b, x);
        flow(3, half, m, b, x);
        flow(4, half, m, b, x);
        flow(5, h, m, b, x);
        flow(4, half, m, b, x);
        flow(3, half, m, b, x);
        flow(2, half, m, b, x);
        flow(1, half, m, b, x);
        if (++k == steps) break;
        flow(0, h, m, b, x);
    }
    flow(0, half, m, b, x);
    report(seconds() - begun, steps, x, 6);
    return 0;
}
