// The loop over steps for programs: flow methods read from their table.
#pragma once

#include "actions.hpp"
#include "crew.hpp"

// Room for the angles of a part and for the calls of user functions.
template <class A>
struct AngleRoom {
    Room<A> theta, turned, arguments;
    std::vector<double> calls;
    explicit AngleRoom(int64_t longest)
        : theta(longest), turned(longest), arguments(longest), calls(2 * longest + 2) {}
};

// Apply the rows first to last - 1: angles from the shares, then the action on the momentum and on the group element.
template <Care care, bool carry, class A, class G, class C>
NOINLINE void sweep(const FlowTables& tables, const C& constants, uint32_t first, uint32_t last, const Vectors<A>& x,
                  const Vectors<G>& group, const A& t, double h, AngleRoom<A>& room) {
    const Terms& terms = tables.terms;
    for (uint32_t r = first; r < last; ++r) {
        const uint32_t part = tables.part[r];
        const int64_t row = tables.only[part];
        const double tau = tables.tau[r];
        Angles<A> angles{row >= 0, A(0.0), room.theta.at};
        if (angles.single) {
            angles.lone = linear_row(terms, constants, row, x.at);
        } else {
            const uint32_t low = tables.share[part], high = tables.share[part + 1];
            const A moment = t + A(tables.moment[r] * h);
            for (uint32_t k = low; k < high; ++k)
                gradient_rows(terms, constants, tables.addresses, k, x.at, moment, room.theta.at, terms.row[low],
                              room.arguments.at, room.calls.data());
        }
        act<care>(tables.state, constants, part, tau, angles, x);
        if constexpr (carry) {
            if (tables.bent[part]) {
                auto turned = [&](const A& angle, int64_t place) {
                    return rational_angle(tau * angle, constants.template number_at<A>(tables.frequency, place));
                };
                Angles<A> bent{angles.single, A(0.0), room.turned.at};
                if (angles.single) {
                    bent.lone = turned(angles.lone, row);
                } else {
                    const int64_t base = terms.row[tables.share[part]], stop = terms.row[tables.share[part + 1]];
                    for (int64_t place = base; place < stop; ++place)
                        room.turned.at[place - base] = turned(room.theta.at[place - base], place);
                }
                act<CORRECTED>(tables.group, constants, part, 1.0, bent, group);
            } else {
                act<CORRECTED>(tables.group, constants, part, tau, angles, group);
            }
        }
    }
}

struct Loop {
    const FlowTables& tables;
    const Watch& watch;
    const Saves& saves;
    const Schedule& schedule;
    const State& state;
    const Report& report;
    int64_t k0, k1;
};

// One trajectory: the rows of its group element as lanes, its finished states as lanes of steps.
constexpr int ROWS = 4;
typedef Lanes<ROWS> GroupRows;

template <Care care, class A>
struct Finisher {
    static constexpr bool with_errors = care != PLAIN;
    const FlowTables& tables;
    const Schedule& schedule;
    Room<A> scratch;
    AngleRoom<A> angles;

    Finisher(const FlowTables& tables, const Schedule& schedule, int64_t size)
        : tables(tables), schedule(schedule), scratch(3 * size), angles(tables.longest) {}

    void operator()(A* x, A* dx, const A& t) {
        sweep<care, false>(tables, Shared{}, tables.section[2], tables.section[3], Vectors<A>{x, dx, 1, scratch.at},
                           Vectors<A>{}, t, schedule.h, angles);
    }
};

