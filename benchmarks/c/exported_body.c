/* Steps of a free body by the exported header and by the usual integrators: METHOD STEPS H, inverse moments, momentum.
   The final state is that of the momentum and of the quaternion. */
#include "program.h"
#include "coadjoint.h"

static void torque_free(const double *m, const double *w, double *change) {
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        change[i] = m[i] * (1 / m[j] - 1 / m[k]) * w[j] * w[k];
    }
}

/* q' = q (0, w)/2. */
static void turning(const double *q, const double *w, double *change) {
    change[0] = -0.5 * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]);
    change[1] = 0.5 * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]);
    change[2] = 0.5 * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]);
    change[3] = 0.5 * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]);
}

static void normalize(double *q) {
    const double size = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) q[i] *= size;
}

static void turn(double *q, const double *w, double h) {
    double change[4];
    turning(q, w, change);
    for (int i = 0; i < 4; i++) q[i] += h * change[i];
    normalize(q);
}

/* Semi-implicit Euler: the velocity first, with the gyroscopic term, and then the attitude with the new velocity. */
static void euler(const double *m, double h, double *w, double *q) {
    double change[3];
    torque_free(m, w, change);
    for (int i = 0; i < 3; i++) w[i] += h * change[i];
    turn(q, w, h);
}

/* The same with an implicit gyroscopic term, by one step of Newton's method, as game engines have it. */
static void implicit_euler(const double *m, double h, double *w, double *q) {
    double J[3][3], f[3], c[3][3], det;
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const double a = h * (1 / m[k] - 1 / m[j]);
        J[i][i] = 1 / m[i], J[i][j] = a * w[k], J[i][k] = a * w[j];
        f[i] = a * w[j] * w[k];
    }
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < 3; l++)
            c[i][l] = J[(i + 1) % 3][(l + 1) % 3] * J[(i + 2) % 3][(l + 2) % 3] -
                      J[(i + 1) % 3][(l + 2) % 3] * J[(i + 2) % 3][(l + 1) % 3];
    det = 1 / (J[0][0] * c[0][0] + J[0][1] * c[0][1] + J[0][2] * c[0][2]);
    for (int l = 0; l < 3; l++) w[l] -= det * (c[0][l] * f[0] + c[1][l] * f[1] + c[2][l] * f[2]);
    turn(q, w, h);
}

static void runge_kutta(const double *m, double h, double *w, double *q) {
    static const double along[] = {0.5, 0.5, 1.0, 0.0}, weight[] = {1 / 6.0, 1 / 3.0, 1 / 3.0, 1 / 6.0};
    double v[3], p[4], dw[3], dq[4], sum[7] = {0};
    memcpy(v, w, sizeof v), memcpy(p, q, sizeof p);
    for (int s = 0; s < 4; s++) {
        torque_free(m, v, dw), turning(p, v, dq);
        for (int i = 0; i < 3; i++) sum[i] += weight[s] * dw[i], v[i] = w[i] + h * along[s] * dw[i];
        for (int i = 0; i < 4; i++) sum[3 + i] += weight[s] * dq[i], p[i] = q[i] + h * along[s] * dq[i];
    }
    for (int i = 0; i < 3; i++) w[i] += h * sum[i];
    for (int i = 0; i < 4; i++) q[i] += h * sum[3 + i];
    normalize(q);
}

/* q exp(u/2), a rotation by the vector u, and the vector x in the turned axes. */
static void rotate(const double *u, double *x, double *q) {
    const double angle = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]), c = cos(angle / 2);
    const double s = angle > 0 ? sin(angle / 2) / angle : 0.5, v[3] = {s * u[0], s * u[1], s * u[2]};
    const double p[4] = {q[0], q[1], q[2], q[3]};
    double t[3];
    q[0] = p[0] * c - p[1] * v[0] - p[2] * v[1] - p[3] * v[2];
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        q[1 + i] = p[0] * v[i] + c * p[1 + i] + p[1 + j] * v[k] - p[1 + k] * v[j];
        t[i] = 2 * (x[j] * v[k] - x[k] * v[j]);
    }
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        x[i] += c * t[i] + t[j] * v[k] - t[k] * v[j];
    }
}

/* Buss (2000): a rotation by the mean velocity to second order, with its commutator; the momentum in space is kept. */
static void buss(const double *m, double h, double *x, double *q) {
    double w[3], dw[3], u[3];
    for (int i = 0; i < 3; i++) w[i] = m[i] * x[i];
    torque_free(m, w, dw);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        u[i] = h * (w[i] + h / 2 * dw[i] + h * h / 12 * (dw[j] * w[k] - dw[k] * w[j]));
    }
    rotate(u, x, q);
    normalize(q);
}

/* NO_SQUISH of Miller et al. (2002): rotations about the axes, with the momentum about each. */
static void no_squish(const double *m, double h, double *x, double *q) {
    static const int axes[] = {2, 1, 0, 1, 2};
    for (int part = 0; part < 5; part++) {
        const int i = axes[part], j = (i + 1) % 3, k = (i + 2) % 3;
        const double angle = (part == 2 ? h : h / 2) * m[i] * x[i], c = cos(angle / 2), s = sin(angle / 2);
        const double C = c * c - s * s, S = 2 * s * c, y = x[j], p = q[0], r = q[1 + j];
        x[j] = C * y + S * x[k], x[k] = C * x[k] - S * y;
        q[0] = c * p - s * q[1 + i], q[1 + i] = c * q[1 + i] + s * p;
        q[1 + j] = c * r + s * q[1 + k], q[1 + k] = c * q[1 + k] - s * r;
    }
}

int main(int argc, char **argv) {
    const int method = (int)number(argc, argv, 1);
    const long steps = (long)number(argc, argv, 2);
    const double h = number(argc, argv, 3);
    double m[3], x[7] = {0, 0, 0, 1}, A[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, J[9], G[9], begun;
    float mf[3], xf[7] = {0, 0, 0, 1};
    for (int i = 0; i < 3; i++) mf[i] = (float)(m[i] = number(argc, argv, 4 + i));
    for (int i = 0; i < 3; i++) xf[i] = (float)(x[i] = number(argc, argv, 7 + i));
    const int of_velocities = method >= 5 && method <= 7;
    if (of_velocities)
        for (int i = 0; i < 3; i++) x[i] *= m[i];
    begun = seconds();
    for (long n = 0; n < steps; n++) {
        switch (method) {
        case 0: coadjoint_body_step(m, h, x, x + 3); break;
        case 1: coadjoint_body_stepf(mf, (float)h, xf, xf + 3); break;
        case 2: coadjoint_body_step_matrix(m, h, x, A); break;
        case 3: coadjoint_body_jacobian(m, h, x, x + 3, J, G), x[0] += 0 * J[1] * G[1]; break;
        case 5: euler(m, h, x, x + 3); break;
        case 6: implicit_euler(m, h, x, x + 3); break;
        case 7: runge_kutta(m, h, x, x + 3); break;
        case 8: buss(m, h, x, x + 3); break;
        case 9: no_squish(m, h, x, x + 3); break;
        }
    }
    begun = seconds() - begun;
    if (of_velocities)
        for (int i = 0; i < 3; i++) x[i] /= m[i];
    if (method == 1)
        for (int i = 0; i < 7; i++) x[i] = xf[i];
    report(begun, steps, x, 7);
    return 0;
}
