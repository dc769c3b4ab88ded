// The Taylor series of the motion over steps of lengths determined by the series, and a projection to the level set of
// energy and Casimirs; with the group element.
#include "steps/compiled_series.hpp"
#include "steps/dense_series.hpp"
#include "steps/own_steps.hpp"
#include "steps/step_length.hpp"

namespace coadjoint {

namespace {

constexpr int64_t ATTEMPTS = 24;          // to find a time unit in which the terms are finite
constexpr double TINY = 0x1p-900;         // smaller terms have lost digits
constexpr double FAR = 64.0, ENDS = 900.0;  // logarithms: from one attempt to the next, and of the longest such time

template <int W>
struct TaylorVariable final : OwnSteps {
    typedef Lanes<W> Row;
    const int64_t blocks;
    Series<W> series;
    Projection<W, MemberConstants> projection;
    const StepLength rule;
    AlignedArray<Row> state, remainder, expanded;
    double scaled = 0.0;       // `series` holds the terms of `expanded` in powers of this time; 0 if it holds none
    const std::unique_ptr<GroupMotion> group;
    std::vector<double> gradients;
    std::vector<double> unchanged_targets;  // for evaluations that leave the memory of the projection unchanged

    // Memory: the time unit of the terms, a power of two with the sign of the steps; the largest size of a state so
    // far; and the memory of the projection.
    TaylorVariable(const StepTables& tables, const MemberConstants& constants)
        : OwnSteps(tables.field.size, tables.group.size * tables.group.size, 2 + 2 * tables.restored.size),
          blocks(blocks_of<W>(tables.field.size)), series(tables.field, constants, tables.whole[0]),
          projection(tables.restored, constants, tables.field.size), rule(tables.whole[0], tables.coefficients[0]),
          state(blocks), remainder(blocks), expanded(blocks), group(group_motion(tables.group, constants, series)),
          gradients(group ? known_gradients(series) * blocks * W : 0), unchanged_targets(projection.memory_size()) {
        work = series.work() + 16 * tables.field.size + (group ? group->work() : 0);
    }

  private:
    static double& scale_of(const Base& base) { return base.further[0]; }
    static double& largest_of(const Base& base) { return base.further[1]; }
    static double* targets_of(const Base& base) { return base.further + 2; }

    int64_t begin(const Base& base, double t0) override {
        read(base);
        projection.begin(state.at, targets_of(base));
        base.length = std::copysign(1.0, base.length);
        return propose(base, t0);
    }

    int64_t propose(const Base& base, double) override {
        read(base);
        double size = 0.0;
        for (int64_t b = 0; b < blocks; ++b) size += sum_of_lanes(absolute(state.at[b]));
        largest_of(base) = larger(largest_of(base), size);
        // The terms of the next step are about as large as those of the last.
        double exponent = larger(-ENDS, smaller(exponent_of(std::fabs(base.length)), ENDS));
        evaluations += series.order;
        bool enlarged = false;
        for (int64_t attempt = 0; attempt < ATTEMPTS; ++attempt) {
            scale_of(base) = std::copysign(whole_power_of_two(exponent), base.length);
            expand(scale_of(base));
            const auto sizes = rule.template sizes<Row>([this](int64_t k) { return sizes_in_term(series, k); });
            // If a term overflows, all following ones do, or their sum is NaN.
            const bool overflows = !(sizes.sum - sizes.sum == 0.0);
            const bool lost = !overflows && !enlarged && !(sizes.largest > TINY * largest_of(base));
            const double first = overflows || lost ? sum_of_lanes(sizes_in_term(series, 1)) : 0.0;
            const double faster = first > 0.0 ? std::floor(near_log2(first) - near_log2(size)) : 0.0;
            if (overflows) {
                exponent -= first - first == 0.0 && faster > 0.0 ? faster : FAR;
                if (exponent < -ENDS) break;
            } else if (lost && faster < 0.0) {
                exponent = smaller(exponent - faster, ENDS);
                enlarged = true;
            } else {
                base.length = scale_of(base) * near_power_of_two(rule.logarithm(largest_of(base), sizes));
                return DONE;
            }
        }
        scaled = 0.0;
        residual = std::numeric_limits<double>::quiet_NaN();
        return OVERFLOWED;
    }

    int64_t part(const Base& base, double, double time, double* x, double* dx, double* g, double* dg) override {
        std::copy_n(targets_of(base), unchanged_targets.size(), unchanged_targets.data());
        std::copy_n(base.group, square, g), std::copy_n(base.dgroup, square, dg);
        const int64_t status = move(base, time, unchanged_targets.data(), g, dg);
        write(x, dx);
        return status;
    }

    int64_t finish(const Base& base, double) override {
        const int64_t status = move(base, base.length, targets_of(base), base.group, base.dgroup);
        iterations += projection.corrections;
        write(base.x, base.dx);
        return status;
    }

    // From the base on, in `state` and `remainder`.
    int64_t move(const Base& base, double time, double* targets, double* g, double* dg) {
        read(base);
        bool same = scaled == scale_of(base);
        for (int64_t b = 0; b < blocks && same; ++b) same = all(state.at[b] == expanded.at[b]);
        if (!same) expand(scale_of(base));
        // The inverse of a power of two, which does not wait for the time.
        const double s = time * (1.0 / scaled);
        for (int64_t b = 0; b < blocks; ++b) add_to(state.at[b], remainder.at[b], increment_at(series, b, s));
        projection.corrections = 0;
        const bool restored = unchanged_targets.empty() || projection.restore(state.at, remainder.at, blocks, targets);
        residual = projection.residual;
        if (!restored) return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
        return group ? rotate(s, time, g, dg) : DONE;
    }

    // The gradient along the step is a polynomial in the time relative to `time`.
    int64_t rotate(double s, double time, double* g, double* dg) {
        if (!finite(size, reinterpret_cast<const double*>(state.at))) return OVERFLOWED;
        gradients_along(series, gradients.data());
        const int64_t stride = blocks * W, count = known_gradients(series);
        double power = 1.0;
        for (int64_t k = 0; k < count; ++k, power *= s)
            for (int64_t i = 0; i < stride; ++i) gradients[k * stride + i] *= power;
        if (!group->rotate(gradients.data(), count, stride, time, g, dg)) return NOT_CONVERGED;
        return finite(square, g) ? DONE : OVERFLOWED;
    }

    void expand(double scale) {
        for (int64_t b = 0; b < blocks; ++b) series.x.at[b] = expanded.at[b] = state.at[b];
        series.expand(scaled = scale);
    }

    void read(const Base& base) {
        if (held) return;
        held = true;
        double *to = reinterpret_cast<double*>(state.at), *left = reinterpret_cast<double*>(remainder.at);
        std::copy_n(base.x, size, to), std::copy_n(base.dx, size, left);
    }

    void write(double* x, double* dx) const {
        const double *from = reinterpret_cast<const double*>(state.at),
                     *left = reinterpret_cast<const double*>(remainder.at);
        std::copy_n(from, size, x), std::copy_n(left, size, dx);
    }
};

}  // namespace

EXPORT StepScheme* taylor_variable_step(const StepTables& tables, const MemberConstants& constants) {
    if (tables.field.size <= 4) return new TaylorVariable<4>(tables, constants);
    return new TaylorVariable<8>(tables, constants);
}

}  // namespace coadjoint
