// The rows of a program with tangent vectors beside the momentum and the group element: dx <- act(theta, dx) + (D x)
// dtheta.
#pragma once

#include "tangents/angle_cotangents.hpp"
#include "tangents/bundle.hpp"

namespace coadjoint {

// Add D_a x times the change of its angle to the vectors, for all angles of a part (the operation `apply`). Component i of
// state r of `states` is at i * states + r.
template <class A, class V, class C>
NOINLINE void add_angle_changes(const Action& action, const C& constants, uint32_t part, bool apart, const A* x,
                                int64_t states, const V* changes, V* vectors, int64_t rows) {
    typedef typename C::template Constant<A> N;
    each_generator<N>(action, constants, part, apart, [&](uint32_t a, uint32_t i, const auto& component) {
        const V* change = changes + int64_t(a) * rows;
        for (int64_t r = 0; r < states; ++r) {
            const V by(component([&](uint32_t j) { return x[j * states + r]; }));
            V* vector = vectors + (i * states + r) * rows;
            for (int64_t b = 0; b < rows; ++b) vector[b] = fma(by, change[b], vector[b]);
        }
    });
}

// Add the changes of the rows of term k under directions of its offsets, weights and coefficients: entry i of direction b
// is at i * rows + b. The derivatives of functions by their coefficients are at `functions`.
template <class A, class V, class C>
NOINLINE void add_coefficient_changes(const Terms& terms, const C& constants, const int64_t* functions, int64_t k,
                                      const A* x, const A& t, const V* directions, int64_t rows, V* out, int64_t first,
                                      HessianWorkspace<A>& workspace) {
    each_coefficient(terms, constants, functions, k, x, t, workspace, [&](int64_t index, int64_t row, const A& factor) {
        const V by(factor), *direction = directions + index * rows;
        V* change = out + (row - first) * rows;
        for (int64_t b = 0; b < rows; ++b) change[b] = fma(by, direction[b], change[b]);
    });
}

// The group element of a state, (d, d), with tangent vectors of it, and the directions of coefficients that all have; none
// for null pointers. Angles of the part `added`, unless it is negative, change by those alone, and move nothing.
template <class A, class V>
struct FurtherTangents {
    A* group;
    V *vectors, *directions;
    int64_t added;
};

// Call `move(sums)` with the sums of a momentum: beside those of its vectors a flag takes no time.
template <class Move>
INLINE void with_sums(bool corrected, const Move& move) {
    if (corrected)
        move(std::integral_constant<Summation, CORRECTED>());
    else
        move(std::integral_constant<Summation, PLAIN>());
}

// One member of a flow method, or many as lanes. Momenta have the same bits as without tangent vectors.
template <class A, class V, class C>
struct FlowTangentState {
    typedef typename C::template Constant<A> N;
    const FlowTables& tables;
    const C constants;
    const bool compensated;
    const int64_t* hessians;
    const int64_t size, rows, side;
    int64_t* too_long = nullptr;
    AlignedArray<A> scratch, group_scratch;
    AlignedArray<V> wide, wide_group, changes;
    AngleWorkspace<A> angles;
    HessianWorkspace<A> workspace;

    FlowTangentState(const FlowTables& tables, const C& constants, const int64_t* hessians, int64_t size, int64_t rows)
        : tables(tables), constants(constants), compensated(tables.compensated), hessians(hessians), size(size),
          rows(rows), side(tables.group.size), scratch(3 * size), group_scratch(3 * side * side),
          wide(3 * size * rows), wide_group(3 * side * side * rows),
          changes(tables.longest * rows), angles(tables.longest), workspace(tables.terms) {}

    NOINLINE void sweep(RowRange range, A* x, A* dx, V* vectors, const A& t, double h,
                        const FurtherTangents<A, V>& further = {nullptr, nullptr, nullptr, -1}) {
        for (uint32_t r = range.first; r < range.last; ++r) row(r, x, dx, vectors, t, h, further);
    }

