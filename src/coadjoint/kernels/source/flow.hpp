// The loop over steps for programs: flow methods read from their table.
#pragma once

#include <optional>

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

// Apply row r: angles from its share, then the action on the momentum and on the group element.
template <Care care, bool carry, class A, class G, class C>
INLINE void apply_row(const FlowTables& tables, const C& constants, uint32_t r, const Vectors<A>& x,
                      const Vectors<G>& group, const A& t, double h, AngleRoom<A>& room) {
    const Terms& terms = tables.terms;
    const uint32_t part = tables.part[r];
    const int64_t row = tables.only[part];
    const double tau = tables.tau[r];
    const bool single = row >= 0;
    A lone(0.0);
    if (__builtin_expect(single, 1)) {
        lone = linear_row(terms, constants, row, x.at);
    } else {
        const uint32_t low = tables.share[part], high = tables.share[part + 1];
        const A moment = t + A(tables.moment[r] * h);
        for (uint32_t k = low; k < high; ++k)
            gradient_rows(terms, constants, tables.addresses, k, x.at, moment, room.theta.at, terms.row[low],
                          room.arguments.at, room.calls.data());
    }
    Turned<A> turned;
    act<care, false>(tables.state, constants, part, tau, single, lone, room.theta.at, turned, x);
    if constexpr (carry) {
        if (__builtin_expect(tables.bent[part], 0)) {
            const int64_t base = single ? row : terms.row[tables.share[part]];
            const int64_t stop = single ? row + 1 : terms.row[tables.share[part + 1]];
            for (int64_t place = base; place < stop; ++place)
                room.turned.at[place - base] =
                    rational_angle(tau * (single ? lone : room.theta.at[place - base]),
                                   constants.template number_at<A>(tables.frequency, place));
            act<CORRECTED, true>(tables.group, constants, part, 1.0, false, lone, room.turned.at, turned, group);
        } else {
            act<CORRECTED, true>(tables.group, constants, part, tau, single, lone, room.theta.at, turned, group);
        }
    }
}

