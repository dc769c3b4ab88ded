// One step of another loop, of one member or of several, as a part of a step; its result is finished.
#pragma once

#include <new>

#include "boundary/loop.hpp"

namespace coadjoint {

// The group elements of a run from those of its loop, in `flows/unshift.cpp`.
EXPORT void unshift(const UnshiftTables* tables, const Unshifted* run, const Schedule* schedule);

class InnerStep {
  public:
    int64_t evaluations = 0, iterations = 0;
    double residual = 0.0;

    // `addresses` are the addresses of the loop, its tables and an empty watch, the size of its memory per member, and
    // the address of the tables by which Casimirs subtracted from H rotate the group element, or zero. The tables may have
    // a column for each member.
    InnerStep(const int64_t* addresses, int64_t size, int64_t square, int64_t members = 1,
              const LaneConstants& columns = {0, 0})
        : columns(columns), loop(reinterpret_cast<InnerLoop>(addresses[0])), tables(reinterpret_cast<const void*>(addresses[1])),
          watch(*reinterpret_cast<const Watch*>(addresses[2])),
          unshift_tables(square ? reinterpret_cast<const UnshiftTables*>(addresses[4]) : nullptr) {
        // The steps 0 and 1 are saved: a loop that leaves a step unfinished finishes what it saves.
        extent.members = members, extent.points = 3, extent.size = size, extent.square = square;
        extent.invariants = 0, extent.memory_size = addresses[3];
        double* const none = reinterpret_cast<double*>(sizeof(double));  // only differences of addresses are used
        const Arrays last(extent, none, none);
        saved.resize(last.values - none + 1);
        state.resize(reinterpret_cast<double*>(last.iterations) - none + members);
    }

    // Move a state, and a group element if there is one; return a status. The step starts afresh unless there is a
    // memory: the memory of the loop after the previous step.
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
        if (unshift_tables) prepare(x, group, arrays.groups);
        const Schedule two{t - double(before) * h, h, 2 + before, 1, 0, 0, 0, nullptr, nullptr, nullptr, 0};
        const MemberRange alone = range_of(&member, 1);
        const int64_t failed = loop(tables, &watch, &alone, &arrays, &two, before, before + 1);
        if (failed == NO_MEMORY) throw std::bad_alloc();
        if (failed < 0) throw Interrupted{};
        evaluations = arrays.evaluations[0];
        iterations = arrays.iterations[0];
        residual = arrays.residual[0];
        if (failed) return arrays.status[0];
        std::copy_n(arrays.x + (before + 1) * extent.size, extent.size, x);
        if (!unshift_tables) {
            std::copy_n(arrays.group + (before + 1) * extent.square, extent.square, group);
            return DONE;
        }
        const Unshifted one{start.data(), plain.data(), arrays.group, rotated.data(), 1, 0, 1, 1, 2, 1.0};
        unshift(unshift_tables, &one, &two);
        transpose(rotated.data() + extent.square, group);
        return DONE;
    }

    // Move the states of the first `count` members, without group elements and memories; set the status of each.
    void take_all(double* const* x, int64_t count, double t, double h, int64_t* status) {
        Arrays arrays(extent, saved.data(), state.data());
        for (; int64_t(numbers.size()) < count;) numbers.push_back(int64_t(numbers.size()));
        for (int64_t b = 0; b < count; ++b) std::copy_n(x[b], extent.size, arrays.momenta + b * extent.size);
        const Schedule two{t, h, 2, 1, 0, 0, 0, nullptr, nullptr, nullptr, 0};
        const MemberRange range = range_of(numbers.data(), count);
        const int64_t failed = loop(tables, &watch, &range, &arrays, &two, 0, 1);
        if (failed == NO_MEMORY) throw std::bad_alloc();
        if (failed < 0) throw Interrupted{};
        for (int64_t b = 0; b < count; ++b) {
            status[b] = arrays.status[b];
            if (status[b] == DONE) std::copy_n(arrays.x + (extent.members + b) * extent.size, extent.size, x[b]);
        }
    }

    // Of a member that was moved with others.
    int64_t evaluations_of(int64_t b) { return Arrays(extent, saved.data(), state.data()).evaluations[b]; }
    int64_t iterations_of(int64_t b) { return Arrays(extent, saved.data(), state.data()).iterations[b]; }
    double residual_of(int64_t b) { return Arrays(extent, saved.data(), state.data()).residual[b]; }

  private:
    const LaneConstants columns;
    std::vector<int64_t> numbers;

    MemberRange range_of(const int64_t* members, int64_t count) const {
        return {members - columns.first, columns.first, columns.first + count, columns.stride};
    }

    // The loop starts at the unit element; the initial element is multiplied by the result.
    void prepare(const double* x, const double* group, double* unit) {
        start.assign(x, x + extent.size);
        plain.resize(extent.square);
        rotated.resize(2 * extent.square);
        transpose(group, plain.data());
        for (int64_t e = 0, d = unshift_tables->size; e < extent.square; ++e) unit[e] = e % (d + 1) ? 0.0 : 1.0;
    }

    void transpose(const double* from, double* to) const {
        const int64_t d = unshift_tables->size;
        for (int64_t i = 0; i < d; ++i)
            for (int64_t j = 0; j < d; ++j) to[i * d + j] = from[j * d + i];
    }

    const InnerLoop loop;
    const void* tables;
    const Watch& watch;
    const UnshiftTables* const unshift_tables;
    std::vector<double> start, plain, rotated;
    Extent extent;
    std::vector<double> saved, state;
    const int64_t member = 0;
};

}  // namespace coadjoint
