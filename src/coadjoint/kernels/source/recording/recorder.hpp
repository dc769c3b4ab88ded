// Saved points and watched invariants of a run. A loop only calls `after` for each of its steps: of `MemberRecorder` if
// it advances one member, of `LaneRecorder` if it advances members as lanes.
#pragma once

#include <memory>

#include "recording/crossings.hpp"
#include "recording/saved_steps.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

// For states that need no finishing.
struct AlreadyFinished {
    static constexpr bool nothing = true, with_errors = false;
    template <class A>
    void operator()(A*, A*, const A&) const {}
};

// Steps of one member, gathered into lanes, which are finished and watched together; `A` is a double if a state is too
// large for that.
template <class A, class C, class Finish>
class MemberRecorder {
  public:
    MemberRecorder(const Watch& watch, const Arrays& arrays, const Schedule& schedule, const C& constants,
                   Finish& finish)
        : watch(watch), arrays(arrays), schedule(schedule), constants(constants), finish(finish), size(arrays.size),
          saved(schedule, 0), states(gathers ? size : 0), errors(gathers ? size : 0), arguments(watch.longest + 1),
          workspace(2 * watch.longest + 2) {
        if (schedule.events) detector = std::make_unique<EventDetector>(schedule, arrays);
    }

    ~MemberRecorder() {
        if (detector) detector->crossings.end();
    }

    // Begin with a member and its constants, from the step after k0 on.
    void begin(int64_t new_member, const C& new_constants, int64_t k0) {
        member = new_member;
        constants = new_constants;
        saved = SavedSteps(schedule, k0);
        recording = schedule.watching || has_periods<A>(watch, constants);
        clear_slots();
        if (detector) detector->begin(member, k0);
    }

    // The next step, from k on, that is recorded.
    int64_t next_recorded(int64_t k) const { return recording || detector ? k : saved.next; }

    // Record the state after step k, if required. `group(k, to)` fills in the finished group element, and returns
    // whether it is finite. A finished state that is not finite is saved as NaN, since steps without it may go on; only
    // the search for events needs all of them: then return the first step with such a state, otherwise 0.
    template <class Group>
    INLINE int64_t after(int64_t k, const double* x, const double* dx, const Group& group) {
        const bool due = k == saved.next;
        if (!due && !recording && !detector) return 0;
        bool valid = true;
        if (detector && arrays.square) valid = group(k, detector->groups.data() + waiting * arrays.square);
        if (due) {
            const int64_t position = saved.take();
            valid = valid && group(k, group_at(position));
            if (valid)
                slot[waiting] = position, saving = true;
            else
                arrays.left_out(member, k);
        }
        if (__builtin_expect(!valid && detector, 0)) return end_at(k, x, dx);
        if (!valid && !recording) return 0;
        if constexpr (!gathers) {
            record(1, &k, x);
            return 0;
        } else {
            gather(k, x, dx);
            return __builtin_expect(waiting == lanes, 0) ? flush() : 0;
        }
    }

    // Clear the saved points of the member from a step on.
    NOINLINE void clear_from(int64_t from) {
        for (int64_t position = saved.slot - 1; position >= 0 && step_of(schedule, position) >= from; --position) {
            const int64_t row = position * arrays.members + member;
            std::fill_n(arrays.x + row * size, size, NAN);
            std::fill_n(arrays.values + row * watch.size, watch.size, NAN);
            std::fill_n(group_at(position), arrays.square, NAN);
        }
    }

    // Set the Taylor series of the next recorded step, if known.
    void set_series(const StepSeries& series) {
        if (detector) detector->crossings.set_series(series);
    }

