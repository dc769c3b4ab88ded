// The rows of a program, read from their table, and the arguments of a loop over steps.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "flows/bonds.hpp"
#include "boundary/loop.hpp"

namespace coadjoint {

// Find the linear terms of many rows that share one offset and one weight, as on a lattice in a uniform field. Only the
// columns of such a term are read in each step. Constants are those of one system.
inline std::vector<bool> even_terms(const Terms& terms, int64_t longest) {
    constexpr int64_t many = 1024;
    std::vector<bool> even;
    if (longest < many || terms.repeated) return even;
    even.resize(terms.size);
    for (int64_t k = 0; k < terms.size; ++k) {
        const uint32_t row = terms.row[k], stop = terms.row[k + 1];
        if (terms.kind[k] != LINEAR || stop - row < many) continue;
        auto alike = [](const double* all, uint32_t first, uint32_t last) {
            uint64_t different = 0;
            for (uint32_t k = first; k < last; ++k) {
                uint64_t bits[2];
                std::memcpy(&bits[0], all + first, 8), std::memcpy(&bits[1], all + k, 8);
                different |= bits[0] ^ bits[1];
            }
            return different == 0;
        };
        const uint32_t entry = terms.entry[row], end = terms.entry[stop];
        even[k] = entry < end && alike(terms.offset, row, stop) && alike(terms.weight, entry, end);
    }
    return even;
}

template <int length, class A>
INLINE void rows_of_length(const A& offset, const A& weight, const uint32_t* column, uint32_t count, const A* x,
                           A* out) {
    for (uint32_t row = 0; row < count; ++row, column += length) {
        A total = offset;
#pragma GCC unroll 8
        for (int e = 0; e < length; ++e) total = fma(weight, x[column[e]], total);
        out[row] = total;
    }
}

// The rows start to stop - 1 of such a term k, as by `gradient_rows`. Sites with the usual numbers of neighbours have
// loops of their own.
template <class A>
NOINLINE void even_rows(const Terms& terms, uint32_t k, uint32_t start, uint32_t stop, const A* x, A* out) {
    const uint32_t *entry = terms.entry, *column = terms.column;
    // Rows may be empty, also the last ones; the term is not.
    const A offset(terms.offset[start]), weight(terms.weight[entry[terms.row[k]]]);
    const uint32_t length = entry[start + 1] - entry[start], *first = column + entry[start];
    bool equal = true;
    for (uint32_t row = start; row < stop; ++row) equal &= entry[row + 1] - entry[row] == length;
    if (equal) switch (length) {
            case 2: return rows_of_length<2>(offset, weight, first, stop - start, x, out);
            case 3: return rows_of_length<3>(offset, weight, first, stop - start, x, out);
            case 4: return rows_of_length<4>(offset, weight, first, stop - start, x, out);
            case 6: return rows_of_length<6>(offset, weight, first, stop - start, x, out);
            default: break;
        }
    for (uint32_t row = start, e = entry[start]; row < stop; ++row) {
        A total = offset;
        for (const uint32_t last = entry[row + 1]; e < last; ++e) total = fma(weight, x[column[e]], total);
        *out++ = total;
    }
}

inline bool is_called(const FlowTables& tables, uint32_t part) { return tables.called[tables.share[part]] >= 0; }

constexpr int64_t FUSED = 256;  // angles of a part that are rotated by at a time

// Angles and rotations of a part whose rotations may follow their angles, a few at a time.
template <Summation summation, class A, class C>
NOINLINE void rotate_fused(const FlowTables& tables, const C& constants, uint32_t part, double tau,
                           const Vectors<A>& x, bool even) {
    const Action& action = tables.state;
    const Terms& terms = tables.terms;
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run)
        share(action.angles[run], [&](int64_t first, int64_t last) {
            A theta[FUSED];
            const uint32_t origin = terms.row[tables.share[part]] + action.angle[run];
            for (int64_t q = first; q < last; q += FUSED) {
                const uint32_t begin = uint32_t(q), end = uint32_t(std::min(last, q + FUSED));
                if (terms.repeated)
                    repeated_rows<true>(terms, origin + begin, origin + end, x.at, theta);
                else if (even)
                    even_rows(terms, tables.share[part], origin + begin, origin + end, x.at, theta);
                else
                    for (uint32_t angle = begin; angle < end; ++angle)
                        theta[angle - begin] = linear_row(terms, constants, origin + angle, x.at);
                rotate_several<summation>(action, constants, run, tau, theta, x, begin, end);
            }
        });
}

