/* Rigid molecules of three sites with Lennard-Jones forces between the first ones: splitting, or Fincham's leapfrog.

   molecules STEPS h N FILE KIND. The file has doubles: the inverse moments, the mass, the places of the sites, charges
   times the root of the Coulomb constant, 4 epsilon sigma^12 and 4 epsilon sigma^6; then for each molecule the attitude
   by rows, the angular momentum in its frame, the momentum, and the position. KIND 0: half steps of rotations about
   the axes 1, 2 and 3 and of straight paths, around one kick. KIND 1: Fincham's leapfrog for quaternions (1992), which
   are normalised in every step. Prints the first and last molecule, the mean of the energy over the first and the last
   tenth of the steps, and its root mean square deviation from its mean over all; without energies if h is negative. */
#include "program.h"

static double inverse[3], mass, site[3][4], charge[3], lj[2];
static double *place, *force; /* of sites, 9 for each molecule */

static double *read_all(const char *name) {
    FILE *file = fopen(name, "rb");
    if (!file) {
        fprintf(stderr, "%s cannot be read\n", name);
        exit(2);
    }
    fseek(file, 0, SEEK_END);
    long size = ftell(file);
    double *all = malloc(size);
    rewind(file);
    if (fread(all, 1, size, file) != (size_t)size) exit(2);
    fclose(file);
    return all;
}

/* Derivatives of the energy of all pairs by the sites; returns the energy if it is wanted. */
static inline double slopes(const double *x, long N, int wanted, double *restrict s, double *restrict f) {
    double total = 0;
    for (long m = 0; m < N; m++)
        for (int a = 0; a < 3; a++)
            for (int i = 0; i < 3; i++) {
                const double *A = x + 18 * m + 3 * i;
                s[9 * m + 3 * a + i] =
                    x[18 * m + 15 + i] + (A[0] * site[a][0] + A[1] * site[a][1] + A[2] * site[a][2]);
                f[9 * m + 3 * a + i] = 0;
            }
    for (long m = 0; m < N; m++)
        for (long n = m + 1; n < N; n++)
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) {
                    double *p = s + 9 * m + 3 * a, *q = s + 9 * n + 3 * b;
                    double *F = f + 9 * m + 3 * a, *G = f + 9 * n + 3 * b;
                    double dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2];
                    double u = 1 / (dx * dx + dy * dy + dz * dz), c = charge[a] * charge[b] * sqrt(u), g = -c * u;
                    if (wanted) total += c;
                    if (a + b == 0) {
                        double sixth = u * u * u;
                        g -= (12 * lj[0] * sixth - 6 * lj[1]) * sixth * u;
                        if (wanted) total += (lj[0] * sixth - lj[1]) * sixth;
                    }
                    F[0] += g * dx;
                    F[1] += g * dy;
                    F[2] += g * dz;
                    G[0] -= g * dx;
                    G[1] -= g * dy;
                    G[2] -= g * dz;
                }
    return total;
}

static double kinetic(const double *x, long N) {
    double total = 0;
    for (long m = 0; m < N; m++)
        for (int i = 0; i < 3; i++) {
            double L = x[18 * m + 9 + i], p = x[18 * m + 12 + i];
            total += 0.5 * (inverse[i] * L * L + p * p / mass);
        }
    return total;
}

/* The change of the momentum and of the angular momentum in space of molecule m in time h. */
static void impulse(const double *x, long m, double h, double *dp, double *dL) {
    for (int i = 0; i < 3; i++) dp[i] = dL[i] = 0;
    for (int a = 0; a < 3; a++) {
        double d[3], F[3];
        for (int i = 0; i < 3; i++) {
            d[i] = place[9 * m + 3 * a + i] - x[18 * m + 15 + i];
            F[i] = -h * force[9 * m + 3 * a + i];
            dp[i] += F[i];
        }
        for (int i = 0; i < 3; i++) dL[i] += d[(i + 1) % 3] * F[(i + 2) % 3] - d[(i + 2) % 3] * F[(i + 1) % 3];
    }
}