    // Finish and record the pending steps; to be called after the last step. Returns as `after` does.
    NOINLINE int64_t flush() {
        if (waiting == 0) return 0;
        double *to = reinterpret_cast<double*>(states.at), *remainder = reinterpret_cast<double*>(errors.at);
        for (int64_t i = 0; i < size; ++i)
            for (int64_t lane = waiting; lane < lanes; ++lane) {
                to[i * lanes + lane] = to[i * lanes + waiting - 1];
                remainder[i * lanes + lane] = remainder[i * lanes + waiting - 1];
            }
        int64_t good = waiting;
        if constexpr (!Finish::nothing) {
            A t(schedule.t0);
            for (int lane = 0; lane < lanes; ++lane)
                set_lane(t, lane, start_of(schedule, member, step[std::min<int64_t>(lane, waiting - 1)]));
            finish(states.at, errors.at, t);
            const auto valid = finite(size, states.at);
            if (__builtin_expect(!all(valid), 0)) {
                if (!detector) leave_out(valid);
                for (good = 0; good < waiting && (!detector || at(valid, int(good)));) ++good;
            }
        }
        const int64_t failed = good < waiting ? step[good] : 0;
        // Group elements saved from the failed step on are cleared.
        for (int64_t lane = good; lane < waiting; ++lane)
            if (slot[lane] >= 0) std::fill_n(group_at(slot[lane]), arrays.square, NAN);
        if (good > 0) record(good, step, states.at);
        waiting = 0;
        return failed;
    }

  private:
    static constexpr int lanes = Numbers<A>::lanes;
    static constexpr bool gathers = lanes > 1 || !Finish::nothing;
    const Watch& watch;
    const Arrays& arrays;
    const Schedule& schedule;
    C constants;
    Finish& finish;
    const int64_t size;
    SavedSteps saved;
    AlignedArray<A> states, errors, arguments;
    AlignedArray<double> workspace;
    int64_t member = 0, step[lanes], slot[lanes], waiting = 0;
    bool saving = false, recording = false;

    // Events are processed one step after the other.
    struct EventDetector {
        Crossings<double> crossings;
        std::vector<double> x, groups;
        EventDetector(const Schedule& schedule, const Arrays& arrays)
            : crossings(schedule, arrays), x(arrays.size), groups(lanes * arrays.square) {}
        // The lanes may still hold steps of the member before, for which this is called again.
        void begin(int64_t member, int64_t k0) {
            if (begun) crossings.end();
            begun = true;
            crossings.begin(&member, 1, k0);
        }
        bool begun = false;
    };
    std::unique_ptr<EventDetector> detector;

    void clear_slots() {
        std::fill_n(slot, lanes, -1);
        saving = false;
    }

    // Finished states that are not `valid` are NaN, and so are the deviations of their invariants.
    template <class Mask>
    NOINLINE void leave_out(const Mask& valid) {
        for (int64_t i = 0; i < size; ++i) states.at[i] = select(valid, states.at[i], A(NAN));
        for (int64_t lane = 0; lane < waiting; ++lane)
            if (!at(valid, int(lane)) && slot[lane] >= 0) {
                std::fill_n(group_at(slot[lane]), arrays.square, NAN);
                arrays.left_out(member, step[lane]);
            }
    }

    INLINE void gather(int64_t k, const double* x, const double* dx) {
        double *to = reinterpret_cast<double*>(states.at), *remainder = reinterpret_cast<double*>(errors.at);
        share(size, [&](int64_t first, int64_t last) {
            for (int64_t i = first; i < last; ++i) to[i * lanes + waiting] = x[i];
            if (finish.with_errors)
                for (int64_t i = first; i < last; ++i) remainder[i * lanes + waiting] = dx[i];
        });
        step[waiting++] = k;
    }

    // The group element of step k is not finite. The deviations of its momentum count, as for unfinished elements.
    NOINLINE int64_t end_at(int64_t k, const double* x, const double* dx) {
        if (const int64_t earlier = flush()) return earlier;
        if (!recording) return k;
        auto none = std::unique_ptr<EventDetector>();
        std::swap(detector, none);
        if constexpr (gathers)
            gather(k, x, dx), flush();
        else
            record(1, &k, x);
        std::swap(detector, none);
        return k;
    }

    INLINE void record(int64_t count, const int64_t* steps, const A* x) {
        if (__builtin_expect(detector != nullptr, 0)) {
            count = detect_events(count, steps, x);
            if (count == 0) return clear_slots();
        }
        record_steps(watch, constants, arrays, schedule, member, count, steps, saving, slot, x, arguments.at,
                     workspace.at);
        if (saving) clear_slots();
    }