    // The same with elementary flows, if there are any, of the rows.
    NOINLINE void sweep(RowRange range, const std::vector<ElementaryFlow<N>>& flows, A* x, A* dx, V* vectors,
                        const A& t, double h, const FurtherTangents<A, V>& further) {
        if (flows.empty()) return sweep(range, x, dx, vectors, t, h, further);
        for (const ElementaryFlow<N>& flow : flows)
            if (__builtin_expect(flow.kind != WHOLE_ROW, 1))
                rows == 1 ? follow(std::integral_constant<int64_t, 1>(), flow, x, dx, vectors, further)
                          : follow(rows, flow, x, dx, vectors, further);
            else
                row(flow.row, x, dx, vectors, t, h, further);
    }

  private:
    N number(const double* from, int64_t position) const { return constants.template number_at<N>(from, position); }

    // Move states (at i * states + r) and their vectors by the blocks of an angle theta, whose changes are `of_angle`. A
    // single row is known to the compiler, which then keeps it in registers.
    template <class Rows>
    INLINE void follow_blocks(Rows rows, bool corrected, const AngleBlocks<N>& blocks, const A& theta,
                              const V* of_angle, const Vectors<A>& x, V* vectors) {
        const int64_t states = x.rows;
        const bool turns = blocks.kind == ROTATE;
        Rotation<A> rotation{A(0.0), A(0.0)};
        if (turns) rotation = rotation_by(theta * blocks.factor);
        with_sums(corrected, [&](auto sums) {
            if (turns)
                rotate<sums()>(rotation, blocks.pairs, blocks.repeat, x);
            else
                shear_blocks<sums()>(blocks, constants, theta, x);
        });
        const V sine(rotation.sine), cosm1(rotation.cosm1);
        for (uint32_t block = 0; block < blocks.repeat; ++block) {
            const int64_t i = blocks.pairs[2 * block] * states, j = blocks.pairs[2 * block + 1] * states;
            for (int64_t r = 0; r < states; ++r) {
                V *first = vectors + (i + r) * rows, *second = vectors + (j + r) * rows;
                if (turns) {
                    const V of_first(-blocks.factor * x.at[j + r]), of_second(blocks.factor * x.at[i + r]);
                    for (int64_t b = 0; b < rows; ++b) {
                        const V a = first[b], c = second[b], change = of_angle[b];
                        first[b] = fma(of_first, change, a + fma(cosm1, a, -(sine * c)));
                        second[b] = fma(of_second, change, c + fma(cosm1, c, sine * a));
                    }
                } else {
                    const N factor = blocks.factor * number(blocks.constants, block);
                    const V by(factor * theta), of_first(factor * x.at[j + r]);
                    for (int64_t b = 0; b < rows; ++b)
                        first[b] = fma(of_first, of_angle[b], first[b] + by * second[b]);
                }
            }
        }
    }

