// The arrays of a run, in the order of `coadjoint.kernels.arrays`, which says what they are.
#pragma once

#include "boundary/tables.hpp"

namespace coadjoint {

constexpr int64_t TENTHS = 10;

struct Saves {
    int64_t members;
    double *x, *group, *values, *worst, *first, *last;
};

struct Report {
    int64_t *status, *step, *evaluations, *iterations;
    double* residual;
};

struct State {
    int64_t size, square, remembered;
    double *momenta, *errors, *groups, *group_errors, *memory;
};

struct Arrays {
    Saves saves;
    State state;
    Report report;
    int64_t points;

    Arrays(const Extent& extent, double* results, double* work) : points(extent.points) {
        const int64_t members = extent.members, size = extent.size, square = extent.square;
        const auto next = [members](double*& at, int64_t count) {
            double* here = at;
            at += members * count;
            return here;
        };
        const auto next_whole = [&](double*& at) { return reinterpret_cast<int64_t*>(next(at, 1)); };
        saves.members = members;
        saves.x = next(results, extent.points * size);
        saves.group = next(results, extent.points * square);
        saves.values = next(results, extent.points * extent.invariants);
        saves.worst = next(results, TENTHS * extent.invariants);
        report.residual = next(results, 1);
        report.status = next_whole(results);
        report.step = next_whole(results);
        report.evaluations = next_whole(results);
        report.iterations = next_whole(results);
        saves.first = next(work, extent.invariants);
        saves.last = next(work, extent.invariants);
        state = {size, square, extent.remembered};
        state.momenta = next(work, size);
        state.errors = next(work, size);
        state.groups = next(work, square);
        state.group_errors = next(work, square);
        state.memory = next(work, extent.remembered);
    }
};

}  // namespace coadjoint