static void kick(double *x, long N, double h) {
    for (long m = 0; m < N; m++) {
        double dp[3], dL[3], *A = x + 18 * m;
        impulse(x, m, h, dp, dL);
        for (int i = 0; i < 3; i++) {
            x[18 * m + 12 + i] += dp[i];
            x[18 * m + 9 + i] += A[i] * dL[0] + A[3 + i] * dL[1] + A[6 + i] * dL[2];
        }
    }
}

static void turn(double *x, long N, double h, int axis) {
    int i = (axis + 1) % 3, j = (axis + 2) % 3;
    for (long m = 0; m < N; m++) {
        double sine, cosine;
        sincos(h * inverse[axis] * x[18 * m + 9 + axis], &sine, &cosine);
        for (int k = 0; k < 4; k++) {
            double *v = x + 18 * m + 3 * k, a = v[i], b = v[j];
            v[i] = cosine * a + sine * b;
            v[j] = cosine * b - sine * a;
        }
        if (axis == 0)
            for (int k = 0; k < 3; k++) x[18 * m + 15 + k] += h / mass * x[18 * m + 12 + k];
    }
}

static double split(double *x, long N, double h, int first, int wanted) {
    double energy = 0;
    turn(x, N, first ? 0.5 * h : h, 0);
    turn(x, N, 0.5 * h, 1);
    turn(x, N, 0.5 * h, 2);
    slopes(x, N, 0, place, force);
    kick(x, N, h);
    turn(x, N, 0.5 * h, 2);
    turn(x, N, 0.5 * h, 1);
    if (wanted) {
        turn(x, N, 0.5 * h, 0);
        energy = kinetic(x, N) + slopes(x, N, 1, place, force);
        turn(x, N, -0.5 * h, 0);
    }
    return energy;
}

static void matrix(const double *q, double *A) {
    double w = q[0], a = q[1], b = q[2], c = q[3];
    double all[9] = {w * w + a * a - b * b - c * c, 2 * (a * b - w * c), 2 * (a * c + w * b),
                     2 * (a * b + w * c), w * w - a * a + b * b - c * c, 2 * (b * c - w * a),
                     2 * (a * c - w * b), 2 * (b * c + w * a), w * w - a * a - b * b + c * c};
    memcpy(A, all, sizeof all);
}

/* The derivative of a quaternion for an angular momentum J in space. */
static void rate(const double *q, const double *J, double *dq) {
    double A[9], omega[3];
    matrix(q, A);
    for (int i = 0; i < 3; i++) omega[i] = inverse[i] * (A[i] * J[0] + A[3 + i] * J[1] + A[6 + i] * J[2]);
    dq[0] = -0.5 * (q[1] * omega[0] + q[2] * omega[1] + q[3] * omega[2]);
    dq[1] = 0.5 * (q[0] * omega[0] + q[2] * omega[2] - q[3] * omega[1]);
    dq[2] = 0.5 * (q[0] * omega[1] + q[3] * omega[0] - q[1] * omega[2]);
    dq[3] = 0.5 * (q[0] * omega[2] + q[1] * omega[1] - q[2] * omega[0]);
}

static void quaternion(const double *A, double *q) {
    double size[4] = {1 + A[0] + A[4] + A[8], 1 + A[0] - A[4] - A[8], 1 - A[0] + A[4] - A[8], 1 - A[0] - A[4] + A[8]};
    double table[4][4] = {{size[0], A[7] - A[5], A[2] - A[6], A[3] - A[1]},
                          {A[7] - A[5], size[1], A[1] + A[3], A[2] + A[6]},
                          {A[2] - A[6], A[1] + A[3], size[2], A[5] + A[7]},
                          {A[3] - A[1], A[2] + A[6], A[5] + A[7], size[3]}};
    int most = 0;
    for (int i = 1; i < 4; i++)
        if (size[i] > size[most]) most = i;
    for (int i = 0; i < 4; i++) q[i] = table[most][i] / (2 * sqrt(size[most]));
}

