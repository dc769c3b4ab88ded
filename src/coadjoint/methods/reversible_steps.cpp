// Steps of another loop with a reversible, adaptive length: E. Hairer, G. Soederlind, Explicit, time reversible,
// adaptive step size control, SIAM J. Sci. Comput. 26 (2005) 1838. With the speed Q of the motion, a step has the
// length stride / rho, and rho increases by stride * Q' / Q from step to step, by half of it at the start.
#include "field/derivatives.hpp"
#include "steps/inner_step.hpp"
#include "steps/own_steps.hpp"

namespace coadjoint {

namespace {

enum class Speed { GENERATOR, GIVEN };

template <Speed kind>
struct ReversibleSteps final : OwnSteps {
    const Field& field;
    const Watch& speed_function;
    const MemberConstants constants;
    const double stride;
    InnerStep inner;
    FieldWorkspace<double> workspace;
    DerivativeWorkspace<double> derivatives;
    std::vector<double> u, f, change, rising, rows, arguments, calls;

    // `whole`: the addresses of the inner loop; the coefficient is the stride, and the watched function the polynomial
    // of the speed. The memory is rho.
    ReversibleSteps(const StepTables& tables, const MemberConstants& constants)
        : OwnSteps(tables.field.size, tables.group.size * tables.group.size, 1), field(tables.field),
          speed_function(tables.restored), constants(constants), stride(tables.coefficients[0]),
          inner(tables.whole, size, square), workspace(field), derivatives(field), u(size), f(size), change(size),
          rising(size), rows(speed_function.terms.row[speed_function.terms.size] + 1),
          arguments(speed_function.longest + 1), calls(2 * speed_function.longest + 2) {
        work = 16 * work_of(field);
    }

  private:
    int64_t begin(const Base& base, double t0) override {
        double rate, speed;
        measure(base.x, t0, speed, rate);
        base.further[0] = speed + 0.5 * stride * (base.length < 0.0 ? -rate : rate);
        return set_length(base, speed);
    }

    int64_t propose(const Base& base, double t0) override {
        double rate, speed;
        measure(base.x, t0 + base.since, speed, rate);
        base.further[0] += stride * (base.length < 0.0 ? -rate : rate);
        return set_length(base, speed);
    }

    int64_t set_length(const Base& base, double speed) {
        const double rho = base.further[0];
        residual = rho;
        if (!(rho - rho == 0.0)) return OVERFLOWED;
        if (!(rho > 0.0 && speed > 0.0)) return UNDEFINED;
        base.length = std::copysign(stride / rho, base.length);
        return DONE;
    }

    int64_t part(const Base& base, double t0, double time, double* x, double* dx, double* group, double*) override {
        std::copy_n(base.x, size, x);
        std::copy_n(base.group, square, group);
        std::fill_n(dx, size, 0.0);
        return time == 0.0 ? int64_t(DONE) : move(x, group, t0 + base.since, time);
    }

    int64_t finish(const Base& base, double t0) override { return move(base.x, base.group, t0 + base.since, base.length); }

    int64_t move(double* x, double* group, double t, double length) {
        const int64_t status = inner.take(x, group, t, length);
        evaluations += inner.evaluations;
        iterations += inner.iterations;
        residual = inner.residual;
        return status;
    }

    // The speed Q at a state, and its relative rate of change Q' / Q along the motion.
    void measure(const double* x, double t, double& speed, double& rate) {
        slope_at(field, constants, x, t, 1.0, u.data(), f.data(), workspace);
        if constexpr (kind == Speed::GIVEN) {
            speed = value_at(x, t);
            rate = inner_product(rising.data(), f.data()) / speed;
        } else {
            hessian_times(field, constants, x, f.data(), t, change.data(), derivatives);
            const double square = value_at(u.data(), t);
            speed = square_root(square);
            rate = 0.5 * inner_product(rising.data(), change.data()) / square;
        }
    }

    // The polynomial at a point; its gradient is stored in `rising`.
    double value_at(const double* y, double t) {
        const Terms& terms = speed_function.terms;
        std::fill(rising.begin(), rising.end(), 0.0);
        for (int64_t k = 0; k < terms.size; ++k) {
            const int64_t first = terms.row[k];
            gradient_rows(terms, constants, speed_function.addresses, k, y, t, rows.data(), first, arguments.data(),
                          calls.data());
            for (int64_t row = first; row < terms.row[k + 1]; ++row) rising[terms.target[row]] += rows[row - first];
        }
        return value_of(speed_function, constants, 0, y, t, arguments.data(), calls.data());
    }

    double inner_product(const double* a, const double* b) const {
        double total = 0.0;
        for (int64_t i = 0; i < size; ++i) total = fma(a[i], b[i], total);
        return total;
    }
};

}  // namespace

STEP_SCHEME(reversible_generator, ReversibleSteps<Speed::GENERATOR>)
STEP_SCHEME(reversible_given, ReversibleSteps<Speed::GIVEN>)

}  // namespace coadjoint
