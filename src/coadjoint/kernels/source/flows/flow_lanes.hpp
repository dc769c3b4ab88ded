// The loop over steps of programs, for members as lanes.
#pragma once

#include <optional>

#include "flows/flow_rows.hpp"

namespace coadjoint {

// `sweep_groups` with some sums: for a step, and for the momenta alone. Loops over steps are compiled once for all sums.
template <class A, class C>
struct LaneSweeps {
    void (*step)(const FlowTables&, const RowsTarget<A, A, C>* const*, int, RowRange, const A&, double,
                 AngleWorkspace<A>&);
    decltype(step) of_momenta;
};

// Members as lanes; the last member fills unused lanes. Several vectors of lanes hide the latency of sines.
template <class A, class C>
struct FlowLanes : RowsTarget<A, A, C> {
    using RowsTarget<A, A, C>::constants, RowsTarget<A, A, C>::momentum, RowsTarget<A, A, C>::group;
    const FlowLoop& loop;
    const LaneSweeps<A, C> sweeps;
    const int64_t* members;
    const int64_t count, size, square;
    AlignedArray<A> momenta, elements, checkpoint_momenta, checkpoint_elements;
    int64_t checkpoint = 0;
    int64_t active[Numbers<A>::lanes], too_long[Numbers<A>::lanes] = {}, left_out[Numbers<A>::lanes], left = 0, evaluations = 0;
    LaneRecorder<A, C> recorder;
    PartialStep<A> own_step;

    FlowLanes(const FlowLoop& loop, const C& constants, const LaneSweeps<A, C>& sweeps, const int64_t* members,
              int64_t count, AlignedArray<A>& scratch)
        : RowsTarget<A, A, C>{constants, {}, {}, nullptr, nullptr}, loop(loop), sweeps(sweeps), members(members),
          count(count), size(loop.arrays.size), square(loop.arrays.square), momenta(2 * size), elements(2 * square),
          checkpoint_momenta(2 * size), checkpoint_elements(2 * square), active{},
          recorder(loop.watch, loop.arrays, loop.schedule, loop.k0, this->constants, members, active, count) {
        momentum = {momenta.at, momenta.at + size, 1, scratch.at, too_long};
        group = {elements.at, elements.at + square, loop.tables.group.size, scratch.at, too_long};
        for (int64_t lane = 0; lane < count; ++lane) left += active[lane] = loop.arrays.status[members[lane]] == DONE;
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            own_step.set(loop.tables, loop.schedule, members[std::min<int64_t>(lane, count - 1)], lane);
        if (own_step.needed) this->partial_step = &own_step;
        if (loop.schedule.starts) this->start = &own_step.start;
        read_lanes(momentum.at, loop.arrays.momenta, size, members, count);
        read_lanes(momentum.errors, loop.arrays.errors, size, members, count);
        read_lanes(group.at, loop.arrays.groups, square, members, count);
        read_lanes(group.errors, loop.arrays.group_errors, square, members, count);
        store_checkpoint(loop.k0);
    }

    ~FlowLanes() {
        for (int64_t lane = 0; lane < count; ++lane) {
            const int64_t member = members[lane];
            if (loop.arrays.status[member] == DONE) loop.arrays.evaluations[member] += evaluations;
            write_lane(momentum.at, loop.arrays.momenta, size, member, int(lane));
            write_lane(momentum.errors, loop.arrays.errors, size, member, int(lane));
            write_lane(group.at, loop.arrays.groups, square, member, int(lane));
            write_lane(group.errors, loop.arrays.group_errors, square, member, int(lane));
        }
    }

    void store_checkpoint(int64_t k) {
        checkpoint = k;
        std::copy_n(momenta.at, 2 * size, checkpoint_momenta.at);
        std::copy_n(elements.at, 2 * square, checkpoint_elements.at);
    }

