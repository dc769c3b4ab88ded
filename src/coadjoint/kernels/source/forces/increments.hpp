// Increments of Brownian motions in whole steps, and the side of a step on which they act.
#pragma once

#include <vector>

#include "boundary/interrupts.hpp"
#include "boundary/tables.hpp"
#include "forces/random.hpp"

namespace coadjoint {

class BrownianIncrements {
  public:
    struct Step {
        double t, h;
        int64_t member = -1;
        bool first = false;           // by a fair coin: whether the noise acts before the step
        std::vector<double> sums;     // the increments
        std::vector<double> further;  // independent normal deviates
    };

    BrownianIncrements(const ForceTable& table, int64_t levels, int64_t count, int64_t further)
        : table(table), levels(levels), count(count), more(further), drawn(count + 1 + further), steps(KEPT) {}

    // Those of a step from t of length h, each increment the sum of 2^levels. Increments of equal lengths are the same in
    // steps of other lengths: their number is that of the time in small quanta, in which rounded times agree.
    const Step& of(double t, double h, int64_t member) {
        Step& step = steps[member % KEPT];
        if (step.member == member && step.t == t && step.h == h) return step;
        const int64_t parts = int64_t(1) << levels;
        const double length = h / double(parts), quantum = length / QUANTA;
        step.t = t, step.h = h, step.member = member;
        step.sums.assign(count, 0.0);
        InterruptCheck::of_this_call().after(64 * parts * (count + 1));
        for (int64_t k = 0; k < parts; ++k) {
            const double number = std::floor((t + double(k) * length) / quantum + 0.5);
            DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), number, 0)
                .draw(0, count + 1 + (k ? 0 : more), drawn.data());
            for (int64_t b = 0; b < count; ++b) step.sums[b] += drawn[b];
            if (k) continue;
            step.first = drawn[count] < 0.0;
            step.further.assign(drawn.begin() + count + 1, drawn.end());
        }
        const double size = std::sqrt(length);
        for (double& sum : step.sums) sum *= size;
        return step;
    }

  private:
    static constexpr double QUANTA = 0x1p20;
    static constexpr int64_t KEPT = 64;  // steps of members that are taken together
    const ForceTable& table;
    const int64_t levels, count, more;
    std::vector<double> drawn;
    std::vector<Step> steps;
};

}  // namespace coadjoint
