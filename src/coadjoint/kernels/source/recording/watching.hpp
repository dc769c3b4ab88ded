// Saving every k-th step and watching every one: the same for all families of schemes.
#pragma once

#include <algorithm>
#include <vector>

#include "boundary/arrays.hpp"
#include "numbers/room.hpp"
#include "field/terms.hpp"

namespace coadjoint {

// Whether every component is finite: 0 times it is 0.
template <class A>
INLINE auto finite(int64_t size, const A* x) {
    A total(0.0);
    for (int64_t i = 0; i < size; ++i) total = total + 0.0 * x[i];
    return total == A(0.0);
}

// The place of step k among the saved points, or -1.
INLINE int64_t slot_of(const Schedule& schedule, int64_t k) {
    if (k % schedule.save_every == 0) return k / schedule.save_every - schedule.passed;
    return k == schedule.steps ? k / schedule.save_every + 1 - schedule.passed : -1;
}

// The step of a saved point.
INLINE int64_t step_of(const Schedule& schedule, int64_t slot) {
    return std::min((slot + schedule.passed) * schedule.save_every, schedule.steps);
}

// The next step after k that is saved.
INLINE int64_t next_saved(const Schedule& schedule, int64_t k) {
    return std::min(schedule.steps, (k / schedule.save_every + 1) * schedule.save_every);
}

INLINE int64_t tenth_of(const Schedule& schedule, int64_t k) {
    return k > 0 ? (k - 1) * TENTHS / schedule.steps : 0;
}

// Invariant i at x; `y` is room for watch.longest numbers, `room` for watch.longest + 1.
template <class A, class C>
NOINLINE A value_of(const Watch& watch, const C& constants, int64_t i, const A* x, const A& t, A* y, double* room) {
    A total = constants.template number_at<A>(watch.constant, i);
    for (uint32_t term = watch.first[i]; term < watch.first[i + 1]; ++term)
        total = total + value_of_term(watch.terms, constants, watch.addresses, term, x, t, y, room);
    return total;
}

// A value of a multivalued invariant, moved by whole periods next to the value before.
INLINE double unwrapped(double now, double last, double period) {
    return now + period * std::floor((last - now) / period + 0.5);
}

// Note the value of invariant i of a member at step k, where it has come from the values of the steps before.
INLINE void note_value(const Arrays& arrays, int64_t count, int64_t i, double period, int64_t member, int64_t k,
                       int64_t slot, int64_t tenth, double now) {
    int64_t place = member * count + i;
    if (k == 0)
        arrays.first[place] = now;
    else if (period > 0.0)
        now = unwrapped(now, arrays.last[place], period);
    arrays.last[place] = now;
    double deviation = std::fabs(now - arrays.first[place]);
    double& worst = arrays.worst[(member * TENTHS + tenth) * count + i];
    if (!(deviation <= worst)) worst = deviation;
    if (slot >= 0) arrays.values[(slot * arrays.members + member) * count + i] = now;
}

template <class A>
INLINE void save_state(const Arrays& arrays, int64_t member, int64_t slot, int64_t size, const A* x, int lane) {
    double* to = arrays.x + (slot * arrays.members + member) * size;
    for (int64_t i = 0; i < size; ++i) to[i] = lane_of(x[i], lane);
}

// Note the first `count` lanes, steps of one member that follow each other: deviations of the invariants, and what is
// saved.
template <class A, class C>
void note_steps(const Watch& watch, const C& constants, const Arrays& arrays, const Schedule& schedule, int64_t member,
                int64_t count, const int64_t* step, int64_t size, const A* x, A* y, double* room) {
    A t(schedule.t0);
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
        set_lane(t, lane, schedule.t0 + double(step[lane < count ? lane : count - 1]) * schedule.h);
    int64_t slots[Numbers<A>::lanes] = {}, saved = next_saved(schedule, step[0] - 1);
    bool saving = false;
    for (int64_t lane = 0; lane < count; ++lane) {
        slots[lane] = step[lane] == saved ? slot_of(schedule, saved) : -1;
        saving |= slots[lane] >= 0;
        if (slots[lane] >= 0) saved = next_saved(schedule, saved);
    }
    // Steps within a tenth share its largest deviation.
    const int64_t tenth = tenth_of(schedule, step[0]);
    const bool together = !saving && step[0] > 0 && tenth == tenth_of(schedule, step[count - 1]);
    for (int64_t i = 0; i < watch.size; ++i) {
        A now = value_of(watch, constants, i, x, t, y, room);
        A period = constants.template number_at<A>(watch.period, i);
        if (together && !(lane_of(period, 0) > 0.0)) {
            int64_t place = member * watch.size + i;
            A deviation = absolute(now - A(arrays.first[place]));
            double& worst = arrays.worst[(member * TENTHS + tenth) * watch.size + i];
            if (all(deviation <= A(worst))) continue;
            for (int64_t lane = 0; lane < count; ++lane)
                if (!(lane_of(deviation, lane) <= worst)) worst = lane_of(deviation, lane);
            continue;
        }
        for (int64_t lane = 0; lane < count; ++lane)
            note_value(arrays, watch.size, i, lane_of(period, lane), member, step[lane], slots[lane],
                       tenth_of(schedule, step[lane]), lane_of(now, lane));
    }
    if (!saving) return;
    for (int64_t lane = 0; lane < count; ++lane)
        if (slots[lane] >= 0) save_state(arrays, member, slots[lane], size, x, lane);
}

// Steps of one member gathered side by side, so that they are finished and watched as lanes; `A` is a double for
// states too large for that.
template <class A, class Finish>
struct Follower {
    static constexpr int lanes = Numbers<A>::lanes;
    const Watch& watch;
    const Arrays& arrays;
    const Schedule& schedule;
    const int64_t size;
    Finish& finish;
    Room<A> states, errors, arguments;
    std::vector<double> room;
    int64_t member = 0, step[lanes], waiting = 0;