// Whether threads share the runs of a part.
inline bool shares_runs(const FlowTables& tables, uint32_t part) {
    return (tables.properties[part] & APART) && team_of_this_thread;
}

// Call `visit(run, first, last)` for the angles of all runs of a part, whose coordinates differ from those of the other
// runs if they are `apart`, and within a run from those of its other angles.
template <class Visit>
INLINE void share_runs(const Action& action, uint32_t part, bool apart, const Visit& visit) {
    const uint32_t begin = action.run[part], end = action.run[part + 1];
    if (apart)
        return share(end - begin, [&](int64_t first, int64_t last) {
            for (uint32_t run = begin + uint32_t(first); run < begin + uint32_t(last); ++run)
                visit(run, uint32_t(0), action.angles[run]);
        });
    for (uint32_t run = begin; run < end; ++run)
        share(action.angles[run],
              [&](int64_t first, int64_t last) { visit(run, uint32_t(first), uint32_t(last)); });
}

// `act` for a part whose runs move different coordinates.
template <Summation summation, class A, class V, class C>
NOINLINE void act_apart(const Action& action, const C& constants, uint32_t part, double tau, const A* theta,
                        const Vectors<V>& x) {
    const uint32_t begin = action.run[part], end = action.run[part + 1];
    const uint32_t widest = *std::max_element(action.width + begin, action.width + end);
    share(end - begin, [&](int64_t first, int64_t last) {
        AlignedArray<V> scratch(3 * widest * x.rows);
        Vectors<V> here = x;
        here.workspace = scratch.at;
        for (uint32_t run = begin + uint32_t(first); run < begin + uint32_t(last); ++run)
            act_slice<summation>(action, constants, run, tau, theta + action.angle[run], here, 0, action.angles[run]);
    });
}

// A step of another length than that of the tables: every angle is scaled by `scale`.
template <class A>
struct PartialStep {
    A start, length, scale;
    bool needed = false;  // true for all given lengths, so that the bits do not depend on other members
    void set(const FlowTables& tables, const Schedule& schedule, int64_t member, int lane) {
        const double own_length = length_of(schedule, member);
        set_lane(start, lane, start_of(schedule, member, 1));
        set_lane(length, lane, own_length);
        set_lane(scale, lane, own_length / tables.step);
        needed = schedule.lengths || own_length != tables.step;
    }
};

// Scratch memory for the angles of a part and for the calls of user functions, and properties of the terms.
template <class A>
struct AngleWorkspace {
    const PartialStep<A>* partial_step = nullptr;  // of a step of another length
    AlignedArray<A> theta, rotated, arguments;
    AlignedArray<double> calls;
    std::vector<bool> even;
    bool following = false;  // rotations follow their angles where they may
    explicit AngleWorkspace(int64_t longest)
        : theta(longest), rotated(longest), arguments(longest), calls(2 * longest + 2) {}
    // For programs whose constants are those of one system.
    void use_properties(const FlowTables& tables) {
        even = even_terms(tables.terms, tables.longest);
        following = true;
    }
};

// The angles of a part, share by share, in workspace.theta.
template <class A, class C>
INLINE void find_angles(const FlowTables& tables, const C& constants, uint32_t part, const A* x, const A& moment,
                        AngleWorkspace<A>& workspace) {
    const Terms& terms = tables.terms;
    const uint32_t low = tables.share[part], high = tables.share[part + 1], base = terms.row[low];
    for (uint32_t k = low; k < high; ++k)
        if (!workspace.even.empty() && workspace.even[k])
            share(terms.row[k + 1] - terms.row[k], [&](int64_t first, int64_t last) {
                const uint32_t start = terms.row[k] + uint32_t(first);
                even_rows(terms, k, start, terms.row[k] + uint32_t(last), x, workspace.theta.at + (start - base));
            });
        else
            gradient_rows(terms, constants, tables.addresses, k, x, moment, workspace.theta.at, base,
                          workspace.arguments.at, workspace.calls.at);
}

// The rotations of a part with called shares.
template <class A, class C>
Rotations<A> rotations_of_part(const FlowTables& tables, const C& constants, uint32_t part, const A& tau, const A* x,
                               AngleWorkspace<A>& workspace, int64_t* too_long = nullptr) {
    const Rotations<A> rotations{workspace.theta.at, workspace.rotated.at, workspace.arguments.at,
                                 (tables.properties[part] & DIRECT) != 0};
    const uint32_t begin = tables.share[part], origin = tables.terms.row[begin];
    share(tables.share[part + 1] - begin, [&](int64_t first, int64_t last) {
        for (uint32_t k = begin + uint32_t(first); k < begin + uint32_t(last); ++k) {
            const uint32_t angle = tables.terms.row[k] - origin;
            called_rotations(tables, constants, tables.called[k], tau, x,
                             Rotations<A>{rotations.angle + angle, rotations.sine + angle, rotations.cosm1 + angle,
                                          rotations.direct},
                             too_long);
        }
    });
    return rotations;
}

