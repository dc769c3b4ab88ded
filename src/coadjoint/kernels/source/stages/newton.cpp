// Corrections of stages by linear systems.
#include "stages/newton.hpp"

#include <limits>

#include "field/derivatives.hpp"
#include "numbers/banded.hpp"
#include "numbers/krylov.hpp"
#include "numbers/linear_solve.hpp"
#include "stages/runge_kutta.hpp"

namespace coadjoint {

template bool factorize(double*, int64_t, double*);
template void substitute(const double*, int64_t, const double*, double*, int64_t);

// Newton's method takes some five, with old factors some twenty.
constexpr int64_t MOST_CORRECTIONS = 50;
constexpr double SLUGGISH = 0.25;  // ratio of corrections above which the factors are renewed
constexpr double SETTLING = 0x1p-40;  // of the size of the stages: below it stagnating corrections are round-off
constexpr double OWN = 0x1p-47;       // of a component and its move: larger corrections that fall are no round-off
constexpr int64_t LATE = 8;            // corrections after which the factors are renewed for small components
constexpr int64_t SUSPECT = 3;        // larger corrections in a row that do not fall: tested for round-off

// Correct the points as long as each correction is less than half of the previous one: `solve` turns the defect, stage
// after stage, into a correction, and `renew` is called if corrections fall slowly. With `enough` it is done after that
// many corrections: linear stages are solved by the first, and refined by the second. Components differ in size, and
// the corrections of each must have stopped falling.
Outcome<double> Corrected::correct(const Called<bool(double*)>& solve, const Called<bool()>& renew,
                                   int64_t enough) const {
    const int64_t s = tables.stages, m = points.size;
    std::vector<double> defect(s * m), start(s * m), earlier(s * m), lowest(s * m, std::numeric_limits<double>::infinity());
    const auto each = [&](const auto& visit) {
        share(m, [&](int64_t first, int64_t last) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = first; c < last; ++c) visit(i, c, i * m + c);
        });
    };
    each([&](int64_t i, int64_t c, int64_t k) { start[k] = points(c, i); });
    const auto find_correction = [&] {
        evaluate();
        find_defect();
        each([&](int64_t i, int64_t c, int64_t k) { defect[k] = change(c, i); });
        return solve(defect.data());
    };
    // Whether a correction is larger than this part of its component and move, and `also(component, correction)`.
    const auto any_larger = [&](double part, const auto& also) {
        return shared_sum<double>(m, [&](int64_t first, int64_t last) {
                   double number = 0.0;
                   for (int64_t i = 0; i < s; ++i)
                       for (int64_t c = first; c < last; ++c) {
                           const int64_t k = i * m + c;
                           const double own = absolute(start[k]) + absolute(points(c, i) - start[k]);
                           const double correction = absolute(defect[k]);
                           if (correction > part * own && also(k, correction)) number += 1.0;
                       }
                   return number;
               }) > 0.0;
    };
    const auto falls_below = [&](int64_t k, double correction) {
        const bool falls = correction <= 0.5 * lowest[k];
        lowest[k] = smaller(lowest[k], correction);
        return falls;
    };
    // As `at_round_off` of function iterations, for one correction; the slopes are then those before the last one.
    const auto at_round_off = [&] {
        std::vector<double> known(s * m), end(s * m), correction, distance(s * m, 0.0);
        each([&](int64_t i, int64_t c, int64_t k) { known[k] = points(c, i); });
        bool solved = true, round_off = true;
        for (int64_t sample = 0; sample <= SAMPLES && solved; ++sample) {
            InterruptCheck::of_this_call().after(work);
            each([&](int64_t i, int64_t c, int64_t k) { points(c, i) = disturbed(sample, c, known[k]); });
            points.repeat_last(s);
            if (!(solved = find_correction())) break;
            if (sample == 0) {
                correction = defect;
                each([&](int64_t, int64_t, int64_t k) { end[k] = known[k] + defect[k]; });
            } else {
                each([&](int64_t i, int64_t c, int64_t k) {
                    distance[k] = larger(distance[k], absolute((points(c, i) + defect[k]) - end[k]));
                });
            }
        }
        each([&](int64_t i, int64_t c, int64_t k) { points(c, i) = earlier[k]; });
        points.repeat_last(s);
        evaluate();
        each([&](int64_t i, int64_t c, int64_t k) { points(c, i) = known[k]; });
        points.repeat_last(s);
        for (int64_t k = 0; k < s * m && solved; ++k)
            round_off = round_off && absolute(correction[k]) <= most_rounding(end[k], distance[k]);
        return solved && round_off;
    };
    Outcome<double> outcome{false, 0.0, std::numeric_limits<double>::infinity()};
    double before = std::numeric_limits<double>::infinity(), least = before;
    int64_t stagnant = 0, suspect = 0;
    for (int64_t passed = 1; passed <= MOST_CORRECTIONS; ++passed) {
        InterruptCheck::of_this_call().after(work);
        outcome.iterations = double(passed);
        if (!find_correction()) return outcome;
        double largest = 0.0, size = 0.0, sum = 0.0;
        for (int64_t i = 0; i < s; ++i) {
            const double moved = shared_sum<double>(m, [&](int64_t first, int64_t last) {
                double total = 0.0;
                for (int64_t c = first; c < last; ++c) {
                    earlier[i * m + c] = points(c, i);
                    points(c, i) += defect[i * m + c];
                    total += absolute(defect[i * m + c]);
                }
                return total;
            });
            const double extent = shared_sum<double>(m, [&](int64_t first, int64_t last) {
                double total = 0.0;
                for (int64_t c = first; c < last; ++c) total += absolute(points(c, i));
                return total;
            });
            largest = larger(largest, moved);
            size = larger(size, extent);
            sum += extent;
        }
        points.repeat_last(s);
        if (!(0.0 * sum == 0.0)) return outcome;
        outcome.residual = largest;
        if (passed == enough) {
            evaluate();
            outcome.settled = true;
            return outcome;
        }
        const bool small = largest <= SETTLING * size, falls = largest <= 0.5 * least;
        const bool component_falling = small && any_larger(OWN, falls_below);
        stagnant = falls || !small || component_falling ? 0 : stagnant + 1;
        suspect = falls || small ? 0 : suspect + 1;
        least = smaller(least, largest);
        const bool late = small && passed % LATE == 0;
        const bool large = (stagnant == 2 || late) && any_larger(SETTLING, [](int64_t, double) { return true; });
        const bool rough = stagnant == 2 && large;
        if (largest == 0.0 || (stagnant == 2 && !rough) ||
            ((rough || (suspect > 0 && suspect % SUSPECT == 0)) && at_round_off())) {
            outcome.settled = true;
            return outcome;
        }
        if (rough) stagnant = 0;
        if (enough == 0 && (large || (!small && largest > SLUGGISH * before)) && !renew()) return outcome;
        before = largest;
    }
    return outcome;
}