/* One step; q are quaternions, and J and p of x are half a step behind. Returns the energy at its begin. */
static double leap(double *x, double *q, double *J, long N, double h) {
    double energy = slopes(x, N, 1, place, force);
    for (long m = 0; m < N; m++) {
        double dp[3], dJ[3], now[3], dq[4], half[4], norm = 0, *A = x + 18 * m;
        impulse(x, m, h, dp, dJ);
        for (int i = 0; i < 3; i++) now[i] = J[3 * m + i] + 0.5 * dJ[i];
        for (int i = 0; i < 3; i++) {
            double p = x[18 * m + 12 + i] + 0.5 * dp[i], L = A[i] * now[0] + A[3 + i] * now[1] + A[6 + i] * now[2];
            energy += 0.5 * (inverse[i] * L * L + p * p / mass);
            J[3 * m + i] += dJ[i];
            x[18 * m + 12 + i] += dp[i];
            x[18 * m + 15 + i] += h / mass * x[18 * m + 12 + i];
        }
        rate(q + 4 * m, now, dq);
        for (int i = 0; i < 4; i++) half[i] = q[4 * m + i] + 0.5 * h * dq[i];
        rate(half, J + 3 * m, dq);
        for (int i = 0; i < 4; i++) q[4 * m + i] += h * dq[i];
        for (int i = 0; i < 4; i++) norm += q[4 * m + i] * q[4 * m + i];
        for (int i = 0; i < 4; i++) q[4 * m + i] /= sqrt(norm);
        matrix(q + 4 * m, A);
    }
    return energy;
}

int main(int argc, char **argv) {
    long steps = (long)number(argc, argv, 1), N = (long)number(argc, argv, 3), tenth = steps / 10 > 0 ? steps / 10 : 1;
    double h = fabs(number(argc, argv, 2)), sums[4] = {0}, shown[39] = {0};
    int wanted = number(argc, argv, 2) > 0, kind = (int)number(argc, argv, 5);
    double *all = read_all(argv[4]), *x = all + 18;
    memcpy(inverse, all, sizeof inverse);
    mass = all[3];
    for (int a = 0; a < 3; a++) memcpy(site[a], all + 4 + 3 * a, 3 * sizeof(double));
    memcpy(charge, all + 13, sizeof charge);
    memcpy(lj, all + 16, sizeof lj);
    place = malloc(9 * N * sizeof(double));
    force = malloc(9 * N * sizeof(double));
    double *q = malloc(4 * N * sizeof(double)), *J = malloc(3 * N * sizeof(double));
    double first = kinetic(x, N) + slopes(x, N, 1, place, force);
    if (kind) /* back by half a step */
        for (long m = 0; m < N; m++) {
            double dp[3], dJ[3], *A = x + 18 * m;
            quaternion(A, q + 4 * m);
            impulse(x, m, -0.5 * h, dp, dJ);
            for (int i = 0; i < 3; i++) {
                x[18 * m + 12 + i] += dp[i];
                J[3 * m + i] = A[3 * i] * A[9] + A[3 * i + 1] * A[10] + A[3 * i + 2] * A[11] + dJ[i];
            }
        }
    double begun = seconds();
    for (long k = 0; k < steps; k++) {
        double energy = (kind ? leap(x, q, J, N, h) : split(x, N, h, k == 0, wanted)) - first;
        if (k < tenth) sums[0] += energy / tenth;
        if (k >= steps - tenth) sums[1] += energy / tenth;
        sums[2] += energy / steps;
        sums[3] += energy * energy / steps;
    }
    if (!kind) turn(x, N, 0.5 * h, 0);
    double elapsed = seconds() - begun;
    memcpy(shown, x, 18 * sizeof(double));
    memcpy(shown + 18, x + 18 * (N - 1), 18 * sizeof(double));
    shown[36] = sums[0];
    shown[37] = sums[1];
    shown[38] = sqrt(sums[3] - sums[2] * sums[2]);
    report(elapsed, steps, shown, 39);
    return 0;
}
