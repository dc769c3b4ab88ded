/* The rotor on so(n) with diagonal M: X1 X2 ... Xm ... X2 X1, one rotation for each pair i < j.

   so_n STEPS h n, with m_ij = 1 + 1/(1 + i + 2 j) and x_ij = sin(1 + i + 3 j); prints the x_ij. The whole matrix is
   stored, so that rows are turned by vectors; columns follow by antisymmetry. */
#include "program.h"

static inline void turn(double angle, double *X, int n, int i, int j) {
    double s, c;
    sincos(angle, &s, &c);
    double *restrict a = X + i * n, *restrict b = X + j * n, kept = a[j];
    for (int k = 0; k < n; k++) {
        double old = a[k];
        a[k] = c * old - s * b[k];
        b[k] = s * old + c * b[k];
    }
    a[i] = b[j] = 0;
    a[j] = kept;
    b[i] = -kept;
    for (int k = 0; k < n; k++) {
        X[k * n + i] = -a[k];
        X[k * n + j] = -b[k];
    }
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1);
    double h = number(argc, argv, 2);
    int n = (int)number(argc, argv, 3), pairs = n * (n - 1) / 2, p = 0;
    double *X = calloc(n * n, sizeof(double)), *m = malloc(pairs * sizeof(double));
    int *row = malloc(pairs * sizeof(int)), *column = malloc(pairs * sizeof(int));
    for (int i = 0; i < n; i++)
        for (int j = i + 1; j < n; j++, p++) {
            row[p] = i;
            column[p] = j;
            m[p] = 1 + 1.0 / (1 + i + 2 * j);
            X[i * n + j] = sin(1 + i + 3 * j);
            X[j * n + i] = -X[i * n + j];
        }
    double begun = seconds();
#define TURN(p, tau) turn((tau) * m[p] * X[row[p] * n + column[p]], X, n, row[p], column[p])
    TURN(0, 0.5 * h);
    for (long k = 0;;) {
        for (p = 1; p < pairs - 1; p++) TURN(p, 0.5 * h);
        TURN(pairs - 1, h);
        for (p = pairs - 2; p > 0; p--) TURN(p, 0.5 * h);
        if (++k == steps) break;
        TURN(0, h);
    }
    TURN(0, 0.5 * h);
    double elapsed = seconds() - begun;
    double *x = malloc(pairs * sizeof(double));
    for (p = 0; p < pairs; p++) x[p] = X[row[p] * n + column[p]];
    report(elapsed, steps, x, pairs);
    return 0;
}
