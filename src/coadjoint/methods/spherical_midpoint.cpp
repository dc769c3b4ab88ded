// The spherical midpoint method: x += h f(y), where y is the midpoint of the step, each spin rescaled to its length in
// x.
#include <algorithm>
#include <array>
#include <cmath>

#include "stages/lagged_functions.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

typedef MemberLanes<double> Layout;
constexpr double HALF = 0.5, WHOLE = 1.0;

struct SphericalMidpoint final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const Field& field;
    const int64_t n;
    FieldWorkspace<double> workspace;
    Unknowns<Layout> y;
    std::vector<std::array<int64_t, 3>> spins;
    std::vector<double> u, squares;
    AlignedArray<double> point;
    LaggedFunctions<Layout> lagged;

    SphericalMidpoint(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), field(tables.field), n(field.size), workspace(field), y(1, n, &HALF),
          u(n), point(n), lagged(field, constants, 1, workspace) {
        // The row of a coordinate has the two others of its spin.
        for (int64_t i = 0; i < n; ++i) {
            const uint32_t q = field.first[i];
            if (q == field.first[i + 1]) continue;
            const int64_t j = field.column[q], k = field.state[q];
            if (i < std::min(j, k)) spins.push_back({i, std::min(j, k), std::max(j, k)});
        }
        squares.resize(spins.size());
        y.work += work_of(field) + 4 * n;
        work = 8 * y.work;
    }

    static double square(const double* x, const std::array<int64_t, 3>& spin) {
        return fma(x[spin[0]], x[spin[0]], fma(x[spin[1]], x[spin[1]], x[spin[2]] * x[spin[2]]));
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        y.base = x;
        y.error = dx;
        y.start_at_base();
        for (size_t s = 0; s < spins.size(); ++s) squares[s] = square(x, spins[s]);
        const double middle = fma(0.5, h, t);
        bool reusing = lagged.exist();
        const auto evaluate = [&] {
            std::copy_n(y.points.at, n, point.at);
            for (size_t s = 0; s < spins.size(); ++s) {
                if (squares[s] == 0.0) continue;
                const double stretch = std::sqrt(squares[s] / square(point.at, spins[s]));
                for (int64_t i : spins[s]) point.at[i] *= stretch;
            }
            if (reusing) lagged.decide(point.at);
            slope_at(field, constants, point.at, middle, h, u.data(), y.slopes.at, workspace);
            if (reusing) y.rounding = lagged.round_off(field, constants, point.at, u.data());
        };
        // Half of h at the midpoint, which the projection stretches by at most two if spins turn by less than 120 degrees.
        if (reusing) lagged.begin(field, constants, x, h);
        Outcome<double> outcome;
        double passed = 0.0;
        do {
            outcome = settle(y, true, evaluate, [](bool, bool) {});
            passed += outcome.iterations;
        } while (outcome.settled && reusing && lagged.must_evaluate());
        if (reusing) lagged.end();
        reusing = false;
        outcome.settled = outcome.settled || at_round_off(y, evaluate);
        evaluations = iterations = int64_t(passed);
        residual = outcome.residual;
        if (!outcome.settled) return residual == residual ? NOT_CONVERGED : OVERFLOWED;
        add_slopes<Layout>(&WHOLE, 1, y.slopes.at, n, x, dx);
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(spherical_midpoint, SphericalMidpoint)

}  // namespace coadjoint