    // Search steps for events, and return how many are to be recorded: until the run of the member ends, and, unless
    // all are watched, only saved ones.
    NOINLINE int64_t detect_events(int64_t count, const int64_t* steps, const A* x) {
        const int64_t square = arrays.square;
        int64_t good = 0;
        for (int64_t lane = 0; lane < count; ++lane) {
            for (int64_t i = 0; i < size; ++i) detector->x[i] = lane_of(x[i], int(lane));
            detector->crossings.after(steps[lane], detector->x.data(), detector->groups.data() + lane * square);
            if (!detector->crossings.continues(member, steps[lane])) {
                if (slot[lane] >= 0) std::fill_n(group_at(slot[lane]), square, NAN);
                continue;
            }
            if (!recording && slot[lane] < 0) continue;
            if constexpr (gathers)
                for (int64_t i = 0; i < size; ++i) set_lane(states.at[i], int(good), detector->x[i]);
            step[good] = steps[lane];
            slot[good++] = slot[lane];
        }
        return good;
    }

    double* group_at(int64_t position) const {
        return arrays.group + (position * arrays.members + member) * arrays.square;
    }
};

// Finished states of members as lanes, and their group elements if they are saved. Those of lanes that are `left_out`
// are not finite.
template <class A>
struct FinishedRows {
    const A *x, *group;
    const int64_t* left_out = nullptr;
};

// Members as lanes, watched at the same steps. Deviations of a lane are stored when a tenth of the run ends.
template <class A, class C>
class LaneRecorder {
  public:
    LaneRecorder(const Watch& watch, const Arrays& arrays, const Schedule& schedule, int64_t k0, const C& constants,
                 const int64_t* members, int64_t* active, int64_t count)
        : watch(watch), arrays(arrays), schedule(schedule), constants(constants), members(members), active(active),
          count(count), saved(schedule, k0), recording(schedule.watching || has_periods<A>(watch, constants)),
          first(watch.size), last(watch.size), worst(watch.size), arguments(watch.longest + 1),
          workspace(2 * watch.longest + 2) {
        each([&](int64_t lane, int64_t i) {
            set_lane(first.at[i], lane, arrays.first[members[lane] * watch.size + i]);
            set_lane(last.at[i], lane, arrays.last[members[lane] * watch.size + i]);
        });
        if (!schedule.events) return;
        crossings = std::make_unique<Crossings<A>>(schedule, arrays);
        crossings->begin(members, count, k0);
    }

    ~LaneRecorder() {
        if (crossings) crossings->end();
        store_worst();
        each([&](int64_t lane, int64_t i) { arrays.last[members[lane] * watch.size + i] = lane_of(last.at[i], lane); });
    }

    // Record the states after step k, if required: `finished(saving)` returns them.
    template <class Finish>
    INLINE void after(int64_t k, const Finish& finished) {
        if (!recording && !crossings && k != saved.next) return;
        const int64_t slot = k == saved.next ? saved.take() : -1;
        const FinishedRows<A> rows = finished(slot >= 0 || crossings);
        if (crossings && crossings->after(k, rows.x, rows.group, active)) release_ended(k);
        if (!recording && slot < 0) return;
        record(k, slot, rows.x);
        if (slot < 0) return;
        save(slot, rows);
        for (int64_t lane = 0; rows.left_out && lane < count; ++lane)
            if (active[lane] && rows.left_out[lane]) leave_out(members[lane], slot, k);
    }

    // Whether states that are not finite end a run: events cannot be found there.
    bool ends_where_infinite() const { return crossings != nullptr; }

    // Store the deviations so far of a lane that is about to stop; to be called before it does.
    void store_worst() {
        if (tenth < 0) return;
        each([&](int64_t lane, int64_t i) {
            if (active[lane]) worst_of(lane, i) = lane_of(worst.at[i], lane);
        });
    }

    // Count the deviations after step k of lanes that stop in it although their momenta are finite: those not `valid`.
    template <class Mask>
    NOINLINE void record_before_stop(int64_t k, const A* x, const Mask& valid) {
        if (!recording) return;
        if (schedule.watching) enter_tenth(k);
        const std::vector<A> others_last(last.at, last.at + watch.size), others_worst(worst.at, worst.at + watch.size);
        record(k, -1, x);
        each([&](int64_t lane, int64_t i) {
            if (!at(valid, int(lane))) return;
            set_lane(last.at[i], int(lane), lane_of(others_last[i], int(lane)));
            set_lane(worst.at[i], int(lane), lane_of(others_worst[i], int(lane)));
        });
    }

