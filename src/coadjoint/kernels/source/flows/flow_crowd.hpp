// The loop over steps of programs, for members side by side.
#pragma once

#include <optional>

#include "flows/flow_rows.hpp"

namespace coadjoint {

// Members as lanes; the last member fills unused lanes. Several vectors of lanes hide the latency of sines.
template <Care care, bool carry, class A, class C>
struct FlowCrowd {
    const FlowLoop& loop;
    const C constants;
    const int64_t* members;
    const int64_t count, size, square;
    Room<A> momenta, elements, kept_momenta, kept_elements;
    int64_t kept = 0;
    int64_t going[Numbers<A>::lanes], left = 0, evaluations = 0;
    CrowdRecorder<A, C> recorder;
    Vectors<A> momentum, group;
    Pace<A> pace;

    FlowCrowd(const FlowLoop& loop, const C& constants, const int64_t* members, int64_t count, Room<A>& scratch)
        : loop(loop), constants(constants), members(members), count(count), size(loop.arrays.size),
          square(loop.arrays.square), momenta(2 * size), elements(2 * square),
          kept_momenta(2 * size), kept_elements(2 * square), going{},
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
        keep(loop.k0);
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

    void keep(int64_t k) {
        kept = k;
        std::copy_n(momenta.at, 2 * size, kept_momenta.at);
        std::copy_n(elements.at, 2 * square, kept_elements.at);
    }

    // Stop the lanes that are not `sound`, in step k or, if they are not sound `earlier` either, in the previous one.
    template <class Mask>
    void stop_where_not(const Mask& sound, int64_t k, int64_t status = OVERFLOWED, const Mask* earlier = nullptr) {
        if (__builtin_expect(all(sound), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane) {
            if (at(sound, int(lane)) || !going[lane]) continue;
            const int64_t member = members[lane], step = !earlier || at(*earlier, int(lane)) ? k : k - 1;
            recorder.keep_worst();
            going[lane] = 0;
            --left;
            loop.fail(member, step, status, std::numeric_limits<double>::quiet_NaN());
            loop.arrays.evaluations[member] += rows_applied(loop.tables, loop.k0, step);
        }
    }

    // Stop lanes in which step k made a number infinite.
    INLINE void stop_where_infinite(int64_t k, A* copies, A* scratch, AngleRoom<A>& angles) {
        auto sound = finite(size, momentum.at);
        if constexpr (carry) sound = sound & finite(square, group.at);
        if (__builtin_expect(all(sound), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane)
            if (going[lane] && !at(sound, int(lane))) return stop_infinite(sound, k, copies, scratch, angles);
    }

    // If the finish of the previous step makes a number infinite, the previous step failed.
    template <class Mask>
    NOINLINE void stop_infinite(const Mask& sound, int64_t k, A* copies, A* scratch, AngleRoom<A>& angles) {
        if (k == 1) return stop_where_not(sound, k);
        const std::vector<A> now(momenta.at, momenta.at + 2 * size), element(elements.at, elements.at + 2 * square);
        std::copy_n(kept_momenta.at, 2 * size, momenta.at);
        std::copy_n(kept_elements.at, 2 * square, elements.at);
        for (int64_t again = kept + 1; again < k; ++again)
            sweep<care, carry>(loop.tables, constants, loop.tables.section[again == 1 ? 0 : 1],
                               loop.tables.section[again == 1 ? 1 : 2], momentum, group, start_of_step(again),
                               loop.schedule.h, angles);
        finish(start_of_step(k - 1), carry, copies, scratch, angles);
        auto earlier = finite(size, copies);
        if constexpr (carry) earlier = earlier & finite(square, copies + 2 * size);
        std::copy_n(now.data(), 2 * size, momenta.at);
        std::copy_n(element.data(), 2 * square, elements.at);
        stop_where_not(sound, k, OVERFLOWED, &earlier);
    }

    A start_of_step(int64_t k) const {
        return loop.schedule.starts ? pace.start : A(loop.schedule.t0 + double(k - 1) * loop.schedule.h);
    }

    // Finish copies of the momenta, and of the group elements if they are to be `turned`.
    void finish(const A& t, bool turned, A* copies, A* scratch, AngleRoom<A>& angles) {
        const uint32_t first = loop.tables.section[2], last = loop.tables.section[3];
        A* element = copies + 2 * size;
        const Vectors<A> copy{copies, copies + size, 1, scratch};
        std::copy_n(momentum.at, 2 * size, copies);
        if (carry && turned) {
            std::copy_n(group.at, 2 * square, element);
            const Vectors<A> group_copy{element, element + square, group.rows, scratch};
            sweep<care, carry>(loop.tables, constants, first, last, copy, group_copy, t, loop.schedule.h, angles);
        } else {
            sweep<care, false>(loop.tables, constants, first, last, copy, Vectors<A>{}, t, loop.schedule.h, angles);
        }
    }

    // Finish copies, including the group element if it is saved.
    NOINLINE FinishedRows<A> finished(int64_t k, bool saving, const A& t, A* copies, A* scratch, AngleRoom<A>& angles) {
        finish(t, saving, copies, scratch, angles);
        stop_where_not(finite(size, copies), k);
        if (carry && saving) {
            const auto turned = finite(square, copies + 2 * size);
            if (__builtin_expect(!all(turned), 0)) {
                recorder.note_before_stopping(k, copies, turned);
                stop_where_not(turned, k);
            }
        }
        return {copies, copies + 2 * size};
    }
};

constexpr int CROWDS = 2;

// `constants_from(place)` returns those of the lanes from a position of the crew.
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
            if (paced) angles.pace = &crowds[b]->pace;
            crowds[b]->stop_where_infinite(k, copies.at, scratch.at, angles);
            if (k % KEPT_EVERY == 0) crowds[b]->keep(k);
            const A& start = schedule.starts ? crowds[b]->pace.start : t;
            crowds[b]->recorder.after(
                k, [&](bool saving) { return crowds[b]->finished(k, saving, start, copies.at, scratch.at, angles); });
            left += crowds[b]->left;
        }
        if (left == 0) break;
    }
}

}  // namespace coadjoint