    Follower(const Watch& watch, const Arrays& arrays, const Schedule& schedule, int64_t size, Finish& finish)
        : watch(watch), arrays(arrays), schedule(schedule), size(size), finish(finish), states(size), errors(size),
          arguments(watch.longest + 1), room(2 * watch.longest + 2) {}

    INLINE void push(int64_t who, int64_t k, const double* x, const double* dx) {
        double *to = reinterpret_cast<double*>(states.at), *owed = reinterpret_cast<double*>(errors.at);
        for (int64_t i = 0; i < size; ++i) to[i * lanes + waiting] = x[i];
        if (Finish::with_errors)
            for (int64_t i = 0; i < size; ++i) owed[i * lanes + waiting] = dx[i];
        member = who;
        step[waiting++] = k;
    }

    INLINE bool full() const { return waiting == lanes; }

    // Finish and note what waits; returns the step whose finished state is not finite, or 0.
    NOINLINE int64_t flush() {
        if (waiting == 0) return 0;
        double *to = reinterpret_cast<double*>(states.at), *owed = reinterpret_cast<double*>(errors.at);
        for (int64_t i = 0; i < size; ++i)
            for (int64_t lane = waiting; lane < lanes; ++lane) {
                to[i * lanes + lane] = to[i * lanes + waiting - 1];
                owed[i * lanes + lane] = owed[i * lanes + waiting - 1];
            }
        A t(schedule.t0);
        for (int lane = 0; lane < lanes; ++lane)
            set_lane(t, lane, schedule.t0 + double(step[std::min<int64_t>(lane, waiting - 1)] - 1) * schedule.h);
        finish(states.at, errors.at, t);
        auto sound = finite(size, states.at);
        int64_t good = 0;
        while (good < waiting && at(sound, int(good))) ++good;
        int64_t failed = good < waiting ? step[good] : 0;
        if (good > 0)
            note_steps(watch, Shared{}, arrays, schedule, member, good, step, size, states.at, arguments.at,
                       room.data());
        waiting = 0;
        return failed;
    }
};

// Members side by side, watched at the same steps. What belongs to a lane stays with it until the tenth of the run
// ends.
template <class A, class C>
struct CrowdWatcher {
    static constexpr int lanes = Numbers<A>::lanes;
    const Watch& watch;
    const Arrays& arrays;
    const Schedule& schedule;
    const C& constants;
    const int64_t *members, *going;
    const int64_t count;
    Room<A> first, last, worst, arguments;
    std::vector<double> room;
    int64_t tenth = -1;

