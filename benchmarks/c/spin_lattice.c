/* Classical spins on any graph, H = sum over edges of J (a x x + b y y + c z z): all x, all y, all z, y, x.

   spin_lattice STEPS h N a b c FILE KIND; spin k starts at (sin(1 + k), cos(2 k), sin(3 k)). The file has N + 1 starts
   and the neighbours of all sites, 32 bits each, then a coupling J for each neighbour, doubles. KIND 0: couplings are
   read; 1: all of them are the first one. Prints the sums of x, y and z and the first and the last spin. Compiled with
   OpenMP, its threads share the sites. */
#include "program.h"
#include <stdint.h>

static const uint32_t *start, *neighbour;
static const double *coupling;

static inline void rotate(double *s, long k, double angle, int first) {
    int i = (first + 1) % 3, j = (first + 2) % 3;
    double sine, cosine, a = s[3 * k + i], b = s[3 * k + j];
    sincos(angle, &sine, &cosine);
    s[3 * k + i] = cosine * a - sine * b;
    s[3 * k + j] = sine * a + cosine * b;
}

static inline void turn(double *s, long N, double tau, int first, int kind) {
    if (kind) tau *= coupling[0];
#pragma omp parallel for schedule(static)
    for (long k = 0; k < N; k++) {
        double field = 0;
        if (kind)
            for (uint32_t e = start[k]; e < start[k + 1]; e++) field += s[3 * (long)neighbour[e] + first];
        else
            for (uint32_t e = start[k]; e < start[k + 1]; e++)
                field += coupling[e] * s[3 * (long)neighbour[e] + first];
        rotate(s, k, tau * field, first);
    }
}

static void *read_all(const char *name) {
    FILE *file = fopen(name, "rb");
    if (!file) {
        fprintf(stderr, "%s cannot be read\n", name);
        exit(2);
    }
    fseek(file, 0, SEEK_END);
    long size = ftell(file);
    void *all = malloc(size);
    rewind(file);
    if (fread(all, 1, size, file) != (size_t)size) exit(2);
    fclose(file);
    return all;
}

static inline void move(double *s, long N, long steps, double h, double a, double b, double c, int kind) {
    turn(s, N, 0.5 * h * a, 0, kind);
    for (long k = 0;;) {
        turn(s, N, 0.5 * h * b, 1, kind);
        turn(s, N, h * c, 2, kind);
        turn(s, N, 0.5 * h * b, 1, kind);
        if (++k == steps) break;
        turn(s, N, h * a, 0, kind);
    }
    turn(s, N, 0.5 * h * a, 0, kind);
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1), N = (long)number(argc, argv, 3);
    double h = number(argc, argv, 2), a = number(argc, argv, 4), b = number(argc, argv, 5), c = number(argc, argv, 6);
    int kind = (int)number(argc, argv, 8);
    const char *all = read_all(argv[7]);
    start = (const uint32_t *)all;
    neighbour = start + N + 1;
    long before = 4 * (N + 1 + (long)start[N]);
    double *own = malloc(8 * (long)start[N] + 8);
    memcpy(own, all + before, 8 * (long)start[N]);
    coupling = own;
    double *s = malloc(3 * N * sizeof(double)), shown[9] = {0};
    for (long k = 0; k < N; k++) {
        s[3 * k] = sin(1 + k);
        s[3 * k + 1] = cos(2 * k);
        s[3 * k + 2] = sin(3 * k);
    }
    double begun = seconds();
    if (kind)
        move(s, N, steps, h, a, b, c, 1);
    else
        move(s, N, steps, h, a, b, c, 0);
    double elapsed = seconds() - begun;
    for (long k = 0; k < 3 * N; k++) shown[k % 3] += s[k];
    for (int i = 0; i < 3; i++) {
        shown[3 + i] = s[i];
        shown[6 + i] = s[3 * (N - 1) + i];
    }
    report(elapsed, steps, shown, 9);
    return 0;
}
