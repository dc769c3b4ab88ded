// Exponentials along the coadjoint orbit: x_new = exp(D_v) x with D_v x = sign J(x) v, and midpoint rules made of them.
#pragma once

#include "field/field.hpp"
#include "recording/watching.hpp"
#include "steps/exponential.hpp"

namespace coadjoint {

class OrbitExponential {
  public:
    int64_t iterations = 0, evaluations = 0;
    double residual = 0.0;

    OrbitExponential(const Field& field, const GroupField& group, const MemberConstants& constants)
        : field(field), group(group), constants(constants), n(field.size),
          exponential(std::max(n, group.size * group.size)), sums(std::max(n, group.size)), before(n), workspace(field) {}

    // Set out to exp(factor D_v) x; false if it is not defined, or too long.
    bool operator()(const double* v, double factor, const double* x, double* out) {
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                sum = fma(absolute(constants.number_at<double>(field.constant, q)), absolute(v[field.column[q]]), sum);
            sums[i] = factor * sum;
        }
        if (!exponential.measure(sums.data(), n, work_of(field))) return false;
        exponential.act(x, n, [&](const double* from, double part, double* to) {
            product(field, constants, from, v, factor * part, to, workspace);
        });
        for (int64_t i = 0; i < n; ++i) out[i] = x[i] + exponential.move[i];
        return true;
    }

    // Move the group element, which is transposed, by the same exponential; false as above.
    bool turn(const double* v, double* element) {
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t q = 0; q < group.entries; ++q)
            sums[group.column[q]] = fma(absolute(constants.number_at<double>(group.value, q)),
                                        absolute(v[group.element[q]]), sums[group.column[q]]);
        if (!exponential.measure(sums.data(), group.size, group.size * group.entries)) return false;
        exponential.act(element, group.size * group.size, [&](const double* from, double part, double* to) {
            group_slope(group, constants, v, from, part, to);
        }, group.size);
        for (int64_t i = 0; i < group.size * group.size; ++i) element[i] += exponential.move[i];
        return true;
    }

    // The midpoint rule: x = exp(D_v) x for the v that `direction(middle, v)` sets at the middle exp(D_v / 2) x. It
    // preserves every Casimir even if the iteration ends early.
    template <class Direction>
    int64_t midpoint(double* x, double* v, double* middle, const Direction& direction) {
        std::copy_n(x, n, middle);
        double last = std::numeric_limits<double>::infinity(), first = last, scale = 0.0;
        for (int64_t i = 0; i < n; ++i) scale += absolute(x[i]);
        for (iterations = 1; iterations <= MOST_MIDPOINTS; ++iterations) {
            ++evaluations;
            direction(middle, v);
            std::copy_n(middle, n, before.data());
            if (!(*this)(v, 0.5, x, middle)) return failed(v);
            residual = 0.0;
            for (int64_t i = 0; i < n; ++i) residual += absolute(middle[i] - before[i]);
            if (!(residual - residual == 0.0)) return failed(v);
            if (iterations == 1) first = residual;
            // Stop if corrections are round-off, and have stopped falling.
            if (residual == 0.0 || (residual >= 0.5 * last && residual <= NEAR_ROUND_OFF * scale)) break;
            if (residual > GROWN * (first + scale)) return NOT_CONVERGED;
            last = residual;
        }
        if (iterations > MOST_MIDPOINTS) return NOT_CONVERGED;
        return (*this)(v, 1.0, x, x) ? DONE : failed(v);
    }

    // The status after a failed exponential.
    int64_t failed(const double* v) const { return finite(n, v) ? UNDEFINED : OVERFLOWED; }

  private:
    const Field& field;
    const GroupField& group;
    const MemberConstants constants;
    const int64_t n;
    ExponentialAction exponential;
    std::vector<double> sums, before;
    FieldWorkspace<double> workspace;

    // Some ten iterations converge.
    static constexpr int64_t MOST_MIDPOINTS = 192;
    // Of the state: residuals that may stagnate as round-off, and multiple of the first one that diverges.
    static constexpr double NEAR_ROUND_OFF = 0x1p-40, GROWN = 0x1p20;
};

}  // namespace coadjoint
