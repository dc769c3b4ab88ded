/* A chain of N classical spins, H = sum over neighbours of a x x + b y y + c z z: all x, all y, all z, y, x.

   spin_chain STEPS h N a b c; spin k starts at (sin(1 + k), cos(2 k), sin(3 k)). Prints the sums of x, y and z and the
   first and the last spin. */
#include "program.h"

static inline void turn(double *s, long N, double tau, int first) {
    int i = (first + 1) % 3, j = (first + 2) % 3;
    for (long k = 0; k < N; k++) {
        double field = 0, sine, cosine;
        if (k > 0) field += s[3 * (k - 1) + first];
        if (k < N - 1) field += s[3 * (k + 1) + first];
        sincos(tau * field, &sine, &cosine);
        double a = s[3 * k + i], b = s[3 * k + j];
        s[3 * k + i] = cosine * a - sine * b;
        s[3 * k + j] = sine * a + cosine * b;
    }
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1), N = (long)number(argc, argv, 3);
    double h = number(argc, argv, 2), a = number(argc, argv, 4), b = number(argc, argv, 5), c = number(argc, argv, 6);
    double *s = malloc(3 * N * sizeof(double)), shown[9] = {0};
    for (long k = 0; k < N; k++) {
        s[3 * k] = sin(1 + k);
        s[3 * k + 1] = cos(2 * k);
        s[3 * k + 2] = sin(3 * k);
    }
    double begun = seconds();
    turn(s, N, 0.5 * h * a, 0);
    for (long k = 0;;) {
        turn(s, N, 0.5 * h * b, 1);
        turn(s, N, h * c, 2);
        turn(s, N, 0.5 * h * b, 1);
        if (++k == steps) break;
        turn(s, N, h * a, 0);
    }
    turn(s, N, 0.5 * h * a, 0);
    double elapsed = seconds() - begun;
    for (long k = 0; k < 3 * N; k++) shown[k % 3] += s[k];
    for (int i = 0; i < 3; i++) {
        shown[3 + i] = s[i];
        shown[6 + i] = s[3 * (N - 1) + i];
    }
    report(elapsed, steps, shown, 9);
    return 0;
}