Outcome<double> Corrected::by_factors(const double* base, const StageNumbers& times, const StageNumbers& lengths,
                                      double residual) const {
    const Field& field = tables.field;
    const int64_t n = points.size, s = tables.stages, size = s * n;
    const SharedConstants constants;
    AlignedArray<double> matrix(size * size), exchanged(size);
    auto linearize = [&](bool at_base) {
        DerivativeWorkspace<double> derivatives(field);
        AlignedArray<double> point(n), u(n), unit(n), image(n), whole(n * n);
        for (int64_t j = 0; j < s; ++j) {
            if (j == 0 || !at_base) {
                const double t = times(0, j);
                for (int64_t c = 0; c < n; ++c) point.at[c] = at_base ? base[c] : points(c, j);
                gradient(field, constants, point.at, t, u.at, derivatives.field);
                for (int64_t k = 0; k < n; ++k) {
                    unit.at[k] = 1.0;
                    jacobian_times(field, constants, point.at, u.at, unit.at, t, 1.0, image.at, derivatives);
                    unit.at[k] = 0.0;
                    for (int64_t i = 0; i < n; ++i) whole.at[i * n + k] = image.at[i];
                }
            }
            for (int64_t i = 0; i < s; ++i) {
                const double factor = -tables.mix[i * s + j] * lengths(0, j);
                for (int64_t a = 0; a < n; ++a)
                    for (int64_t b = 0; b < n; ++b)
                        matrix.at[(i * n + a) * size + j * n + b] =
                            fma(factor, whole.at[a * n + b], i == j && a == b ? 1.0 : 0.0);
            }
        }
        return factorize(matrix.at, size, exchanged.at);
    };
    if (!linearize(true)) return {false, 0.0, residual};
    return correct([&](double* r) { return substitute(matrix.at, size, exchanged.at, r, 1), true; },
                   [&] { return linearize(false); });
}