// Whether a part consists of bonds that rotate momenta directly. Compensated sums use the blocks.
template <Summation summation>
bool rotates_bonds_directly(const FlowTables& tables, uint32_t part) {
    return summation == PLAIN && (tables.properties[part] & BONDS) != 0;
}

// Apply row r: angles from its share, then the action on the momentum and on the group element.
template <Summation summation, bool with_group, class A, class G, class C>
INLINE void apply_row(const FlowTables& tables, const C& constants, uint32_t r, const Vectors<A>& x,
                      const Vectors<G>& group, const A& t, double h, AngleWorkspace<A>& workspace) {
    const Terms& terms = tables.terms;
    const uint32_t part = tables.part[r];
    const int64_t row = tables.only[part];
    const double tau = tables.tau[r];
    const bool single = row >= 0;
    const PartialStep<A>* partial_step = workspace.partial_step;
    A single_angle(0.0);
    if (__builtin_expect(single, 1)) {
        single_angle = linear_row(terms, constants, row, x.at);
        if (partial_step) single_angle = single_angle * partial_step->scale;
    } else {
        const uint32_t low = tables.share[part], high = tables.share[part + 1];
        if (tables.called[low] >= 0) {
            const bool direct_bonds = rotates_bonds_directly<summation>(tables, part) && !partial_step;
            Rotations<A> rotations{};
            if (partial_step)
                rotations = rotations_of_part(tables, constants, part, tau * partial_step->scale, x.at, workspace, x.too_long);
            else if (with_group || !direct_bonds)
                rotations = rotations_of_part(tables, constants, part, A(tau), x.at, workspace, x.too_long);
            if (direct_bonds)
                rotate_bonds(tables, constants, part, tau, x.at);
            else
                act_called<summation>(tables.state, constants, part, rotations, x, tables.state.size);
            if constexpr (with_group)
                act_called<CORRECTED>(tables.group, constants, part, rotations, group, tables.group.size);
            return;
        }
        if (!with_group && !partial_step &&
            __builtin_expect(workspace.following && (tables.properties[part] & FOLLOWING), 0)) {
            const bool even = high == low + 1 && !workspace.even.empty() && workspace.even[low];
            return rotate_fused<summation>(tables, constants, part, tau, x, even);
        }
        const A moment = t + (partial_step ? A(tables.moment[r]) * partial_step->length : A(tables.moment[r] * h));
        if (shares_runs(tables, part))
            share(terms.row[high] - terms.row[low], [&](int64_t first, int64_t last) {
                if (terms.repeated)
                    return repeated_rows<true>(terms, terms.row[low] + first, terms.row[low] + last, x.at,
                                               workspace.theta.at + first);
                for (uint32_t angle = uint32_t(first); angle < last; ++angle)
                    workspace.theta.at[angle] = linear_row(terms, constants, terms.row[low] + angle, x.at);
            });
        else
            find_angles(tables, constants, part, x.at, moment, workspace);
        if (partial_step)
            share(terms.row[high] - terms.row[low], [&](int64_t first, int64_t last) {
                for (int64_t angle = first; angle < last; ++angle)
                    workspace.theta.at[angle] = workspace.theta.at[angle] * partial_step->scale;
            });
    }
    CachedRotation<A> cached;
    if (__builtin_expect(!single && shares_runs(tables, part), 0))
        act_apart<summation>(tables.state, constants, part, tau, workspace.theta.at, x);
    else
        act<summation, false>(tables.state, constants, part, tau, single, single_angle, workspace.theta.at, cached, x);
    if constexpr (with_group) {
        if (__builtin_expect(tables.bent[part], 0)) {
            const int64_t base = single ? row : terms.row[tables.share[part]];
            const int64_t stop = single ? row + 1 : terms.row[tables.share[part + 1]];
            for (int64_t position = base; position < stop; ++position)
                workspace.rotated.at[position - base] =
                    rational_angle(tau * (single ? single_angle : workspace.theta.at[position - base]),
                                   constants.template number_at<A>(tables.frequency, position));
            act<CORRECTED, true>(tables.group, constants, part, 1.0, false, single_angle, workspace.rotated.at, cached,
                                 group);
        } else {
            act<CORRECTED, true>(tables.group, constants, part, tau, single, single_angle, workspace.theta.at, cached,
                                 group);
        }
    }
}

