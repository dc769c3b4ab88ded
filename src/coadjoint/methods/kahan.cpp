// Kahan's method: (1 - h/2 f'(x)) d = h f(x), x += d. In many dimensions by GMRES, with corrections until they no
// longer fall.
#include "field/derivatives.hpp"
#include "numbers/krylov.hpp"
#include "numbers/linear_solve.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

constexpr int64_t MOST_SOLUTIONS = 8;
constexpr double SETTLED = 0x1p-40;  // of the increment: below it, corrections that no longer fall are round-off

struct Kahan final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const Field& field;
    const int64_t n;
    const bool dense;
    FieldWorkspace<double> workspace;
    DerivativeWorkspace<double> derivatives;
    std::vector<double> u, f, move, point, image, change, matrix, pivots;

    Kahan(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), field(tables.field), n(field.size), dense(n <= LARGEST_DENSE),
          workspace(field), derivatives(field), u(n), f(n), move(n), point(n), image(n), change(n),
          matrix(dense ? n * n : 0), pivots(n) {
        work = (dense ? n : RESTART) * (work_of(field) + n * (dense ? n : RESTART));
    }

    // Set out = f'(x) v. If J is a function, the difference is exact, since f is quadratic.
    void derivative(const double* x, const double* v, double t, double* out) {
        if (!field.nonlinear) return jacobian_times(field, constants, x, u.data(), v, t, 1.0, out, derivatives);
        double large = 0.0, wide = 0.0;
        for (int64_t i = 0; i < n; ++i) large = larger(large, absolute(x[i])), wide = larger(wide, absolute(v[i]));
        const double step = large > 0.0 && wide > 0.0 ? large / wide : 1.0;
        std::fill_n(out, n, 0.0);
        for (double side : {step, -step}) {
            for (int64_t i = 0; i < n; ++i) point[i] = fma(side, v[i], x[i]);
            slope_at(field, constants, point.data(), t, 0.5 / side, u.data(), change.data(), workspace);
            for (int64_t i = 0; i < n; ++i) out[i] += change[i];
        }
    }

    int64_t solve_dense(const double* x, double t, double h) {
        std::vector<double>& unit = image;
        std::fill(unit.begin(), unit.end(), 0.0);
        for (int64_t j = 0; j < n; ++j) {
            unit[j] = 1.0;
            derivative(x, unit.data(), t, move.data());
            unit[j] = 0.0;
            for (int64_t i = 0; i < n; ++i) matrix[i * n + j] = fma(-0.5 * h, move[i], i == j ? 1.0 : 0.0);
        }
        std::copy(f.begin(), f.end(), move.begin());
        if (!factorize(matrix.data(), n, pivots.data())) return UNDEFINED;
        substitute(matrix.data(), n, pivots.data(), move.data(), 1);
        return DONE;
    }

    int64_t solve_large(const double* x, double t, double h) {
        Krylov krylov(n);
        const auto operate = [&](const double* v, double* out) {
            derivative(x, v, t, out);
            for (int64_t i = 0; i < n; ++i) out[i] = fma(-0.5 * h, out[i], v[i]);
        };
        std::vector<double> rest(f);
        double before = std::numeric_limits<double>::infinity();
        std::fill(move.begin(), move.end(), 0.0);
        for (iterations = 1; iterations <= MOST_SOLUTIONS; ++iterations) {
            if (!krylov.solve(rest.data(), operate)) return NOT_CONVERGED;
            double size = residual = 0.0;
            for (int64_t i = 0; i < n; ++i) {
                move[i] += rest[i];
                residual = larger(residual, absolute(rest[i])), size = larger(size, absolute(move[i]));
            }
            if (residual == 0.0 || !(residual < 0.5 * before)) return residual <= SETTLED * size ? DONE : NOT_CONVERGED;
            before = residual;
            operate(move.data(), image.data());
            for (int64_t i = 0; i < n; ++i) rest[i] = f[i] - image[i];
        }
        return NOT_CONVERGED;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        slope_at(field, constants, x, t, h, u.data(), f.data(), workspace);
        evaluations = 2;
        residual = std::numeric_limits<double>::quiet_NaN();
        if (!finite(n, f.data())) return OVERFLOWED;
        const int64_t status = dense ? solve_dense(x, t, h) : solve_large(x, t, h);
        if (status != DONE) return status;
        for (int64_t i = 0; i < n; ++i) {
            const double old = x[i];
            two_sum(old, dx[i] + move[i], x[i], dx[i]);
        }
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(kahan, Kahan)

}  // namespace coadjoint
