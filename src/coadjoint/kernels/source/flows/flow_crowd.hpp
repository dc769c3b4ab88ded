// The loop over steps for programs: members side by side.
#pragma once

#include <optional>

#include "flows/flow_rows.hpp"

namespace coadjoint {

// Members as lanes; the last member fills what is left of the lanes. While one crowd waits for a sine, another goes on.
template <Care care, bool carry, class A, class C>
struct FlowCrowd {
    const FlowLoop& loop;
    const C constants;
    const int64_t* members;
    const int64_t count, size, square;
    Room<A> momenta, elements;
    int64_t going[Numbers<A>::lanes], left = 0, evaluations = 0;
    CrowdRecorder<A, C> recorder;
    Vectors<A> momentum, group;
    Pace<A> pace;

    FlowCrowd(const FlowLoop& loop, const C& constants, const int64_t* members, int64_t count, Room<A>& scratch)
        : loop(loop), constants(constants), members(members), count(count), size(loop.arrays.size),
          square(loop.arrays.square), momenta(2 * size), elements(2 * square), going{},
          recorder(loop.watch, loop.arrays, loop.schedule, loop.k0, this->constants, members, going, count),
          momentum{momenta.at, momenta.at + size, 1, scratch.at},
          group{elements.at, elements.at + square, loop.tables.group.size, scratch.at} {
        for (int64_t lane = 0; lane < count; ++lane) left += going[lane] = loop.arrays.status[members[lane]] == DONE;
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            pace.set(loop.tables, loop.schedule, members[std::min<int64_t>(lane, count - 1)], lane);
        read_lanes(momentum.at, loop.arrays.momenta, size, members, count);
        read_lanes(momentum.errors, loop.arrays.errors, size, members, count);
        read_lanes(group.at, loop.arrays.groups, square, members, count);
        read_lanes(group.errors, loop.arrays.group_errors, square, members, count);
    }

    ~FlowCrowd() {
        for (int64_t lane = 0; lane < count; ++lane) {
            const int64_t member = members[lane];
            if (loop.arrays.status[member] == DONE) loop.arrays.evaluations[member] += evaluations;
            write_lane(momentum.at, loop.arrays.momenta, size, member, int(lane));
            write_lane(momentum.errors, loop.arrays.errors, size, member, int(lane));
            write_lane(group.at, loop.arrays.groups, square, member, int(lane));
            write_lane(group.errors, loop.arrays.group_errors, square, member, int(lane));
        }
    }

    template <class Mask>
    void stop_where_not(const Mask& sound, int64_t k, int64_t status = OVERFLOWED) {
        if (__builtin_expect(all(sound), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane) {
            if (at(sound, int(lane)) || !going[lane]) continue;
            recorder.keep_worst();
            going[lane] = 0;
            --left;
            loop.fail(members[lane], k, status, std::numeric_limits<double>::quiet_NaN());
            loop.arrays.evaluations[members[lane]] += evaluations;
        }
    }

    // Finish copies, the group element where it is saved.
    NOINLINE FinishedRows<A> finished(int64_t k, bool saving, const A& t, A* copies, A* scratch, AngleRoom<A>& angles) {
        const uint32_t first = loop.tables.section[2], last = loop.tables.section[3];
        A* element = copies + 2 * size;
        const Vectors<A> copy{copies, copies + size, 1, scratch};
        std::copy_n(momentum.at, 2 * size, copies);
        if (carry && saving) {
            std::copy_n(group.at, 2 * square, element);
            const Vectors<A> turned{element, element + square, group.rows, scratch};
            sweep<care, carry>(loop.tables, constants, first, last, copy, turned, t, loop.schedule.h, angles);
            stop_where_not(finite(square, element), k);
        } else {
            sweep<care, false>(loop.tables, constants, first, last, copy, Vectors<A>{}, t, loop.schedule.h, angles);
        }
        stop_where_not(finite(size, copies), k);
        return {copies, element};
    }
};

constexpr int CROWDS = 2;

// `constants_from(place)` are those of the lanes from a place of the crew.
template <Care care, bool carry, class A, class ConstantsFrom>
void follow_together(const FlowLoop& loop, const ConstantsFrom& constants_from, const int64_t* members, int64_t first,
                     int64_t last) {
    typedef FlowCrowd<care, carry, A, decltype(constants_from(0))> Own;
    constexpr int64_t lanes = Numbers<A>::lanes;
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size, square = loop.arrays.square;
    Room<A> scratch(3 * std::max(size, square)), copies(2 * (size + square));
    AngleRoom<A> angles(tables.longest);
    std::optional<Own> crowds[CROWDS];
    int used = 0;
    for (int64_t place = first; place < last; place += lanes)
        crowds[used++].emplace(loop, constants_from(place), members + place, std::min(lanes, last - place), scratch);
    const bool paced = crowds[0]->pace.other;
    const int64_t work = used * lanes * work_of_step(loop);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.hearing.after(work);
        const A t(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t from = tables.section[k == 1 ? 0 : 1], to = tables.section[k == 1 ? 1 : 2];
        for (uint32_t r = from; r < to; ++r)
            for (int b = 0; b < used; ++b) {
                Own& crowd = *crowds[b];
                if (__builtin_expect(paced, 0)) {
                    angles.pace = &crowd.pace;
                    sweep<care, carry>(tables, crowd.constants, r, r + 1, crowd.momentum, crowd.group,
                                       schedule.starts ? crowd.pace.start : t, schedule.h, angles);
                } else {
                    apply_row<care, carry, false>(tables, crowd.constants, r, crowd.momentum, crowd.group, t,
                                                  schedule.h, angles);
                }
            }
        int64_t left = 0;
        for (int b = 0; b < used; ++b) {
            crowds[b]->evaluations += to - from;
            crowds[b]->stop_where_not(finite(size, crowds[b]->momentum.at), k);
            if (paced) angles.pace = &crowds[b]->pace;
            const A& start = schedule.starts ? crowds[b]->pace.start : t;
            crowds[b]->recorder.after(
                k, [&](bool saving) { return crowds[b]->finished(k, saving, start, copies.at, scratch.at, angles); });
            left += crowds[b]->left;
        }
        if (left == 0) break;
    }
}

}  // namespace coadjoint
