// One step of another loop, of one member, as a part of a step; its result is finished.
#pragma once

#include <new>

#include "boundary/crew.hpp"

namespace coadjoint {

// The group elements of a run from those of its loop, in `flows/unshift.cpp`.
EXPORT void unshift(const UnshiftTables* tables, const Unshifted* run, const Schedule* schedule);

class InnerStep {
  public:
    int64_t evaluations = 0, iterations = 0;
    double residual = 0.0;

    // `places` are the addresses of the loop, its tables and an empty watch, the count of numbers that a member of it
    // remembers, and the address of the tables by which Casimirs subtracted from H rotate the group element, or zero.
    InnerStep(const int64_t* places, int64_t size, int64_t square)
        : loop(reinterpret_cast<InnerLoop>(places[0])), tables(reinterpret_cast<const void*>(places[1])),
          watch(*reinterpret_cast<const Watch*>(places[2])),
          turning(square ? reinterpret_cast<const UnshiftTables*>(places[4]) : nullptr) {
        // The steps 0 and 1 are saved: a loop that leaves a step unfinished finishes what it saves.
        extent.members = 1, extent.points = 3, extent.size = size, extent.square = square;
        extent.invariants = 0, extent.remembered = places[3];
        double* const none = reinterpret_cast<double*>(sizeof(double));  // only differences of addresses are used
        const Arrays last(extent, none, none);
        saved.resize(last.values - none + 1);
        state.resize(reinterpret_cast<double*>(last.iterations) - none + 1);
    }

    // Move a state, and a group element if there is one; return a status. The step starts afresh unless there is a
    // memory: what the loop remembers of the member since the previous step.
    int64_t take(double* x, double* group, double t, double h, double* memory = nullptr) {
        Arrays arrays(extent, saved.data(), state.data());
        if (memory) arrays.memory = memory;
        // A loop clears its memory before its first step, but not before its second.
        const int64_t before = memory && memory[0] == memory[0] ? 1 : 0;
        if (before) {
            arrays.status[0] = DONE;
            arrays.evaluations[0] = arrays.iterations[0] = 0;
            std::fill_n(arrays.errors, extent.size, 0.0);
            std::fill_n(arrays.group_errors, extent.square, 0.0);
        }
        std::copy_n(x, extent.size, arrays.momenta);
        std::copy_n(group, extent.square, arrays.groups);
        if (turning) prepare(x, group, arrays.groups);
        const Schedule two{t - double(before) * h, h, 2 + before, 1, 0, 0, 0, nullptr, nullptr, nullptr, 0};
        const Crew alone{&member, 0, 1, 0};
        const int64_t wrong = loop(tables, &watch, &alone, &arrays, &two, before, before + 1);
        if (wrong == NO_MEMORY) throw std::bad_alloc();
        if (wrong < 0) throw Interrupted{};
        evaluations = arrays.evaluations[0];
        iterations = arrays.iterations[0];
        residual = arrays.residual[0];
        if (wrong) return arrays.status[0];
        std::copy_n(arrays.x + (before + 1) * extent.size, extent.size, x);
        if (!turning) {
            std::copy_n(arrays.group + (before + 1) * extent.square, extent.square, group);
            return DONE;
        }
        const Unshifted one{start.data(), plain.data(), arrays.group, turned.data(), 1, 0, 1, 1, 2, 1.0};
        unshift(turning, &one, &two);
        transpose(turned.data() + extent.square, group);
        return DONE;
    }

  private:
    // The loop starts at the unit element; the given one is multiplied by the rotated one.
    void prepare(const double* x, const double* group, double* unit) {
        start.assign(x, x + extent.size);
        plain.resize(extent.square);
        turned.resize(2 * extent.square);
        transpose(group, plain.data());
        for (int64_t e = 0, d = turning->size; e < extent.square; ++e) unit[e] = e % (d + 1) ? 0.0 : 1.0;
    }

    void transpose(const double* from, double* to) const {
        const int64_t d = turning->size;
        for (int64_t i = 0; i < d; ++i)
            for (int64_t j = 0; j < d; ++j) to[i * d + j] = from[j * d + i];
    }

    const InnerLoop loop;
    const void* tables;
    const Watch& watch;
    const UnshiftTables* const turning;
    std::vector<double> start, plain, turned;
    Extent extent;
    std::vector<double> saved, state;
    const int64_t member = 0;
};

}  // namespace coadjoint
