// Increments of Brownian motions in whole steps, and the side of a step on which they act.
#pragma once

#include <vector>

#include "boundary/interrupts.hpp"
#include "boundary/tables.hpp"
#include "forces/random.hpp"

namespace coadjoint {

// The number of the quantum in which the increment k after the time t begins.
inline double quantum_of(double t, double length, int64_t k) {
    constexpr double QUANTA = 0x1p20;
    return std::floor((t + double(k) * length) / (length / QUANTA) + 0.5);
}

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
        : table(table), levels(levels), count(count), more(further), drawn(count + 1 + further) {}

    // Those of a step from t of length h, each increment the sum of 2^levels. Increments of equal lengths are the same in
    // steps of other lengths: their number is that of the time in small quanta, in which rounded times agree.
    const Step& of(double t, double h, int64_t member) {
        if (step.member == member && step.t == t && step.h == h) return step;
        const int64_t parts = int64_t(1) << levels;
        const double length = h / double(parts);
        step.t = t, step.h = h, step.member = member;
        step.sums.assign(count, 0.0);
        InterruptCheck::of_this_call().after(64 * parts * (count + 1));
        for (int64_t k = 0; k < parts; ++k) {
            DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), quantum_of(t, length, k), 0)
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
    const ForceTable& table;
    const int64_t levels, count, more;
    std::vector<double> drawn;
    Step step;
};

// The same of members as lanes, for one step after the other.
template <class A>
class IncrementsOfLanes {
  public:
    AlignedArray<A> sums;
    A first;  // one or zero

    IncrementsOfLanes(const ForceTable& table, int64_t levels, int64_t count)
        : sums(count), first(0.0), table(table), levels(levels), count(count), drawn(count) {}

    void draw(double t, double h, const int64_t* number) {
        const int64_t parts = int64_t(1) << levels;
        const double length = h / double(parts), size = std::sqrt(length);
        std::fill_n(sums.at, count, A(0.0));
        InterruptCheck::of_this_call().after(64 * parts * (count + 1) * Numbers<A>::lanes);
        for (int64_t k = 0; k < parts; ++k) {
            DeviatesOfLanes<A>(uint64_t(table.seed), table.stream, number, quantum_of(t, length, k), 0)
                .draw(count, drawn.at, k ? nullptr : &first);
            for (int64_t b = 0; b < count; ++b) sums.at[b] += drawn.at[b];
        }
        for (int64_t b = 0; b < count; ++b) sums.at[b] *= A(size);
    }

  private:
    const ForceTable& table;
    const int64_t levels, count;
    AlignedArray<A> drawn;
};

}  // namespace coadjoint
