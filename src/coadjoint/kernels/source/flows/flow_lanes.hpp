// The loop over steps of programs, for members as lanes.
#pragma once

#include <optional>

#include "flows/flow_rows.hpp"

namespace coadjoint {

// Members as lanes; the last member fills unused lanes. Several vectors of lanes hide the latency of sines.
template <Summation summation, bool with_group, class A, class C>
struct FlowLanes {
    const FlowLoop& loop;
    const C constants;
    const int64_t* members;
    const int64_t count, size, square;
    AlignedArray<A> momenta, elements, checkpoint_momenta, checkpoint_elements;
    int64_t checkpoint = 0;
    int64_t active[Numbers<A>::lanes], left = 0, evaluations = 0;
    LaneRecorder<A, C> recorder;
    Vectors<A> momentum, group;
    PartialStep<A> partial_step;

    FlowLanes(const FlowLoop& loop, const C& constants, const int64_t* members, int64_t count, AlignedArray<A>& scratch)
        : loop(loop), constants(constants), members(members), count(count), size(loop.arrays.size),
          square(loop.arrays.square), momenta(2 * size), elements(2 * square), checkpoint_momenta(2 * size),
          checkpoint_elements(2 * square), active{},
          recorder(loop.watch, loop.arrays, loop.schedule, loop.k0, this->constants, members, active, count),
          momentum{momenta.at, momenta.at + size, 1, scratch.at},
          group{elements.at, elements.at + square, loop.tables.group.size, scratch.at} {
        for (int64_t lane = 0; lane < count; ++lane) left += active[lane] = loop.arrays.status[members[lane]] == DONE;
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            partial_step.set(loop.tables, loop.schedule, members[std::min<int64_t>(lane, count - 1)], lane);
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
            loop.fail(member, step, status, std::numeric_limits<double>::quiet_NaN());
            loop.arrays.evaluations[member] += rows_applied(loop.tables, loop.k0, step);
        }
    }

    // Stop lanes in which step k made a number infinite.
    INLINE void stop_where_infinite(int64_t k, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        auto valid = finite(size, momentum.at);
        if constexpr (with_group) valid = valid & finite(square, group.at);
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
        for (int64_t again = checkpoint + 1; again < k; ++again)
            sweep<summation, with_group>(loop.tables, constants, loop.tables.section[again == 1 ? 0 : 1],
                                         loop.tables.section[again == 1 ? 1 : 2], momentum, group, start_of_step(again),
                                         loop.schedule.h, angles);
        finish(start_of_step(k - 1), with_group, copies, scratch, angles);
        auto earlier = finite(size, copies);
        if constexpr (with_group) earlier = earlier & finite(square, copies + 2 * size);
        std::copy_n(now.data(), 2 * size, momenta.at);
        std::copy_n(element.data(), 2 * square, elements.at);
        stop_where_not(valid, k, OVERFLOWED, &earlier);
    }

    A start_of_step(int64_t k) const {
        return loop.schedule.starts ? partial_step.start : A(loop.schedule.t0 + double(k - 1) * loop.schedule.h);
    }

    // Finish copies of the momenta, and of the group elements if they are to be `rotated`.
    void finish(const A& t, bool rotated, A* copies, A* scratch, AngleWorkspace<A>& angles) {
        const uint32_t first = loop.tables.section[2], last = loop.tables.section[3];
        A* element = copies + 2 * size;
        const Vectors<A> copy{copies, copies + size, 1, scratch};
        std::copy_n(momentum.at, 2 * size, copies);
        if (with_group && rotated) {
            std::copy_n(group.at, 2 * square, element);
            const Vectors<A> group_copy{element, element + square, group.rows, scratch};
            sweep<summation, with_group>(loop.tables, constants, first, last, copy, group_copy, t, loop.schedule.h,
                                         angles);
        } else {
            sweep<summation, false>(loop.tables, constants, first, last, copy, Vectors<A>{}, t, loop.schedule.h,
                                    angles);
        }
    }

    // Finish copies, including the group element if it is saved.
    NOINLINE FinishedRows<A> finished(int64_t k, bool saving, const A& t, A* copies, A* scratch,
                                      AngleWorkspace<A>& angles) {
        finish(t, saving, copies, scratch, angles);
        stop_where_not(finite(size, copies), k);
        if (with_group && saving) {
            const auto rotated = finite(square, copies + 2 * size);
            if (__builtin_expect(!all(rotated), 0)) {
                recorder.record_before_stop(k, copies, rotated);
                stop_where_not(rotated, k);
            }
        }
        return {copies, copies + 2 * size};
    }
};

constexpr int LANE_GROUPS = 2;

// `constants_from(position)` returns those of the lanes from a position of the range on.
template <Summation summation, bool with_group, class A, class ConstantsFrom>
void advance_lanes(const FlowLoop& loop, const ConstantsFrom& constants_from, const int64_t* members, int64_t first,
                   int64_t last) {
    typedef FlowLanes<summation, with_group, A, decltype(constants_from(0))> LaneGroup;
    constexpr int64_t lanes = Numbers<A>::lanes;
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size, square = loop.arrays.square;
    AlignedArray<A> scratch(3 * std::max(size, square)), copies(2 * (size + square));
    AngleWorkspace<A> angles(tables.longest);
    std::optional<LaneGroup> lane_groups[LANE_GROUPS];
    int used = 0;
    for (int64_t position = first; position < last; position += lanes)
        lane_groups[used++].emplace(loop, constants_from(position), members + position,
                                    std::min(lanes, last - position), scratch);
    const bool is_partial = lane_groups[0]->partial_step.needed;
    const int64_t work = used * lanes * work_of_step(loop);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        const A t(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t from = tables.section[k == 1 ? 0 : 1], to = tables.section[k == 1 ? 1 : 2];
        for (uint32_t r = from; r < to; ++r)
            for (int b = 0; b < used; ++b) {
                LaneGroup& lane_group = *lane_groups[b];
                if (is_partial) angles.partial_step = &lane_group.partial_step;
                if (with_group || __builtin_expect(is_partial, 0))
                    sweep<summation, with_group>(tables, lane_group.constants, r, r + 1, lane_group.momentum,
                                                 lane_group.group, schedule.starts ? lane_group.partial_step.start : t,
                                                 schedule.h, angles);
                else  // inlined, since a momentum alone takes little longer than a call
                    apply_row<summation, false, false>(tables, lane_group.constants, r, lane_group.momentum,
                                                       lane_group.group, t, schedule.h, angles);
            }
        int64_t left = 0;
        for (int b = 0; b < used; ++b) {
            lane_groups[b]->evaluations += to - from;
            if (is_partial) angles.partial_step = &lane_groups[b]->partial_step;
            lane_groups[b]->stop_where_infinite(k, copies.at, scratch.at, angles);
            if (k % CHECKPOINT_INTERVAL == 0) lane_groups[b]->store_checkpoint(k);
            const A& start = schedule.starts ? lane_groups[b]->partial_step.start : t;
            lane_groups[b]->recorder.after(k, [&](bool saving) {
                return lane_groups[b]->finished(k, saving, start, copies.at, scratch.at, angles);
            });
            left += lane_groups[b]->left;
        }
        if (left == 0) break;
    }
}

}  // namespace coadjoint
