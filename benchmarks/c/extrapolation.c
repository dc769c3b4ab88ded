/* The reference: x' = field(x) in 113 bits by extrapolation of the modified midpoint rule to order 24, constant steps.

   extrapolation T STEPS x1 ... xn          prints every coordinate as two doubles, the leading and the rest

   The field comes from the file FIELD: "#define N n" and the body of field(). No quadmath library: sums and products. */
#include "program.h"
typedef __float128 real;

#include FIELD

#define COLUMNS 12

static void field(const real *restrict x, real *restrict dx) { FIELD_BODY }

/* 2 parts is the number of midpoint steps over H; the expansion of the result has even powers of the step alone. */
static void midpoints(const real *x, real H, int parts, real *end) {
    real before[N], now[N], slope[N], step = H / (2 * parts);
    field(x, slope);
    for (int i = 0; i < N; i++) before[i] = x[i], now[i] = x[i] + step * slope[i];
    for (int k = 1; k < 2 * parts; k++) {
        field(now, slope);
        for (int i = 0; i < N; i++) {
            real next = before[i] + 2 * step * slope[i];
            before[i] = now[i], now[i] = next;
        }
    }
    for (int i = 0; i < N; i++) end[i] = now[i];
}

static void extrapolate(real *x, real H) {
    static real row[COLUMNS][N];
    for (int m = 0; m < COLUMNS; m++) {
        real newest[N];
        midpoints(x, H, m + 1, newest);
        for (int j = m; j >= 0; j--) { /* Aitken and Neville: row[j] is the newest of its column, parts j + 1 ... m + 1 */
            for (int i = 0; i < N; i++) {
                if (j == m) { row[m][i] = newest[i]; continue; }
                real ratio = (real)(m + 1) / (j + 1);
                row[j][i] = row[j + 1][i] + (row[j + 1][i] - row[j][i]) / (ratio * ratio - 1);
            }
        }
    }
    for (int i = 0; i < N; i++) x[i] = row[0][i];
}

int main(int argc, char **argv) {
    real span = number(argc, argv, 1), x[N];
    long steps = (long)number(argc, argv, 2);
    for (int i = 0; i < N; i++) x[i] = number(argc, argv, 3 + i);
    for (long k = 0; k < steps; k++) extrapolate(x, span / steps);
    for (int i = 0; i < N; i++) {
        double leading = (double)x[i];
        printf("%.17g %.17g\n", leading, (double)(x[i] - leading));
    }
    return 0;
}
