// Initialization of runs, detection of failures, and functions along saved points.
#include "boundary/loop.hpp"
#include "recording/saved_steps.hpp"

namespace coadjoint {

COMPILED_WATCHING()

constexpr int64_t FILL_INTERVAL = int64_t(1) << 16;  // numbers that are filled without checking for interrupts

// Fill the rows of the members first to last - 1 with one value, in each of the planes.
static void fill(double* at, int64_t planes, int64_t members, int64_t first, int64_t last, int64_t length,
                 double value) {
    // For all members at once the planes are contiguous.
    const bool whole = last - first == members;
    const int64_t pieces = whole ? 1 : planes, all = (whole ? planes * members : last - first) * length;
    for (int64_t piece = 0; piece < pieces; ++piece) {
        double* from = at + (piece * members + first) * length;
        for (int64_t done = 0, count; done < all; done += count) {
            count = std::min(all - done, FILL_INTERVAL);
            std::fill_n(from + done, count, value);
            InterruptCheck::of_this_call().after(count);
        }
    }
}

void begin(const Watch& watch, const Arrays& arrays, const Schedule& schedule, const MemberRange& range) {
    if (range.first >= range.last) return;
    const auto fill_range = [&](double* at, int64_t planes, int64_t length, double value) {
        fill(at, planes, arrays.members, range.members[range.first], range.members[range.last - 1] + 1, length, value);
    };
    // Points that are not saved stay NaN.
    fill_range(arrays.x, arrays.points, arrays.size, NAN);
    fill_range(arrays.group, arrays.points, arrays.square, NAN);
    fill_range(arrays.values, arrays.points, watch.size, NAN);
    fill_range(arrays.worst, 1, TENTHS * watch.size, 0.0);
    fill_range(arrays.errors, 1, arrays.size, 0.0);
    fill_range(arrays.group_errors, 1, arrays.square, 0.0);
    fill_range(arrays.memory, 1, arrays.memory_size, NAN);
    std::vector<double> y(watch.longest + 1), workspace(2 * watch.longest + 2);
    const int64_t slot = arrays.points > 0 && step_of(schedule, 0) == 0 ? 0 : -1;
    const int64_t work = work_of_terms(watch.terms, 0, watch.terms.size) + 64 + arrays.size + arrays.square;
    for (int64_t position = range.first; position < range.last; ++position) {
        InterruptCheck::of_this_call().after(work);
        const int64_t member = range.members[position];
        arrays.status[member] = DONE;
        arrays.step[member] = arrays.evaluations[member] = arrays.iterations[member] = 0;
        arrays.residual[member] = NAN;
        const double* x = arrays.momenta + member * arrays.size;
        const double t = start_of(schedule, member, 1);
        SharedSteps shared_values(schedule.threads, arrays.size);
        shared_values.begin_as_measured();
        for (int64_t i = 0; i < watch.size; ++i) {
            const double value = range.stride ? value_of(watch, MemberConstants{range.stride, position}, i, x, t,
                                                         y.data(), workspace.data())
                                              : value_of(watch, SharedConstants{}, i, x, t, y.data(), workspace.data());
            record_value(arrays, watch.size, i, 0.0, member, 0, slot, 0, true, value);
        }
        if (slot >= 0) save_state(arrays, member, slot, arrays.size, x, 0);
        shared_values.end_as_measured();
        if (slot < 0) continue;
        std::copy_n(arrays.groups + member * arrays.square, arrays.square, arrays.group + member * arrays.square);
    }
}

int64_t count_failed(const Watch& watch, const Arrays& arrays, const MemberRange& range, bool ended) {
    int64_t failed = 0;
    for (int64_t position = range.first; position < range.last; ++position) {
        InterruptCheck::of_this_call().after(ended ? 4 * arrays.points : 1);
        const int64_t member = range.members[position];
        if (ended && arrays.status[member] == DONE && arrays.step[member] > 0) arrays.status[member] = OVERFLOWED;
        bool valid = arrays.status[member] == DONE || arrays.status[member] == ENDED;
        for (int64_t point = 0; ended && valid && point < arrays.points; ++point)
            valid = std::isfinite(arrays.values[(point * arrays.members + member) * watch.size]);
        failed += !valid;
    }
    return failed;
}

// Fill out (points, members, I) with functions at saved points (points, members, n).
EXPORT void watch_values(const Watch* watch, const double* x, const double* times, int64_t points, int64_t members,
                         int64_t size, double* out) {
    std::vector<double> y(watch->longest + 1), workspace(2 * watch->longest + 2);
    for (int64_t here = 0; here < points * members; ++here)
        for (int64_t i = 0; i < watch->size; ++i)
            out[here * watch->size + i] = value_of(*watch, SharedConstants{}, i, x + here * size, times[here / members],
                                                   y.data(), workspace.data());
}

}  // namespace coadjoint