template <Care care, bool carry, class Side>
void follow_alone(const Loop& loop, int64_t member) {
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const State& state = loop.state;
    const int64_t size = state.size, d = tables.group.size, rows = (d + ROWS - 1) / ROWS;
    Room<double> scratch(3 * size), copies(2 * size), momenta(2 * size);
    Room<GroupRows> elements(2 * d * rows), finished(2 * d * rows), group_scratch(3 * d * rows);
    AngleRoom<double> angles(tables.longest);
    Finisher<care, Side> finisher(tables, schedule, size);
    Follower<Side, Finisher<care, Side>> follower(loop.watch, loop.saves, schedule, size, finisher);
    double *x = momenta.at, *dx = momenta.at + size;
    std::copy_n(state.momenta + member * size, size, x);
    std::copy_n(state.errors + member * size, size, dx);
    const Vectors<GroupRows> group{elements.at, elements.at + d * rows, rows, group_scratch.at};
    auto each_entry = [&](auto&& visit) {
        for (int64_t i = 0; i < d; ++i)
            for (int64_t r = 0; r < d; ++r) visit(i * d + r, (i * rows + r / ROWS) * ROWS + r % ROWS);
    };
    double *g = reinterpret_cast<double*>(group.at), *dg = reinterpret_cast<double*>(group.errors);
    if constexpr (carry)
        each_entry([&](int64_t from, int64_t to) {
            g[to] = state.groups[member * d * d + from];
            dg[to] = state.group_errors[member * d * d + from];
        });
    const Vectors<double> momentum{x, dx, 1, scratch.at};
    int64_t saved = next_saved(schedule, loop.k0), failed = 0;
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        const double t = schedule.t0 + double(k - 1) * schedule.h;
        sweep<care, carry>(tables, Shared{}, tables.section[k == 1 ? 0 : 1], tables.section[k == 1 ? 1 : 2], momentum,
                           group, t, schedule.h, angles);
        if (!finite(size, x)) {
            failed = k;
            break;
        }
        if (!schedule.watching && k != saved) continue;
        follower.push(member, k, x, dx);
        if (k == saved) {
            saved = next_saved(schedule, k);
            if constexpr (carry) {
                std::copy_n(x, 2 * size, copies.at);
                std::copy_n(elements.at, 2 * d * rows, finished.at);
                const Vectors<GroupRows> copy{finished.at, finished.at + d * rows, rows, group_scratch.at};
                sweep<care, true>(tables, Shared{}, tables.section[2], tables.section[3],
                                  Vectors<double>{copies.at, copies.at + size, 1, scratch.at}, copy, t, schedule.h,
                                  angles);
                const double* element = reinterpret_cast<double*>(finished.at);
                double* to = loop.saves.group + (slot_of(schedule, k) * loop.saves.members + member) * d * d;
                bool sound = true;
                each_entry([&](int64_t place, int64_t from) {
                    to[place] = element[from];
                    sound &= 0.0 * element[from] == 0.0;
                });
                if (!sound) {
                    failed = k;
                    break;
                }
            }
        }
        if (follower.full() && (failed = follower.flush())) break;
    }
    if (int64_t earlier = follower.flush()) failed = earlier;
    const int64_t taken = (failed ? failed : loop.k1) - loop.k0, start = loop.k0 == 0 && taken > 0;
    loop.report.evaluations[member] += start * (int64_t(tables.section[1]) - tables.section[0]) +
                                       (taken - start) * (int64_t(tables.section[2]) - tables.section[1]);
    if (failed) {
        loop.report.status[member] = OVERFLOWED;
        loop.report.step[member] = failed;
    }
    std::copy_n(x, size, state.momenta + member * size);
    std::copy_n(dx, size, state.errors + member * size);
    if constexpr (carry)
        each_entry([&](int64_t to, int64_t from) {
            state.groups[member * d * d + to] = g[from];
            state.group_errors[member * d * d + to] = dg[from];
        });
}

