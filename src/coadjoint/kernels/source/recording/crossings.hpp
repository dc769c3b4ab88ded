// Sign changes of functions of the state along a run, and possible double crossings within one step.
#pragma once

#include <memory>
#include <utility>

#include "recording/event_series.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

// Crossings are recorded with the state before the step, so that the root is found later without another run. The
// states are finished, and processed one step after the other; the lanes are members.
template <class A>
class Crossings {
  public:
    NOINLINE Crossings(const Schedule& schedule, const Arrays& arrays)
        : events(*reinterpret_cast<const EventTables*>(schedule.events)), schedule(schedule), arrays(arrays),
          size(arrays.size), width(arrays.size + arrays.square), count(events.watch.size), states(2 * width),
          values(DEPTH * count), arguments(events.watch.longest + 1), workspace(2 * events.watch.longest + 2),
          before(states.at), earlier(states.at + width) {}

    // Begin with the members of some lanes, from the step after k0 on. Unused lanes repeat a member.
    NOINLINE void begin(const int64_t* members, int64_t lanes_used, int64_t k0) {
        used = lanes_used;
        for (int64_t lane = 0; lane < lanes; ++lane) member[lane] = members[std::min(lane, used - 1)];
        find_next_end(nullptr);
        if (k0 > 0)
            return exchange([](A& current, int64_t lane, double& stored) { set_lane(current, int(lane), stored); });
        for (int64_t lane = 0; lane < lanes; ++lane) {
            for (int64_t i = 0; i < size; ++i)
                set_lane(before[i], int(lane), arrays.momenta[member[lane] * size + i]);
            for (int64_t i = 0; i < arrays.square; ++i)
                set_lane(before[size + i], int(lane), arrays.groups[member[lane] * arrays.square + i]);
        }
        measure(before, schedule.t0);
    }

    // Store what the next call continues from.
    NOINLINE void end() {
        if (used > 0)
            exchange([this](A& current, int64_t lane, double& stored) {
                if (lane < used) stored = lane_of(current, int(lane));
            });
    }

    // Set the Taylor series of the motion in the next step.
    NOINLINE void set_series(const StepSeries& motion) {
        series = motion;
        if (series.at && !event_series) event_series = std::make_unique<EventSeries>(events.watch, series.order);
    }

    // Process the states after step k; return whether a member has reached its end, then or before. Lanes that are not
    // `active` are skipped, if that is given.
    NOINLINE bool after(int64_t k, const A* x, const A* group, const int64_t* active = nullptr) {
        for (int64_t e = 0; e < count; ++e)
            for (int64_t age = DEPTH - 1; age > 0; --age) value(age, e) = value(age - 1, e);
        measure(x, schedule.t0 + double(k) * schedule.h);
        bool ended = k > next_end;
        if constexpr (lanes == 1)
            if (series.at && continues(member[0], k)) find_crossings_in_step(k);
        if (__builtin_expect(k < DEPTH || k == schedule.steps || !nothing_to_record(), 0))
            for (int64_t lane = 0; lane < used; ++lane)
                if (!active || active[lane]) ended |= inspect(k, int(lane));
        std::copy_n(x, size, earlier);
        if (group) std::copy_n(group, arrays.square, earlier + size);
        std::swap(before, earlier);
        return ended;
    }

    // The next end among the active lanes, as far as known.
    NOINLINE void find_next_end(const int64_t* active) {
        next_end = std::numeric_limits<int64_t>::max();
        for (int64_t lane = 0; lane < used; ++lane)
            if (!active || active[lane]) next_end = std::min(next_end, events.limit[member[lane]]);
    }

    // Whether a member continues after step k.
    bool continues(int64_t index, int64_t k) const { return k <= events.limit[index]; }

  private:
    static constexpr int64_t lanes = Numbers<A>::lanes, DEPTH = 4;
    const EventTables& events;
    const Schedule& schedule;
    const Arrays& arrays;
    const int64_t size, width, count;
    AlignedArray<A> states, values, arguments;
    std::vector<double> workspace;
    A *before, *earlier;  // the finished states one and two steps ago
    int64_t member[lanes], used = 0, next_end = 0;
    StepSeries series;
    std::unique_ptr<EventSeries> event_series;
    std::vector<double> parts;             // low and high ends, alternating
    uint64_t recorded_events = 0;          // bit mask of events whose crossings of this step are already recorded