  private:
    static constexpr int lanes = Numbers<A>::lanes;
    const Watch& watch;
    const Arrays& arrays;
    const Schedule& schedule;
    const C& constants;
    const int64_t* members;
    int64_t* active;
    const int64_t count;
    SavedSteps saved;
    const bool recording;
    AlignedArray<A> first, last, worst, arguments;
    AlignedArray<double> workspace;
    int64_t tenth = -1;
    std::unique_ptr<Crossings<A>> crossings;

    // Stop recording lanes whose runs have been ended by events before step k.
    void release_ended(int64_t k) {
        store_worst();
        for (int64_t lane = 0; lane < count; ++lane)
            if (active[lane]) active[lane] = crossings->continues(members[lane], k);
        crossings->find_next_end(active);
    }

    // Switch to the largest deviations of the tenth of the run that contains step k.
    void enter_tenth(int64_t k) {
        const int64_t now = tenth_of(schedule, k);
        if (now == tenth) return;
        store_worst();
        tenth = now;
        each([&](int64_t lane, int64_t i) { set_lane(worst.at[i], lane, worst_of(lane, i)); });
    }

    // For a step that is neither saved nor watched only whole periods are counted.
    void record(int64_t k, int64_t slot, const A* x) {
        const bool watched = schedule.watching || slot >= 0;
        if (watched) enter_tenth(k);
        A t(schedule.t0 + double(k) * schedule.h);
        for (int64_t lane = 0; schedule.starts && lane < lanes; ++lane)
            set_lane(t, int(lane), start_of(schedule, members[std::min(lane, count - 1)], k + 1));
        for (int64_t i = 0; i < watch.size; ++i) {
            const A period = constants.template number_at<A>(watch.period, i);
            if (!watched && all(period <= A(0.0))) continue;
            A now = value_of(watch, constants, i, x, t, arguments.at, workspace.at);
            for (int64_t lane = 0; lane < count; ++lane)
                if (double whole = lane_of(period, lane); whole > 0.0)
                    set_lane(now, int(lane), unwrapped(lane_of(now, lane), lane_of(last.at[i], lane), whole));
            last.at[i] = now;
            if (!watched) continue;
            const A deviation = absolute(now - first.at[i]);
            worst.at[i] = select((deviation <= worst.at[i]) | !(worst.at[i] == worst.at[i]), worst.at[i], deviation);
            if (slot < 0) continue;
            for (int64_t lane = 0; lane < count; ++lane)
                if (active[lane])
                    arrays.values[(slot * arrays.members + members[lane]) * watch.size + i] = lane_of(now, lane);
        }
    }

    void save(int64_t slot, const FinishedRows<A>& rows) {
        const int64_t size = arrays.size, square = arrays.square;
        for (int64_t lane = 0; lane < count; ++lane)
            if (active[lane]) save_state(arrays, members[lane], slot, size, rows.x, int(lane));
        for (int64_t lane = 0; square > 0 && lane < count; ++lane) {
            double* element = arrays.group + (slot * arrays.members + members[lane]) * square;
            for (int64_t i = 0; active[lane] && i < square; ++i) element[i] = lane_of(rows.group[i], int(lane));
        }
    }

    void leave_out(int64_t member, int64_t slot, int64_t k) const {
        const int64_t row = slot * arrays.members + member;
        std::fill_n(arrays.x + row * arrays.size, arrays.size, NAN);
        std::fill_n(arrays.values + row * watch.size, watch.size, NAN);
        std::fill_n(arrays.group + row * arrays.square, arrays.square, NAN);
        arrays.left_out(member, k);
    }

    double& worst_of(int64_t lane, int64_t i) {
        return arrays.worst[(members[lane] * TENTHS + tenth) * watch.size + i];
    }

    template <class Visit>
    void each(Visit visit) {
        for (int64_t i = 0; i < watch.size; ++i)
            for (int64_t lane = 0; lane < count; ++lane) visit(lane, i);
    }
};

}  // namespace coadjoint