    // Stop the lanes that are not `valid`, in step k or, if they are not sound `earlier` either, in the previous one.
    template <class Mask>
    void stop_where_not(const Mask& valid, int64_t k, int64_t status = OVERFLOWED, const Mask* earlier = nullptr) {
        if (__builtin_expect(all(valid), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane) {
            if (at(valid, int(lane)) || !active[lane]) continue;
            const int64_t member = members[lane], step = !earlier || at(*earlier, int(lane)) ? k : k - 1;
            recorder.store_worst();
            active[lane] = 0;
            --left;
            if (status == OVERFLOWED)
                loop.overflow(member, step, step == k && too_long[lane]);
            else
                loop.fail(member, step, status, std::numeric_limits<double>::quiet_NaN());
            loop.arrays.evaluations[member] += rows_applied(loop.tables, loop.k0, step);
        }
    }

    // Stop lanes in which step k made a number infinite.
    void stop_where_infinite(int64_t k, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        auto valid = finite(size, momentum.at);
        if (square > 0) valid = valid & finite(square, group.at);
        if (__builtin_expect(all(valid), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane)
            if (active[lane] && !at(valid, int(lane))) return stop_infinite(valid, k, copies, scratch, angles);
    }

    // If the finish of the previous step makes a number infinite, the previous step failed.
    template <class Mask>
    NOINLINE void stop_infinite(const Mask& valid, int64_t k, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        if (k == 1) return stop_where_not(valid, k);
        const std::vector<A> now(momenta.at, momenta.at + 2 * size), element(elements.at, elements.at + 2 * square);
        std::copy_n(checkpoint_momenta.at, 2 * size, momenta.at);
        std::copy_n(checkpoint_elements.at, 2 * square, elements.at);
        const RowsTarget<A, A, C>* const target = this;
        for (int64_t again = checkpoint + 1; again < k; ++again)
            sweeps.step(loop.tables, &target, 1, rows_of_step(loop.tables, again), start_of_step(again),
                        loop.schedule.h, angles);
        finish(start_of_step(k - 1), true, copies, scratch, angles);
        auto earlier = finite(size, copies);
        if (square > 0) earlier = earlier & finite(square, copies + 2 * size);
        std::copy_n(now.data(), 2 * size, momenta.at);
        std::copy_n(element.data(), 2 * square, elements.at);
        stop_where_not(valid, k, OVERFLOWED, &earlier);
    }

    // The start of the step after k - 1; steps of lanes with starts of their own are read from them.
    A start_of_step(int64_t k) const { return A(loop.schedule.t0 + double(k - 1) * loop.schedule.h); }

    // Finish copies of the momenta, and of the group elements if they are to be `rotated`.
    void finish(const A& t, bool rotated, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        RowsTarget<A, A, C> copy = *this;
        copy.momentum = {copies, copies + size, 1, scratch};
        std::copy_n(momentum.at, 2 * size, copies);
        if (rotated) {
            A* element = copies + 2 * size;
            copy.group = {element, element + square, group.rows, scratch};
            std::copy_n(group.at, 2 * square, element);
        }
        const RowsTarget<A, A, C>* const target = &copy;
        (rotated ? sweeps.step : sweeps.of_momenta)(loop.tables, &target, 1, finishing_rows(loop.tables), t,
                                                    loop.schedule.h, angles);
    }

    // To be called after the `rows` of step k: stop lanes that are not finite, and record the others.
    INLINE void after(int64_t k, int64_t rows, const A& t, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        evaluations += rows;
        stop_where_infinite(k, copies, scratch, angles);
        if (k % CHECKPOINT_INTERVAL == 0) store_checkpoint(k);
        recorder.after(k, [&](bool saving) { return finished(k, saving, t, copies, scratch, angles); });
    }

    // Finish copies, including the group element if it is saved.
    NOINLINE FinishedRows<A> finished(int64_t k, bool saving, const A& t, A* copies, A* scratch,
                                      AngleWorkspace<A>& angles) {
        finish(t, saving, copies, scratch, angles);
        const auto valid = finite(size, copies);
        if (__builtin_expect(!recorder.ends_where_infinite(), 1)) {
            auto sound = valid;
            if (square > 0 && saving) sound = sound & finite(square, copies + 2 * size);
            if (__builtin_expect(all(sound), 1)) return {copies, copies + 2 * size};
            for (int64_t i = 0; i < size; ++i) copies[i] = select(valid, copies[i], A(NAN));
            for (int lane = 0; lane < Numbers<A>::lanes; ++lane) left_out[lane] = !at(sound, lane);
            return {copies, copies + 2 * size, left_out};
        }
        stop_where_not(valid, k);
        if (square > 0 && saving) {
            const auto rotated = finite(square, copies + 2 * size);
            if (__builtin_expect(!all(rotated), 0)) {
                recorder.record_before_stop(k, copies, rotated);
                stop_where_not(rotated, k);
            }
        }
        return {copies, copies + 2 * size};
    }
};

// Groups of members that advance in turn, so that one computes while the other waits for operands.
constexpr int LANE_GROUPS = 2;

// The members first to last - 1 of a range.
template <class A, class C>
void advance_lanes(const FlowLoop& loop, const LaneSweeps<A, C>& sweeps, const MemberRange& range, int64_t first,
                   int64_t last) {
    constexpr int64_t lanes = Numbers<A>::lanes;
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size, square = loop.arrays.square;
    AlignedArray<A> scratch(3 * std::max(size, square)), copies(2 * (size + square));
    AngleWorkspace<A> angles(tables.longest);
    std::optional<FlowLanes<A, C>> lane_groups[LANE_GROUPS];
    const RowsTarget<A, A, C>* targets[LANE_GROUPS];
    int used = 0;
    for (int64_t position = first; position < last; position += lanes, ++used) {
        C constants{};
        if constexpr (std::is_same_v<C, LaneConstants>) constants = {range.stride, position};
        targets[used] = &lane_groups[used].emplace(loop, constants, sweeps, range.members + position,
                                                   std::min(lanes, last - position), scratch);
    }
    const int64_t work = used * lanes * work_of_step(loop);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        const A t(schedule.t0 + double(k - 1) * schedule.h);
        const RowRange rows = rows_of_step(tables, k);
        sweeps.step(tables, targets, used, rows, t, schedule.h, angles);
        int64_t left = 0;
        for (int b = 0; b < used; ++b) {
            lane_groups[b]->after(k, rows.size(), t, copies.at, scratch.at, angles);
            left += lane_groups[b]->left;
        }
        if (left == 0) break;
    }
}

}  // namespace coadjoint