    // The value of event e `age` steps ago.
    INLINE A& value(int64_t age, int64_t e) { return values.at[age * count + e]; }

    void measure(const A* x, double time) {
        const A t(time);
        for (int64_t e = 0; e < count; ++e)
            value(0, e) = value_of(events.watch, SharedConstants{}, e, x, t, arguments.at, workspace.data());
    }

    // Whether certainly nothing is to be recorded for any lane.
    INLINE bool nothing_to_record() {
        for (int64_t e = 0; e < count; ++e) {
            const A now = value(0, e), last = value(1, e);
            if (!all(last * now > A(0.0))) return false;
            if (any((absolute(now) > absolute(last)) & (absolute(value(3, e)) > absolute(value(2, e))))) return false;
        }
        return true;
    }

    // The state of a lane at the end of a call, for the next one.
    template <class Move>
    void exchange(Move move) {
        for (int64_t lane = 0; lane < lanes; ++lane) {
            double* stored = events.before + 2 * member[lane] * width;
            for (int64_t i = 0; i < width; ++i) move(before[i], lane, stored[i]);
            for (int64_t i = 0; i < width; ++i) move(earlier[i], lane, stored[width + i]);
            stored = events.values + member[lane] * (DEPTH - 1) * count;
            for (int64_t i = 0; i < (DEPTH - 1) * count; ++i) move(values.at[i], lane, stored[i]);
        }
    }

    // Whether the series locates the zeros of an event: then no neighbouring values are needed.
    bool located_by_series(int64_t e) const { return series.at && event_series->determines(e); }

    // Record every part of step k in which an event crosses zero, since the signs at its ends are not sufficient.
    NOINLINE void find_crossings_in_step(int64_t k) {
        recorded_events = 0;
        for (int64_t e = 0; e < count; ++e) {
            if (!event_series->determines(e)) continue;
            parts.clear();
            (*event_series)(e, reinterpret_cast<const double*>(before), series, [&](double low, double high) {
                parts.push_back(low);
                parts.push_back(high);
            });
            const bool changed = crossing(0, at_age(1, e, 0), at_age(0, e, 0)) != crossings::NONE;
            if (parts.empty() || (changed && parts.size() == 2)) continue;
            recorded_events |= uint64_t(1) << e;
            for (size_t p = 0; p < parts.size(); p += 2) {
                const int64_t position = take(k, 0, before, 1);
                if (position >= events.capacity) break;
                events.found[position * (2 + count) + 2 + e] = crossings::BETWEEN;
                double* values_there = events.records + position * (width + 2 * count) + width;
                values_there[e] = parts[p];
                values_there[count + e] = parts[p + 1];
            }
        }
    }

    // Record the crossings of a lane at step k, and return whether its member has reached its end.
    NOINLINE bool inspect(int64_t k, int lane) {
        if (!continues(member[lane], k)) return false;
        // A double crossing in the step before is decided only now; for the last step it never is.
        if (k >= 2)
            record(k - 1, lane, earlier, 2, [&](int64_t e) {
                if (located_by_series(e)) return crossings::NONE;
                return near(k < 3 ? NAN : at_age(3, e, lane), at_age(2, e, lane), at_age(1, e, lane),
                            at_age(0, e, lane));
            });
        // Nor is it for the step in which the run of the member ends.
        const bool ended = ends(lane), last = ended || k == schedule.steps;
        record(k, lane, before, 1, [&](int64_t e) {
            if (recorded_events >> e & 1) return crossings::NONE;
            const int64_t found = crossing_of(e, lane);
            if (found != crossings::NONE || !last || located_by_series(e)) return found;
            return near(k < 2 ? NAN : at_age(2, e, lane), at_age(1, e, lane), at_age(0, e, lane), NAN);
        });
        if (ended) events.limit[member[lane]] = k - 1;
        return ended;
    }

