/* The rigid body in another basis of so(3), order 2, three completed squares: H = sum_r (l_r.x)^2 d_r / 2.
   Part r moves by exp(theta D), theta = tau (d_r l_r).x, D dense with D^3 = -w^2 D: Rodrigues' formula.

   random_basis STEPS h x1 x2 x3, then for each part: d l (3), w, D (9), D^2 (9) */
#include "program.h"

typedef struct { double form[3], w, first, second, D[9], DD[9]; } Part; /* first = 1/w, second = 1/w^2 */

static inline __attribute__((always_inline)) void flow(const Part *p, double tau, double *x) {
    double s, c, a = x[0], b = x[1], d = x[2];
    sincos(p->w * (tau * (p->form[0] * a + p->form[1] * b + p->form[2] * d)), &s, &c);
    s *= p->first;
    c = (1.0 - c) * p->second;
    for (int i = 0; i < 3; i++) {
        const double *D = p->D + 3 * i, *DD = p->DD + 3 * i;
        x[i] += s * (D[0] * a + D[1] * b + D[2] * d) + c * (DD[0] * a + DD[1] * b + DD[2] * d);
    }
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1);
    double h = number(argc, argv, 2), half = 0.5 * h;
    double x[3] = {number(argc, argv, 3), number(argc, argv, 4), number(argc, argv, 5)};
    Part p[3];
    for (int r = 0, place = 6; r < 3; r++) {
        for (int i = 0; i < 3; i++) p[r].form[i] = number(argc, argv, place++);
        p[r].w = number(argc, argv, place++);
        p[r].first = 1.0 / p[r].w;
        p[r].second = p[r].first * p[r].first;
        for (int i = 0; i < 9; i++) p[r].D[i] = number(argc, argv, place++);
        for (int i = 0; i < 9; i++) p[r].DD[i] = number(argc, argv, place++);
    }
    double begun = seconds();
    flow(&p[0], half, x);
    for (long k = 0;;) {
        flow(&p[1], half, x);
        flow(&p[2], h, x);
        flow(&p[1], half, x);
        if (++k == steps) break;
        flow(&p[0], h, x);
    }
    flow(&p[0], half, x);
    report(seconds() - begun, steps, x, 3);
    return 0;
}