    // The same with a CUBIC block.
    NOINLINE void follow_cubic(bool corrected, const Action& action, const AngleBlocks<N>& blocks, const A& theta,
                               const V* of_angle, const Vectors<A>& x, V* vectors, V* copies) {
        const BlockRows block(action, blocks.run);
        const CubicFactors<A> factors(action, constants, blocks.run, blocks.factor * theta);
        gather(block, x);
        with_sums(corrected,
                  [&](auto sums) { cubic_by<sums()>(action, constants, blocks.run, factors, x); });
        gather(block, x);
        const int64_t values = block.constant + CUBIC_HEADER, squares = values + block.entries;
        const int64_t states = x.rows, length = states * rows;
        gather(block, Vectors<V>{vectors, nullptr, length, copies});
        for (uint32_t k = 0; k < block.width; ++k)
            for (int64_t r = 0; r < states; ++r) {
                A moved(0.0);
                for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry)
                    moved = fma(A(number(action.constants, values + entry)),
                                x.workspace[block.columns[entry] * states + r], moved);
                const V change(blocks.factor * moved);
                V* vector = vectors + block.coordinates[k] * length + r * rows;
                for (int64_t b = 0; b < rows; ++b) {
                    V total = change * of_angle[b];
                    for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                        const V by(fma(factors.s, A(number(action.constants, values + entry)),
                                       factors.c * number(action.constants, squares + entry)));
                        total = fma(by, copies[block.columns[entry] * length + r * rows + b], total);
                    }
                    vector[b] = vector[b] + total;
                }
            }
    }

    template <class Rows>
    INLINE void follow(Rows rows, const ElementaryFlow<N>& flow, A* x, A* dx, V* vectors,
                       const FurtherTangents<A, V>& further) {
        A theta(flow.offset);
        V* change = changes.at;
        std::fill_n(change, rows, V(0.0));
        for (uint32_t entry = 0; entry < flow.entries; ++entry) {
            const uint32_t column = flow.column[entry];
            const A of_entry = constants.template number_at<A>(flow.weight, entry);
            theta = fma(of_entry, x[column], theta);
            const V weight(of_entry);
            for (int64_t b = 0; b < rows; ++b) change[b] = fma(weight, vectors[column * rows + b], change[b]);
        }
        if (further.directions) {
            const Terms& terms = tables.terms;
            const V* of_weight = further.directions + (terms.row[terms.size] + terms.entry[flow.angle]) * rows;
            for (int64_t b = 0; b < rows; ++b) change[b] += further.directions[flow.angle * rows + b];
            for (uint32_t entry = 0; entry < flow.entries; ++entry) {
                const V coordinate(x[flow.column[entry]]);
                for (int64_t b = 0; b < rows; ++b)
                    change[b] = fma(coordinate, of_weight[entry * rows + b], change[b]);
            }
        }
        const Vectors<A> momentum{x, dx, 1, scratch.at}, group{further.group, nullptr, side, group_scratch.at};
        if (flow.kind == CUBIC) {
            follow_cubic(compensated, tables.state, flow.momentum, theta, change, momentum, vectors, wide.at);
            if (further.group)
                follow_cubic(false, tables.group, flow.group, theta, change, group, further.vectors, wide_group.at);
            return;
        }
        follow_blocks(rows, compensated, flow.momentum, theta, change, momentum, vectors);
        if (further.group) follow_blocks(rows, false, flow.group, theta, change, group, further.vectors);
    }

    // Move what follows the momentum by the angles of a row.
    template <class W>
    NOINLINE void follow_row(const Action& action, uint32_t part, double tau, bool single, const A* theta,
                             CachedRotation<A>& cached, const Vectors<W>& moved) {
        act<PLAIN, true>(action, constants, part, tau, single, single ? theta[0] : A(0.0), theta, cached, moved);
    }

    NOINLINE void row(uint32_t r, A* x, A* dx, V* vectors, const A& t, double h, const FurtherTangents<A, V>& further) {
        const Terms& terms = tables.terms;
        const uint32_t part = tables.part[r], low = tables.share[part], high = tables.share[part + 1];
        const int64_t base = terms.row[low], count = terms.row[high] - base;
        const bool single = tables.only[part] >= 0, added = int64_t(part) == further.added;
        const bool apart = !single && shares_runs(tables, part);
        const double tau = tables.tau[r];
        const A moment = t + A(tables.moment[r] * h);
        A* theta = angles.theta.at;
        const Vectors<A> group{further.group, nullptr, side, group_scratch.at};
        const Vectors<V> of_group{further.vectors, nullptr, side * rows, wide_group.at};
        if (is_called(tables, part)) {
            share(high - low, [&](int64_t first, int64_t last) {
                for (uint32_t k = low + uint32_t(first); k < low + uint32_t(last); ++k)
                    called_changes(tables, constants, tables.called[k], tau, x, vectors, rows,
                                   changes.at + (terms.row[k] - base) * rows);
            });
            const Rotations<A> rotations = rotations_of_part(tables, constants, part, A(tau), x, angles);
            with_sums(compensated, [&](auto sums) {
                if (rotates_bonds_directly<sums()>(tables, part))
                    rotate_bonds(tables, constants, part, tau, x);
                else
                    act_called<sums()>(tables.state, constants, part, rotations,
                                       Vectors<A>{x, dx, 1, scratch.at}, size);
            });
            act_called<PLAIN>(tables.state, constants, part, rotations,
                              Vectors<V>{vectors, nullptr, rows, wide.at}, size);
            if (further.group) {
                act_called<PLAIN>(tables.group, constants, part, rotations, group, side);
                act_called<PLAIN>(tables.group, constants, part, rotations, of_group, side);
            }
        } else {
            for (uint32_t k = low; k < high; ++k) {
                V* of_term = changes.at + (terms.row[k] - base) * rows;
                if (added) {
                    std::fill_n(of_term, (terms.row[k + 1] - terms.row[k]) * rows, V(0.0));
                } else {
                    gradient_rows(terms, constants, tables.addresses, k, x, moment, theta, base,
                                  angles.arguments.at, angles.calls.at);
                    gradient_changes(terms, constants, hessians, k, x, moment, vectors, rows, changes.at, base,
                                     workspace);
                }
                if (further.directions)
                    add_coefficient_changes(terms, constants, hessians, k, x, moment, further.directions, rows,
                                            changes.at, base, workspace);
            }
            share(count, [&](int64_t first, int64_t last) {
                for (int64_t a = first; a < last; ++a) {
                    const V by(added ? A(tau) : rate_of(tau, number(tables.frequency, base + a), theta[a]));
                    for (int64_t b = 0; b < rows; ++b) changes.at[a * rows + b] *= by;
                }
            });
            if (!added) {
                const A single_angle = single ? theta[0] : A(0.0);
                CachedRotation<A> cached;
                const Vectors<A> momentum{x, dx, 1, scratch.at, too_long};
                const Vectors<V> of_momentum{vectors, nullptr, rows, wide.at};
                with_sums(compensated, [&](auto sums) {
                    if (apart)
                        act_apart<sums()>(tables.state, constants, part, tau, theta, momentum);
                    else
                        act<sums(), false>(tables.state, constants, part, tau, single, single_angle, theta,
                                           cached, momentum);
                });
                if (apart)
                    act_apart<PLAIN>(tables.state, constants, part, tau, theta, of_momentum);
                else
                    follow_row(tables.state, part, tau, single, theta, cached, of_momentum);
                if (further.group && tables.bent[part]) {
                    const A* rotated = rational_angles(tables, constants, base, count, tau, angles);
                    follow_row(tables.group, part, 1.0, false, rotated, cached, group);
                    follow_row(tables.group, part, 1.0, false, rotated, cached, of_group);
                } else if (further.group) {
                    follow_row(tables.group, part, tau, single, theta, cached, group);
                    follow_row(tables.group, part, tau, single, theta, cached, of_group);
                }
            }
        }
        add_angle_changes(tables.state, constants, part, apart, x, 1, changes.at, vectors, rows);
        if (further.group)
            add_angle_changes(tables.group, constants, part, false, further.group, side, changes.at, further.vectors,
                              rows);
    }
};

// `declared` is `extern`, or empty in flow_tangents.cpp.
#define COMPILED_TANGENT_STATE(declared)                                                                             \
    declared template void FlowTangentState<double, TangentLanes, SharedConstants>::sweep(                           \
        RowRange, double*, double*, TangentLanes*, const double&, double, const FurtherTangents<double, TangentLanes>&);

COMPILED_TANGENT_STATE(extern)

}  // namespace coadjoint
