/* The free rigid body with its attitude: every rotation also turns the rows of A, so that A x is constant.

   rigid_body_attitude STEPS h m1 m2 m3 x1 x2 x3; prints x, then A row by row. */
#include "program.h"

typedef struct { double x[3], A[9]; } State;

/* i and j are literals: after inlining every index is a constant. */
static inline __attribute__((always_inline)) void rotate(double angle, State *y, int i, int j) {
    double s, c;
    sincos(angle, &s, &c);
    double old = y->x[i];
    y->x[i] = c * old - s * y->x[j];
    y->x[j] = s * old + c * y->x[j];
    for (int r = 0; r < 9; r += 3) {
        old = y->A[r + i];
        y->A[r + i] = c * old - s * y->A[r + j];
        y->A[r + j] = s * old + c * y->A[r + j];
    }
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1);
    double h = number(argc, argv, 2);
    double h1 = h * number(argc, argv, 3), h2 = h * number(argc, argv, 4), h3 = h * number(argc, argv, 5);
    State y = {{number(argc, argv, 6), number(argc, argv, 7), number(argc, argv, 8)}, {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    double begun = seconds();
    rotate(0.5 * h1 * y.x[0], &y, 1, 2);
    for (long k = 0;;) {
        rotate(0.5 * h2 * y.x[1], &y, 2, 0);
        rotate(h3 * y.x[2], &y, 0, 1);
        rotate(0.5 * h2 * y.x[1], &y, 2, 0);
        if (++k == steps) break;
        rotate(h1 * y.x[0], &y, 1, 2);
    }
    rotate(0.5 * h1 * y.x[0], &y, 1, 2);
    double elapsed = seconds() - begun, all[12];
    memcpy(all, y.x, sizeof y.x);
    memcpy(all + 3, y.A, sizeof y.A);
    report(elapsed, steps, all, 12);
    return 0;
}