// Numbers of all stages with the alignment of every layout.
struct AlignedStages {
    AlignedArray<Lanes<8>> memory;
    StageNumbers numbers;
    AlignedStages(const StageNumbers& like, int64_t stages)
        : memory((count(like, stages) + 7) / 8),
          numbers{reinterpret_cast<double*>(memory.at), like.size, like.width} {}
    static int64_t count(const StageNumbers& like, int64_t stages) {
        return (stages + like.width - 1) / like.width * like.width * like.size;
    }
};

// Columns of the Jacobian without common rows are computed by one multiplication.
Outcome<double> Corrected::by_band(const Multiply& multiply) const {
    const int64_t n = points.size, s = tables.stages, band = tables.band, groups = std::min(n, 2 * band + 1);
    AlignedStages input(points, s), output(points, s);
    Banded matrix(s * n, s * (band + 1) - 1);
    std::vector<int64_t> coordinate(n);
    std::vector<double> sides(s * n);
    for (int64_t c = 0; c < n; ++c) coordinate[tables.position[c]] = c;
    bool stale = true;
    auto factors = [&] {
        std::fill(matrix.entries.begin(), matrix.entries.end(), 0.0);
        for (int64_t k = 0; k < s * n; ++k) matrix.at(k, k) = 1.0;
        for (int64_t start = 0; start < groups; ++start) {
            std::fill_n(input.numbers.numbers, AlignedStages::count(points, s), 0.0);
            for (int64_t position = start; position < n; position += groups)
                for (int64_t j = 0; j < s; ++j) input.numbers(coordinate[position], j) = 1.0;
            input.numbers.repeat_last(s);
            multiply(input.numbers.numbers, output.numbers.numbers);
            for (int64_t position = start; position < n; position += groups)
                for (int64_t row = std::max<int64_t>(0, position - band); row < std::min(n, position + band + 1); ++row)
                    for (int64_t j = 0; j < s; ++j) {
                        const double entry = output.numbers(coordinate[row], j);
                        for (int64_t i = 0; i < s; ++i) {
                            double& here = matrix.at(row * s + i, position * s + j);
                            here = fma(-tables.mix[i * s + j], entry, here);
                        }
                    }
        }
        stale = false;
        return matrix.factorize();
    };
    auto solve = [&](double* r) {
        if (stale && !factors()) return false;
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < n; ++c) sides[tables.position[c] * s + i] = r[i * n + c];
        matrix.solve(sides.data());
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < n; ++c) r[i * n + c] = sides[tables.position[c] * s + i];
        return true;
    };
    const int64_t enough = tables.solver >= STRUCTURE ? REFINED - 1 : 0;
    return correct(solve, [&] { return stale = true; }, enough);
}

Outcome<double> Corrected::by_krylov(const Multiply& multiply, const Multiply& subtract) const {
    const int64_t m = points.size, s = tables.stages;
    AlignedStages input(points, s), output(points, s);
    Krylov krylov(s * m);
    auto operate = [&](const double* v, double* image) {
        share(m, [&](int64_t first, int64_t last) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = first; c < last; ++c) input.numbers(c, i) = v[i * m + c];
        });
        input.numbers.repeat_last(s);
        multiply(input.numbers.numbers, output.numbers.numbers);
        subtract(output.numbers.numbers, input.numbers.numbers);
        share(m, [&](int64_t first, int64_t last) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = first; c < last; ++c) image[i * m + c] = input.numbers(c, i);
        });
    };
    return correct([&](double* r) { return krylov.solve(r, operate); }, [] { return true; });
}

}  // namespace coadjoint
