// Stages by linear systems for their corrections: simplified Newton iteration, and linear schemes.
#pragma once

#include <limits>

#include "numbers/banded.hpp"
#include "numbers/krylov.hpp"
#include "numbers/linear_solve.hpp"
#include "stages/stagnation.hpp"

namespace coadjoint {

constexpr int64_t MOST_CORRECTIONS = 50;
constexpr double SLUGGISH = 0.25;  // ratio of corrections above which the factors are renewed
constexpr double SETTLING = 0x1p-40;  // of the size of the stages: below it stagnating corrections are round-off

// Correct the points of one trajectory as long as each correction is less than half of the previous one: `evaluate`
// sets the slopes at the points, `solve` turns the defect, stage after stage, into a correction, and `renew` is called
// if corrections fall slowly. With `enough` it is done after that many corrections: linear stages are solved by the
// first, and refined by the second.
template <class Layout>
NOINLINE Outcome<double> correct(Unknowns<Layout>& y, const Called<void()>& evaluate,
                                 const Called<bool(double*)>& solve, const Called<bool()>& renew, int64_t enough = 0) {
    const int64_t s = y.stages, m = y.size;
    std::vector<double> defect(s * m);
    Outcome<double> outcome{false, 0.0, std::numeric_limits<double>::infinity()};
    double before = std::numeric_limits<double>::infinity(), least = before;
    int64_t stagnant = 0;
    for (int64_t passed = 1; passed <= MOST_CORRECTIONS; ++passed) {
        InterruptCheck::of_this_call().after(y.work);
        evaluate();
        outcome.iterations = double(passed);
        y.find_defect();
        share(m, [&](int64_t first, int64_t last) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = first; c < last; ++c) defect[i * m + c] = Layout::at(y.change.at, m, c, i);
        });
        if (!solve(defect.data())) return outcome;
        double largest = 0.0, size = 0.0, sum = 0.0;
        for (int64_t i = 0; i < s; ++i) {
            const double moved = shared_sum<double>(m, [&](int64_t first, int64_t last) {
                double total = 0.0;
                for (int64_t c = first; c < last; ++c) {
                    const double change = defect[i * m + c];
                    Layout::put(y.points.at, m, c, i, Layout::at(y.points.at, m, c, i) + change);
                    total += absolute(change);
                }
                return total;
            });
            const double extent = shared_sum<double>(m, [&](int64_t first, int64_t last) {
                double total = 0.0;
                for (int64_t c = first; c < last; ++c) total += absolute(Layout::at(y.points.at, m, c, i));
                return total;
            });
            largest = larger(largest, moved);
            size = larger(size, extent);
            sum += extent;
        }
        Layout::repeat_last(y.points.at, m, s);
        if (!(0.0 * sum == 0.0)) return outcome;
        outcome.residual = largest;
        if (passed == enough) {
            evaluate();
            outcome.settled = true;
            return outcome;
        }
        const bool small = largest <= SETTLING * size;
        stagnant = largest <= 0.5 * least || !small ? 0 : stagnant + 1;
        least = smaller(least, largest);
        if (largest == 0.0 || stagnant == 2) {
            outcome.settled = true;
            return outcome;
        }
        if (enough == 0 && !small && largest > SLUGGISH * before && !renew()) return outcome;
        before = largest;
    }
    return outcome;
}

}  // namespace coadjoint