    // Count the crossings of the newest step; return whether one of them ends the run of the member.
    bool ends(int lane) {
        bool ended = false;
        for (int64_t e = 0; e < count; ++e) {
            int64_t& left = events.left[member[lane] * count + e];
            const int64_t found = left > 0 ? crossing_of(e, lane) : crossings::NONE;
            if (found == crossings::RISING || found == crossings::FALLING) ended |= --left == 0;
        }
        return ended;
    }

    int64_t crossing_of(int64_t e, int lane) {
        return crossing(events.direction[e], at_age(1, e, lane), at_age(0, e, lane));
    }

    double at_age(int64_t age, int64_t e, int lane) { return lane_of(value(age, e), lane); }

    // The crossing of g through zero, or to it, between two values.
    static int64_t crossing(int64_t direction, double last, double now) {
        if (now != now) return crossings::UNDEFINED;
        if (last < 0.0 && now >= 0.0 && direction >= 0) return crossings::RISING;
        if (last > 0.0 && now <= 0.0 && direction <= 0) return crossings::FALLING;
        return crossings::NONE;
    }

    // Whether g may have crossed zero and back between `from` and `to`. If g is curved away from zero, it stays above
    // the lines through the values next to that step; these meet zero before they meet each other, or nearly so.
    static int64_t near(double before, double from, double to, double after) {
        if (!(from * to > 0.0)) return crossings::NONE;
        const double a = std::fabs(from), b = std::fabs(to);
        const double down = before == before ? (from > 0.0 ? before : -before) - a : INFINITY;
        const double up = after == after ? (to > 0.0 ? after : -after) - b : INFINITY;
        return down > 0.0 && up > 0.0 && a / down + b / up <= NEAR_MARGIN ? crossings::NEAR : crossings::NONE;
    }
    static constexpr double NEAR_MARGIN = 2.0;  // 1 suffices for equal curvature on the three steps

    template <class Code>
    void record(int64_t k, int lane, const A* state, int64_t age, Code code_of) {
        int64_t position = -1;
        for (int64_t e = 0; e < count; ++e) {
            const int64_t code = code_of(e);
            if (code == crossings::NONE) continue;
            if (position < 0) position = take(k, lane, state, age);
            if (position < events.capacity) events.found[position * (2 + count) + 2 + e] = code;
        }
    }

    // Several threads write to the same arrays, but to different entries.
    int64_t take(int64_t k, int lane, const A* state, int64_t age) {
        const int64_t position = __atomic_fetch_add(events.recorded, 1, __ATOMIC_RELAXED);
        if (position >= events.capacity) return position;
        int64_t* found = events.found + position * (2 + count);
        *found++ = member[lane];
        *found++ = k;
        std::fill_n(found, count, int64_t(crossings::NONE));
        double* to = events.records + position * (width + 2 * count);
        for (int64_t i = 0; i < width; ++i) *to++ = lane_of(state[i], lane);
        for (int64_t e = 0; e < count; ++e) *to++ = at_age(age, e, lane);
        for (int64_t e = 0; e < count; ++e) *to++ = at_age(age - 1, e, lane);
        return position;
    }
};

// `declared` is `extern`, or empty in crossings.cpp.
#define COMPILED_CROSSINGS(declared, A)                                                                  \
    declared template Crossings<A>::Crossings(const Schedule&, const Arrays&);                          \
    declared template void Crossings<A>::begin(const int64_t*, int64_t, int64_t);                       \
    declared template void Crossings<A>::end();                                                         \
    declared template bool Crossings<A>::after(int64_t, const A*, const A*, const int64_t*);            \
    declared template void Crossings<A>::find_next_end(const int64_t*);                                 \
    declared template void Crossings<A>::set_series(const StepSeries&);

#if !defined(COADJOINT_APART)
COMPILED_CROSSINGS(extern, double)
COMPILED_CROSSINGS(extern, Lanes<MEMBER_LANES>)
#endif

}  // namespace coadjoint
