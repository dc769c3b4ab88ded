/* The free rigid body x' = (M x) cross x, order 2, parts 1 2 3: rotations about the axes, outer halves merged.

   rigid_body STEPS h m1 m2 m3 x1 x2 x3 */
#include "program.h"

static inline void rotate(double angle, double *a, double *b) {
    double s, c;
    sincos(angle, &s, &c);
    double old = *a;
    *a = c * old - s * *b;
    *b = s * old + c * *b;
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1);
    double h = number(argc, argv, 2);
    double h1 = h * number(argc, argv, 3), h2 = h * number(argc, argv, 4), h3 = h * number(argc, argv, 5);
    double x[3] = {number(argc, argv, 6), number(argc, argv, 7), number(argc, argv, 8)};
    double begun = seconds();
    rotate(0.5 * h1 * x[0], &x[1], &x[2]);
    for (long k = 0;;) {
        rotate(0.5 * h2 * x[1], &x[2], &x[0]);
        rotate(h3 * x[2], &x[0], &x[1]);
        rotate(0.5 * h2 * x[1], &x[2], &x[0]);
        if (++k == steps) break;
        rotate(h1 * x[0], &x[1], &x[2]);
    }
    rotate(0.5 * h1 * x[0], &x[1], &x[2]);
    report(seconds() - begun, steps, x, 3);
    return 0;
}