    CrowdWatcher(const Watch& watch, const Arrays& arrays, const Schedule& schedule, const C& constants,
                 const int64_t* members, const int64_t* going, int64_t count)
        : watch(watch), arrays(arrays), schedule(schedule), constants(constants), members(members), going(going),
          count(count), first(watch.size), last(watch.size), worst(watch.size), arguments(watch.longest + 1),
          room(2 * watch.longest + 2) {
        each([&](int64_t lane, int64_t i) {
            set_lane(first.at[i], lane, arrays.first[members[lane] * watch.size + i]);
            set_lane(last.at[i], lane, arrays.last[members[lane] * watch.size + i]);
        });
    }

    ~CrowdWatcher() {
        keep_worst();
        each([&](int64_t lane, int64_t i) { arrays.last[members[lane] * watch.size + i] = lane_of(last.at[i], lane); });
    }

    void note(int64_t k, int64_t slot, int64_t size, const A* x) {
        if (int64_t now = tenth_of(schedule, k); now != tenth) {
            keep_worst();
            tenth = now;
            each([&](int64_t lane, int64_t i) { set_lane(worst.at[i], lane, worst_of(lane, i)); });
        }
        const A t(schedule.t0 + double(k) * schedule.h);
        for (int64_t i = 0; i < watch.size; ++i) {
            A now = value_of(watch, constants, i, x, t, arguments.at, room.data());
            const A period = constants.template number_at<A>(watch.period, i);
            for (int64_t lane = 0; lane < count; ++lane)
                if (double whole = lane_of(period, lane); whole > 0.0)
                    set_lane(now, int(lane), unwrapped(lane_of(now, lane), lane_of(last.at[i], lane), whole));
            last.at[i] = now;
            const A deviation = absolute(now - first.at[i]);
            worst.at[i] = select(deviation <= worst.at[i], worst.at[i], deviation);
            if (slot < 0) continue;
            for (int64_t lane = 0; lane < count; ++lane)
                if (going[lane])
                    arrays.values[(slot * arrays.members + members[lane]) * watch.size + i] = lane_of(now, lane);
        }
        for (int64_t lane = 0; slot >= 0 && lane < count; ++lane)
            if (going[lane]) save_state(arrays, members[lane], slot, size, x, lane);
    }

    void save_group(int64_t slot, int64_t square, const A* element) {
        for (int64_t lane = 0; lane < count; ++lane) {
            double* place = arrays.group + (slot * arrays.members + members[lane]) * square;
            for (int64_t i = 0; going[lane] && i < square; ++i) place[i] = lane_of(element[i], int(lane));
        }
    }

    // A lane that failed keeps the deviations it had until then.
    void keep_worst() {
        if (tenth < 0) return;
        each([&](int64_t lane, int64_t i) {
            if (going[lane]) worst_of(lane, i) = lane_of(worst.at[i], lane);
        });
    }

  private:
    double& worst_of(int64_t lane, int64_t i) { return arrays.worst[(members[lane] * TENTHS + tenth) * watch.size + i]; }

    template <class Visit>
    void each(Visit visit) {
        for (int64_t i = 0; i < watch.size; ++i)
            for (int64_t lane = 0; lane < count; ++lane) visit(lane, i);
    }
};

}  // namespace coadjoint