// A momentum and a group element that rows move; steps of another length or with another start, unless null.
template <class A, class G, class C>
struct RowsTarget {
    C constants;
    Vectors<A> momentum;
    Vectors<G> group;
    const PartialStep<A>* partial_step;
    const A* start;
};

// The rows first to last - 1 of a program.
struct RowRange {
    uint32_t first, last;
    int64_t size() const { return int64_t(last) - first; }
};

// The rows of step k: those that open a run, or those that all other steps repeat.
INLINE RowRange rows_of_step(const FlowTables& tables, int64_t k) {
    const uint32_t* const edges = tables.section + (k == 1 ? 0 : 1);
    return {edges[0], edges[1]};
}

// The rows that finish a state.
INLINE RowRange finishing_rows(const FlowTables& tables) { return {tables.section[2], tables.section[3]}; }

// Apply some rows, each of them to all targets.
template <Summation summation, bool with_group, class A, class G, class C>
NOINLINE void sweep_groups(const FlowTables& tables, const RowsTarget<A, G, C>* const* targets, int count,
                           RowRange rows, const A& t, double h, AngleWorkspace<A>& workspace) {
    for (uint32_t r = rows.first; r < rows.last; ++r)
        for (int b = 0; b < count; ++b) {
            const RowsTarget<A, G, C>& target = *targets[b];
            workspace.partial_step = target.partial_step;
            apply_row<summation, with_group>(tables, target.constants, r, target.momentum, target.group,
                                             target.start ? *target.start : t, h, workspace);
        }
}

template <Summation summation, bool with_group, class A, class G, class C>
NOINLINE void sweep(const FlowTables& tables, const C& constants, RowRange rows, const Vectors<A>& x,
                    const Vectors<G>& group, const A& t, double h, AngleWorkspace<A>& workspace) {
    if constexpr (Numbers<A>::lanes > 1) {
        const RowsTarget<A, G, C> target{constants, x, group, workspace.partial_step, nullptr}, *const targets = &target;
        sweep_groups<summation, with_group>(tables, &targets, 1, rows, t, h, workspace);
    } else {
        for (uint32_t r = rows.first; r < rows.last; ++r)
            apply_row<summation, with_group>(tables, constants, r, x, group, t, h, workspace);
    }
}

typedef Loop<FlowTables> FlowLoop;

// Number of steps after which a loop stores its unfinished state, from which a failed step is located.
constexpr int64_t CHECKPOINT_INTERVAL = 64;

// The number of rows of the program that the steps k0 + 1 to k apply.
inline int64_t rows_applied(const FlowTables& tables, int64_t k0, int64_t k) {
    const int64_t taken = k - k0, start = k0 == 0 && taken > 0;
    return start * rows_of_step(tables, 1).size() + (taken - start) * rows_of_step(tables, 2).size();
}

// Approximate number of multiplications of some rows for one vector, without their angles.
inline int64_t work_of_rows(const FlowTables& tables, const Action& action, uint32_t first, uint32_t last) {
    int64_t work = 0;
    for (uint32_t r = first; r < last; ++r)
        for (uint32_t part = tables.part[r], run = action.run[part]; run < action.run[part + 1]; ++run)
            work += 8 * int64_t(action.angles[run]) * action.repeat[run] +
                    int64_t(action.entries[run]) * (2 + action.degree[run]);
    return work;
}

// The same for the momentum and the group element in a step of one member.
inline int64_t work_of_flows(const FlowTables& tables) {
    const uint32_t first = tables.section[1], last = tables.section[3];
    int64_t work = 0;
    for (uint32_t r = first; r < last; ++r)
        if (is_called(tables, tables.part[r]))
            work += (rotates_bonds_directly<PLAIN>(tables, tables.part[r]) ? WORK_OF_A_BOND : WORK_OF_A_BODY) *
                    (tables.share[tables.part[r] + 1] - tables.share[tables.part[r]]);
        else
            work += 16 + work_of_terms(tables.terms, tables.share[tables.part[r]], tables.share[tables.part[r] + 1]);
    work += work_of_rows(tables, tables.state, first, last);
    if (tables.group.size > 0) work += tables.group.size * work_of_rows(tables, tables.group, first, last);
    return work;
}

// With watched invariants.
inline int64_t work_of_step(const FlowLoop& loop) {
    return work_of_terms(loop.watch.terms, 0, loop.watch.terms.size) + work_of_flows(loop.tables);
}

}  // namespace coadjoint