// A block of members as lanes; the last one fills what is left of the lanes.
template <Care care, bool carry, class A, class C>
void follow_together(const Loop& loop, const C& constants, const int64_t* members, int64_t count) {
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const State& state = loop.state;
    constexpr int lanes = Numbers<A>::lanes;
    const int64_t size = state.size, d = tables.group.size, square = state.square;
    Room<A> scratch(3 * size), copies(2 * size), momenta(2 * size);
    Room<A> elements(2 * square), finished(2 * square), group_scratch(3 * square);
    AngleRoom<A> angles(tables.longest);
    auto member_of = [&](int64_t lane) { return members[std::min<int64_t>(lane, count - 1)]; };
    auto read = [&](A* to, const double* from, int64_t length) {
        for (int64_t i = 0; i < length; ++i)
            for (int lane = 0; lane < lanes; ++lane) set_lane(to[i], lane, from[member_of(lane) * length + i]);
    };
    auto write = [&](const A* from, double* to, int64_t length) {
        for (int64_t lane = 0; lane < count; ++lane)
            for (int64_t i = 0; i < length; ++i) to[members[lane] * length + i] = lane_of(from[i], int(lane));
    };
    read(momenta.at, state.momenta, size);
    read(momenta.at + size, state.errors, size);
    read(elements.at, state.groups, square);
    read(elements.at + square, state.group_errors, square);
    const Vectors<A> momentum{momenta.at, momenta.at + size, 1, scratch.at};
    const Vectors<A> group{elements.at, elements.at + square, d, group_scratch.at};
    int64_t going[lanes], left = 0, evaluations = 0;
    for (int64_t lane = 0; lane < count; ++lane)
        left += going[lane] = loop.report.status[members[lane]] == DONE;
    CrowdWatcher<A, C> watcher(loop.watch, loop.saves, schedule, constants, members, going, count);
    auto stop = [&](int64_t lane, int64_t k) {
        if (!going[lane]) return;
        watcher.keep_worst();
        going[lane] = 0;
        --left;
        loop.report.status[members[lane]] = OVERFLOWED;
        loop.report.step[members[lane]] = k;
        loop.report.evaluations[members[lane]] += evaluations;
    };
    int64_t saved = next_saved(schedule, loop.k0);
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && left > 0; ++k) {
        const A t(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t first = tables.section[k == 1 ? 0 : 1], last = tables.section[k == 1 ? 1 : 2];
        sweep<care, carry>(tables, constants, first, last, momentum, group, t, schedule.h, angles);
        evaluations += last - first;
        auto sound = finite(size, momentum.at);
        if (__builtin_expect(!all(sound), 0))
            for (int64_t lane = 0; lane < count; ++lane)
                if (!at(sound, int(lane))) stop(lane, k);
        if (!schedule.watching && k != saved) continue;
        std::copy_n(momenta.at, 2 * size, copies.at);
        const Vectors<A> copy{copies.at, copies.at + size, 1, scratch.at};
        const uint32_t from = tables.section[2], to = tables.section[3];
        if (carry && k == saved) {
            std::copy_n(elements.at, 2 * square, finished.at);
            sweep<care, carry>(tables, constants, from, to, copy,
                              Vectors<A>{finished.at, finished.at + square, d, group_scratch.at}, t, schedule.h, angles);
            sound = finite(square, finished.at);
        } else {
            sweep<care, false>(tables, constants, from, to, copy, Vectors<A>{}, t, schedule.h, angles);
        }
        sound = sound & finite(size, copies.at);
        if (__builtin_expect(!all(sound), 0))
            for (int64_t lane = 0; lane < count; ++lane)
                if (!at(sound, int(lane))) stop(lane, k);
        const int64_t slot = k == saved ? slot_of(schedule, k) : -1;
        watcher.note(k, slot, size, copies.at);
        if (slot < 0) continue;
        saved = next_saved(schedule, k);
        if constexpr (carry)
            for (int64_t lane = 0; lane < count; ++lane)
                if (going[lane]) {
                    double* place = loop.saves.group + (slot * loop.saves.members + members[lane]) * square;
                    for (int64_t i = 0; i < square; ++i) place[i] = lane_of(finished.at[i], int(lane));
                }
    }
    for (int64_t lane = 0; lane < count; ++lane)
        if (going[lane]) loop.report.evaluations[members[lane]] += evaluations;
    write(momenta.at, state.momenta, size);
    write(momenta.at + size, state.errors, size);
    write(elements.at, state.groups, square);
    write(elements.at + square, state.group_errors, square);
}

template <Care care, bool carry>
void advance_crew(const Loop& loop, const Crew& crew, const Varied* varied) {
    typedef Lanes<CROWD> Crowd;
    int64_t place = crew.first;
    const bool narrow = loop.state.size <= WIDEST;
    for (; place < crew.last && (varied || (narrow && crew.last - place >= FEWEST)); place += CROWD) {
        const int64_t count = std::min<int64_t>(CROWD, crew.last - place);
        if (varied)
            follow_together<care, carry, Crowd>(loop, Varied{varied->stride, place}, crew.members + place, count);
        else
            follow_together<care, carry, Crowd>(loop, Shared{}, crew.members + place, count);
    }
    for (; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.report.status[member] != DONE) continue;
        if (narrow)
            follow_alone<care, carry, Crowd>(loop, member);
        else
            follow_alone<care, carry, double>(loop, member);
    }
}