template <Care care, bool carry, class A, class G, class C>
NOINLINE void sweep(const FlowTables& tables, const C& constants, uint32_t first, uint32_t last, const Vectors<A>& x,
                    const Vectors<G>& group, const A& t, double h, AngleRoom<A>& room) {
    for (uint32_t r = first; r < last; ++r) apply_row<care, carry>(tables, constants, r, x, group, t, h, room);
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
        for (uint32_t r = tables.section[k == 1 ? 0 : 1], last = tables.section[k == 1 ? 1 : 2]; r < last; ++r)
            apply_row<care, carry>(tables, Shared{}, r, momentum, group, t, schedule.h, angles);
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

// Blocks of members as lanes; the last member fills what is left of the lanes. While one block waits for a sine, another
// goes on.
template <Care care, bool carry, class A, class C>
struct Block {
    const Loop& loop;
    const C constants;
    const int64_t* members;
    const int64_t count, size, square;
    Room<A> momenta, elements;
    int64_t going[Numbers<A>::lanes], left = 0, evaluations = 0;
    CrowdWatcher<A, C> watcher;
    Vectors<A> momentum, group;

    Block(const Loop& loop, const C& constants, const int64_t* members, int64_t count, Room<A>& scratch)
        : loop(loop), constants(constants), members(members), count(count), size(loop.state.size),
          square(loop.state.square), momenta(2 * size), elements(2 * square), going{},
          watcher(loop.watch, loop.saves, loop.schedule, this->constants, members, going, count),
          momentum{momenta.at, momenta.at + size, 1, scratch.at},
          group{elements.at, elements.at + square, loop.tables.group.size, scratch.at} {
        for (int64_t lane = 0; lane < count; ++lane) left += going[lane] = loop.report.status[members[lane]] == DONE;
        read(momentum.at, loop.state.momenta, size);
        read(momentum.errors, loop.state.errors, size);
        read(group.at, loop.state.groups, square);
        read(group.errors, loop.state.group_errors, square);
    }

    ~Block() {
        for (int64_t lane = 0; lane < count; ++lane)
            if (going[lane]) loop.report.evaluations[members[lane]] += evaluations;
        write(momentum.at, loop.state.momenta, size);
        write(momentum.errors, loop.state.errors, size);
        write(group.at, loop.state.groups, square);
        write(group.errors, loop.state.group_errors, square);
    }

    template <class Mask>
    void stop_where_not(const Mask& sound, int64_t k) {
        if (__builtin_expect(all(sound), 1)) return;
        for (int64_t lane = 0; lane < count; ++lane) {
            if (at(sound, int(lane)) || !going[lane]) continue;
            watcher.keep_worst();
            going[lane] = 0;
            --left;
            loop.report.status[members[lane]] = OVERFLOWED;
            loop.report.step[members[lane]] = k;
            loop.report.evaluations[members[lane]] += evaluations;
        }
    }

    // Finish copies, note them, and save what has a slot.
    NOINLINE void look(int64_t k, int64_t slot, const A& t, A* copies, A* scratch, AngleRoom<A>& angles) {
        const uint32_t first = loop.tables.section[2], last = loop.tables.section[3];
        A* element = copies + 2 * size;
        const Vectors<A> copy{copies, copies + size, 1, scratch};
        std::copy_n(momentum.at, 2 * size, copies);
        if (carry && slot >= 0) {
            std::copy_n(group.at, 2 * square, element);
            const Vectors<A> finished{element, element + square, group.rows, scratch};
            sweep<care, carry>(loop.tables, constants, first, last, copy, finished, t, loop.schedule.h, angles);
            stop_where_not(finite(square, element), k);
        } else {
            sweep<care, false>(loop.tables, constants, first, last, copy, Vectors<A>{}, t, loop.schedule.h, angles);
        }
        stop_where_not(finite(size, copies), k);
        watcher.note(k, slot, size, copies);
        if (!carry || slot < 0) return;
        for (int64_t lane = 0; lane < count; ++lane) {
            double* place = loop.saves.group + (slot * loop.saves.members + members[lane]) * square;
            for (int64_t i = 0; going[lane] && i < square; ++i) place[i] = lane_of(element[i], int(lane));
        }
    }

  private:
    void read(A* to, const double* from, int64_t length) {
        for (int64_t i = 0; i < length; ++i)
            for (int64_t lane = 0; lane < Numbers<A>::lanes; ++lane)
                set_lane(to[i], int(lane), from[members[std::min(lane, count - 1)] * length + i]);
    }

    void write(const A* from, double* to, int64_t length) {
        for (int64_t lane = 0; lane < count; ++lane)
            for (int64_t i = 0; i < length; ++i) to[members[lane] * length + i] = lane_of(from[i], int(lane));
    }
};

constexpr int BLOCKS = 2;

// `constants_from(place)` are those of the lanes from a place of the crew.
template <Care care, bool carry, class A, class ConstantsFrom>
void follow_together(const Loop& loop, const ConstantsFrom& constants_from, const int64_t* members, int64_t first,
                     int64_t last) {
    typedef Block<care, carry, A, decltype(constants_from(0))> Own;
    constexpr int64_t lanes = Numbers<A>::lanes;
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.state.size, square = loop.state.square;
    Room<A> scratch(3 * std::max(size, square)), copies(2 * (size + square));
    AngleRoom<A> angles(tables.longest);
    std::optional<Own> blocks[BLOCKS];
    int used = 0;
    for (int64_t place = first; place < last; place += lanes)
        blocks[used++].emplace(loop, constants_from(place), members + place, std::min(lanes, last - place), scratch);
    int64_t saved = next_saved(schedule, loop.k0);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        const A t(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t from = tables.section[k == 1 ? 0 : 1], to = tables.section[k == 1 ? 1 : 2];
        for (uint32_t r = from; r < to; ++r)
            for (int b = 0; b < used; ++b)
                apply_row<care, carry>(tables, blocks[b]->constants, r, blocks[b]->momentum, blocks[b]->group, t,
                                       schedule.h, angles);
        const bool looking = schedule.watching || k == saved;
        const int64_t slot = k == saved ? slot_of(schedule, k) : -1;
        int64_t left = 0;
        for (int b = 0; b < used; ++b) {
            blocks[b]->evaluations += to - from;
            blocks[b]->stop_where_not(finite(size, blocks[b]->momentum.at), k);
            if (looking) blocks[b]->look(k, slot, t, copies.at, scratch.at, angles);
            left += blocks[b]->left;
        }
        if (k == saved) saved = next_saved(schedule, k);
        if (left == 0) break;
    }
}

template <Care care, bool carry>
void advance_crew(const Loop& loop, const Crew& crew, const Varied* varied) {
    typedef Lanes<CROWD> Crowd;
    const auto shared = [](int64_t) { return Shared{}; };
    const auto own = [&](int64_t place) { return Varied{varied->stride, place}; };
    int64_t place = crew.first;
    const bool narrow = loop.state.size <= WIDEST;
    while (place < crew.last && (varied || (narrow && crew.last - place >= FEWEST))) {
        const int64_t next = std::min<int64_t>(place + BLOCKS * CROWD, crew.last);
        if (varied)
            follow_together<care, carry, Crowd>(loop, own, crew.members, place, next);
        else
            follow_together<care, carry, Crowd>(loop, shared, crew.members, place, next);
        place = next;
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
