// The rows of a program backward, with cotangents: the transposed derivative of each flow.
//
// The angles of a part do not change along its flow, x -> exp(sum tau theta_a(x) D_a) x. So a row is undone from its end,
// and the cotangent of angle a is that of x there times D_a x.
#pragma once

#include "tangents/angle_cotangents.hpp"

namespace coadjoint {

// A state, a group element and their cotangents: of one member, the rows of its group element as lanes, or of members as
// lanes.
template <class A, class G>
struct Covector {
    A *x, *of_x;
    Vectors<G> group, of_group;
};

// The factors of a CUBIC block: sine and cosine for rotations, hyperbolic ones else, so a long function.
template <class A, class C>
NOINLINE CubicFactors<A> cubic_factors(const Action& action, const C& constants, uint32_t run, const A& theta) {
    return CubicFactors<A>(action, constants, run, theta);
}

// A rotation of two coordinates. Those of many members are long functions.
template <class A>
INLINE Rotation<A> rotation_of(const A& phi) {
    return rotation_by(phi);
}
template <int N>
NOINLINE Rotation<Lanes<N>> rotation_of(const Lanes<N>& phi) {
    return rotation_by(phi);
}

template <class A, class G, class C>
class RowsBackward {
  public:
    typedef typename C::template Constant<A> N;
    typedef ElementaryFlow<N> Flow;

    RowsBackward(const FlowCotangents& tables, const C& constants, const CoefficientCotangents<A>& coefficients,
                 bool with_group, AngleWorkspace<A>& angles)
        : tables(tables.base), all(tables), constants(constants), coefficients(coefficients),
          size(tables.base.state.size), with_group(with_group), added(tables, constants, with_group), angles(angles),
          scratch(3 * size), units(3 * size), of_angles(tables.base.longest), of_groups(ROWS * tables.base.longest), hessians(tables.base.terms),
          by_column(tables.base.terms) {}

    // Undo some rows, the last one first, of a step from t of length h; `flows` are their elementary flows, if there are
    // any, and `applied` their rotations if they are known.
    NOINLINE void sweep(RowRange range, const std::vector<Flow>& flows, const Covector<A, G>& at, const A& t, double h,
                        const AppliedRotations<A>* applied = nullptr) {
        const auto whole = [&](uint32_t r) {
            if (added.simple && int64_t(tables.part[r]) == all.added)
                added.template add<A, G>(tables.terms, tables.tau[r], at, with_group, of_angles.at, coefficients.offset,
                                         coefficients.weight);
            else
                row(r, at, t, h);
        };
        if (flows.empty())
            for (uint32_t r = range.last; r-- > range.first;) whole(r);
        for (size_t position = flows.size(); position-- > 0;) {
            const Flow& flow = flows[position];
            if (__builtin_expect(flow.kind != WHOLE_ROW, 1))
                undo(flow, at, applied ? applied + position : nullptr);
            else
                whole(flow.row);
        }
    }

  private:
    const FlowTables& tables;
    const FlowCotangents& all;
    const C constants;
    const CoefficientCotangents<A>& coefficients;
    const int64_t size;
    const bool with_group;
    const AddedAngles<N> added;
    AngleWorkspace<A>& angles;
    AlignedArray<A> scratch, units, of_angles;
    AlignedArray<G> of_groups;
    HessianWorkspace<A> hessians;
    EntriesOfTerms by_column;

    N number(const double* from, int64_t position) const { return constants.template number_at<N>(from, position); }

    // The cotangent of the angle of shears, without their factor.
    template <class V>
    INLINE V of_shears(const AngleBlocks<N>& blocks, const V* x, const V* cotangents, int64_t rows, int64_t first = 0,
                       int64_t step = 1) const {
        V total(0.0);
        for (uint32_t block = 0; block < blocks.repeat; ++block) {
            const int64_t i = blocks.pairs[2 * block] * rows, j = blocks.pairs[2 * block + 1] * rows;
            for (int64_t row = first; row < rows; row += step)
                total = fma(V(number(blocks.constants, block)) * x[j + row], cotangents[i + row], total);
        }
        return total;
    }

    // Undo rotations, of vectors and cotangents; return the cotangent of their angle, without their factor.
    template <class V>
    static INLINE V unrotate(const Rotation<A>& rotation, const uint32_t* pairs, uint32_t repeat, V* x, V* cotangents,
                             int64_t rows, int64_t first = 0, int64_t step = 1) {
        const V sine(rotation.sine), cosm1(rotation.cosm1);
        V total(0.0);
        for (uint32_t block = 0; block < repeat; ++block, pairs += 2) {
            const int64_t i = pairs[0] * rows, j = pairs[1] * rows;
            for (int64_t row = first; row < rows; row += step) {
                const V a = x[i + row], b = x[j + row], u = cotangents[i + row], w = cotangents[j + row];
                total = total + fma(a, w, -(b * u));
                x[i + row] = a + fma(cosm1, a, sine * b);
                x[j + row] = b + fma(cosm1, b, -(sine * a));
                cotangents[i + row] = u + fma(cosm1, u, sine * w);
                cotangents[j + row] = w + fma(cosm1, w, -(sine * u));
            }
        }
        return total;
    }

    // Shear backward: transposed for cotangents, whose pairs are exchanged.
    template <class V>
    INLINE void unshear(const AngleBlocks<N>& blocks, const A& theta, V* x, V* cotangents, int64_t rows) const {
        for (uint32_t block = 0; block < blocks.repeat; ++block) {
            const V by(theta * (blocks.factor * number(blocks.constants, block)));
            const int64_t i = blocks.pairs[2 * block] * rows, j = blocks.pairs[2 * block + 1] * rows;
            for (int64_t row = 0; row < rows; ++row) {
                x[i + row] = fma(-by, x[j + row], x[i + row]);
                cotangents[j + row] = fma(by, cotangents[i + row], cotangents[j + row]);
            }
        }
    }

    // Undo a CUBIC block, transposed for cotangents; return the cotangent of its angle, without the time.
    template <class V>
    NOINLINE V undo_cubic(const Action& action, uint32_t run, const A& s, const A& c, const Vectors<V>& x,
                          const Vectors<V>& of_x, int64_t first_row = 0, int64_t step = 1) const {
        const BlockRows block(action, run);
        const int64_t values = block.constant + CUBIC_HEADER, squares = values + block.entries;
        const V along(s), across(c);
        V *before = x.workspace, *covector = before + block.width, *pulled = covector + block.width, total(0.0);
        for (int64_t row = first_row; row < x.rows; row += step) {
            for (uint32_t k = 0; k < block.width; ++k) {
                const int64_t i = block.coordinates[k] * x.rows + row;
                before[k] = x.at[i], covector[k] = pulled[k] = of_x.at[i];
            }
            for (uint32_t k = 0; k < block.width; ++k) {
                V first(0.0), second(0.0);
                for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                    const uint32_t column = block.columns[entry];
                    const V value(number(action.constants, values + entry));
                    const V square(number(action.constants, squares + entry)), v = before[column];
                    first = fma(value, v, first);
                    second = fma(square, v, second);
                    pulled[column] = fma(fma(along, value, across * square), covector[k], pulled[column]);
                }
                total = fma(first, covector[k], total);
                const int64_t i = block.coordinates[k] * x.rows + row;
                x.at[i] = before[k] + fma(-along, first, across * second);
            }
            for (uint32_t k = 0; k < block.width; ++k) of_x.at[block.coordinates[k] * x.rows + row] = pulled[k];
        }
        return total;
    }

    INLINE void undo(const Flow& flow, const Covector<A, G>& at, const AppliedRotations<A>* applied) {
        const A theta = angle_of(flow, constants, at.x);
        A of_angle;
        if (__builtin_expect(flow.kind == ROTATE, 1)) {
            const AngleBlocks<N> &momentum = flow.momentum, &group = flow.group;
            Rotation<A> found;
            const Rotation<A>* rotation = applied ? &applied->momentum : &found;
            if (!applied) found = rotation_of(theta * momentum.factor);
            of_angle = unrotate(*rotation, momentum.pairs, momentum.repeat, at.x, at.of_x, 1);
            of_angle = A(momentum.factor) * of_angle;
            if (with_group) {
                if (applied)
                    rotation = &applied->group;
                else if (any(!(group.factor == momentum.factor)))
                    found = rotation_of(theta * group.factor);
                of_angle += A(group.factor) * over_rows<A, G>([&](int64_t first, int64_t step) {
                    return unrotate(*rotation, group.pairs, group.repeat, at.group.at, at.of_group.at, at.group.rows,
                                    first, step);
                });
            }
        } else if (flow.kind == CUBIC) {
            of_angle = undo_cubic_flow(flow, theta, at, applied);
        } else {
            of_angle = A(flow.momentum.factor) * of_shears(flow.momentum, at.x, at.of_x, 1);
            if (with_group)
                of_angle += A(flow.group.factor) * over_rows<A, G>([&](int64_t first, int64_t step) {
                    return of_shears(flow.group, at.group.at, at.of_group.at, at.group.rows, first, step);
                });
            unshear(flow.momentum, theta, at.x, at.of_x, 1);
            if (with_group) unshear(flow.group, theta, at.group.at, at.of_group.at, at.group.rows);
        }
        pull_angle(flow, of_angle, at);
    }

    // Undo CUBIC blocks of the state and of the group element; return the cotangent of their angle.
    NOINLINE A undo_cubic_flow(const Flow& flow, const A& theta, const Covector<A, G>& at,
                               const AppliedRotations<A>* applied) const {
        const auto factors_of = [&](const Action& action, const AngleBlocks<N>& blocks) {
            const CubicFactors<A> factors = cubic_factors(action, constants, blocks.run, blocks.factor * theta);
            return Rotation<A>{factors.s, factors.c};
        };
        const Rotation<A> factors = applied ? applied->momentum : factors_of(tables.state, flow.momentum);
        A of_angle = undo_cubic(tables.state, flow.momentum.run, factors.sine, factors.cosm1,
                                Vectors<A>{at.x, nullptr, 1, scratch.at}, Vectors<A>{at.of_x, nullptr, 1, nullptr});
        if (with_group) {
            const Rotation<A> of_group = applied ? applied->group : factors_of(tables.group, flow.group);
            of_angle += over_rows<A, G>([&](int64_t first, int64_t step) {
                return undo_cubic(tables.group, flow.group.run, of_group.sine, of_group.cosm1, at.group, at.of_group,
                                  first, step);
            });
        }
        return A(flow.momentum.factor) * of_angle;
    }

    // Add the cotangents of the weights of an angle, and of x.
    INLINE void pull_angle(const Flow& flow, const A& of_angle, const Covector<A, G>& at) {
        coefficients.offset[flow.angle] += of_angle;
        A* of_weight = coefficients.weight + tables.terms.entry[flow.angle];
        for (uint32_t entry = 0; entry < flow.entries; ++entry) {
            const uint32_t column = flow.column[entry];
            of_weight[entry] = fma(of_angle, at.x[column], of_weight[entry]);
            at.of_x[column] = fma(constants.template number_at<A>(flow.weight, entry), of_angle, at.of_x[column]);
        }
    }

    // The cotangents of the angles of a part, in `of_angles`, without the factor of the time.
    void find_angle_cotangents(uint32_t part, int64_t count, const Covector<A, G>& at, bool of_group_only) {
        share(count, [&](int64_t first, int64_t last) { std::fill(of_angles.at + first, of_angles.at + last, A(0.0)); });
        if (!of_group_only)
            angle_cotangents<N>(tables.state, constants, part, is_apart(part), at.x, at.of_x, 1, of_angles.at);
        if (!with_group) return;
        constexpr int64_t step = Numbers<A>::lanes == Numbers<G>::lanes ? ROWS : 1;
        std::fill_n(of_groups.at, step * count, G(0.0));
        for (int64_t first = 0; first < step; ++first)
            angle_cotangents<N>(tables.group, constants, part, false, at.group.at, at.of_group.at, at.group.rows,
                                of_groups.at + first * count, first, step);
        for (int64_t a = 0; a < count; ++a)
            of_angles.at[a] += over_rows<A, G>([&](int64_t first, int64_t) { return of_groups.at[first * count + a]; });
    }

    // Whether threads share the runs of a part.
    bool is_apart(uint32_t part) const {
        return int64_t(part) != all.added && shares_runs(tables, part);
    }

    // Whether a part only rotates, scales and shears.
    bool is_simple(uint32_t part) const {
        bool simple = int64_t(part) != all.added && !is_called(tables, part);
        for (uint32_t run = tables.state.run[part]; run < tables.state.run[part + 1]; ++run) {
            const int kind = tables.state.kind[run];
            simple = simple && (kind == ROTATE || kind == SCALE || kind == SHEAR);
        }
        return simple;
    }

    // Undo a simple part, and add the cotangents of its angles.
    void undo_simple(uint32_t part, double tau, const A* theta, const Covector<A, G>& at) {
        const Action& action = tables.state;
        share_runs(action, part, is_apart(part), [&](uint32_t run, uint32_t first, uint32_t count) {
            const uint32_t repeat = action.repeat[run];
            const uint64_t before = uint64_t(repeat) * first;
            const uint32_t* index = action.indices + action.position[run] + (action.kind[run] == SCALE ? 1 : 2) * before;
            const double* values = constants.from(action.constants, action.constant[run]);
            const A* angle = theta + action.angle[run];
            A* out = of_angles.at + action.angle[run];
            if (action.kind[run] == SHEAR) {
                for (uint32_t q = first; q < count; ++q, index += 2 * repeat) {
                    const AngleBlocks<N> blocks{
                        N(tau), constants.from(values, q * repeat), index, repeat, 0, SHEAR, run};
                    out[q] += of_shears(blocks, at.x, at.of_x, 1);
                    unshear(blocks, angle[q], at.x, at.of_x, 1);
                }
                return;
            }
            if (action.kind[run] == SCALE) {
                for (uint32_t q = first; q < count; ++q, index += repeat) {
                    const Growth<A> by = growth_by(angle[q] * (tau * number(values, q)));
                    const A growth = by.expm1, back = growth / by.exp;
                    for (uint32_t b = 0; b < repeat; ++b) {
                        A &x = at.x[index[b]], &of_x = at.of_x[index[b]];
                        out[q] = fma(A(number(values, q)) * x, of_x, out[q]);
                        x = fma(-back, x, x);
                        of_x = fma(growth, of_x, of_x);
                    }
                }
                return;
            }
            const auto one = [&](uint32_t q, const Rotation<A>& rotation) {
                const A total = unrotate(rotation, index, repeat, at.x, at.of_x, 1);
                out[q] = fma(A(number(values, q)), total, out[q]);
                index += 2 * repeat;
            };
            uint32_t q = first;
            if constexpr (Numbers<A>::lanes == 1)
                for (; q + SPREAD <= count; q += SPREAD) {
                    typedef Lanes<SPREAD> Spread;
                    const Spread phi = load<Spread>(angle + q) * (Spread(tau) * load<Spread>(values + q));
                    const Rotation<Spread> rotations = rotation_by(phi);
                    for (int lane = 0; lane < SPREAD; ++lane)
                        one(q + lane, {lane_of(rotations.sine, lane), lane_of(rotations.cosm1, lane)});
                }
            for (; q < count; ++q) one(q, rotation_of(angle[q] * (tau * number(values, q))));
        });
    }

    void row(uint32_t r, const Covector<A, G>& at, const A& t, double h) {
        const Terms& terms = tables.terms;
        const uint32_t part = tables.part[r], low = tables.share[part], high = tables.share[part + 1];
        const int64_t base = terms.row[low], count = terms.row[high] - base;
        const double tau = tables.tau[r];
        const A moment = t + A(tables.moment[r] * h);
        if (int64_t(part) == all.added) {
            find_angle_cotangents(part, count, at, false);
            for (int64_t a = 0; a < count; ++a) of_angles.at[a] *= A(tau);
            for (uint32_t k = low; k < high; ++k)
                term_cotangents(terms, constants, all.hessians, k, at.x, moment, of_angles.at, base, true, at.of_x,
                                coefficients, hessians);
            return;
        }
        const bool simple = is_simple(part);
        find_angle_cotangents(part, count, at, simple);
        const Vectors<A> x{at.x, nullptr, 1, scratch.at}, of_x{at.of_x, nullptr, 1, scratch.at};
        if (is_called(tables, part)) {
            const Rotations<A> rotations = rotations_of_part(tables, constants, part, A(-tau), at.x, angles);
            act_called<PLAIN>(tables.state, constants, part, rotations, x, size);
            act_called<PLAIN>(all.dual, constants, part, rotations, of_x, size);
            if (with_group) {
                act_called<PLAIN>(tables.group, constants, part, rotations, at.group, tables.group.size);
                act_called<PLAIN>(all.group_dual, constants, part, rotations, at.of_group, tables.group.size);
            }
            share(high - low, [&](int64_t first, int64_t last) {
                for (uint32_t k = low + uint32_t(first); k < low + uint32_t(last); ++k)
                    add_called(k, tau, at, of_angles.at + (terms.row[k] - base));
            });
            return;
        }
        A* theta = angles.theta.at;
        find_angles(tables, constants, part, at.x, moment, angles);
        if (simple) undo_simple(part, tau, theta, at);
        share(count, [&](int64_t first, int64_t last) {
            for (int64_t a = first; a < last; ++a)
                of_angles.at[a] *= rate_of(tau, number(tables.frequency, base + a), theta[a]);
        });
        const bool single = tables.only[part] >= 0;
        const A single_angle = single ? theta[0] : A(0.0);
        CachedRotation<A> cached;
        const auto undo_part = [&](const Action& action, const auto& vectors) {
            act<PLAIN, true>(action, constants, part, -tau, single, single_angle, theta, cached, vectors);
        };
        if (!simple && !single && is_apart(part)) {
            act_apart<PLAIN>(tables.state, constants, part, -tau, theta, x);
            act_apart<PLAIN>(all.dual, constants, part, -tau, theta, of_x);
        } else if (!simple) {
            undo_part(tables.state, x);
            undo_part(all.dual, of_x);
        }
        if (with_group && tables.bent[part]) {
            const A* rotated = rational_angles(tables, constants, base, count, -tau, angles);
            const auto undo_bent = [&](const Action& action, const Vectors<G>& vectors) {
                CachedRotation<A> other;
                act<PLAIN, true>(action, constants, part, 1.0, false, single_angle, rotated, other,
                                 vectors);
            };
            undo_bent(tables.group, at.group);
            undo_bent(all.group_dual, at.of_group);
        } else if (with_group) {
            undo_part(tables.group, at.group);
            undo_part(all.group_dual, at.of_group);
        }
        for (uint32_t k = low; k < high; ++k)
            term_cotangents(terms, constants, all.hessians, k, at.x, moment, of_angles.at, base, false, at.of_x,
                            coefficients, hessians, by_column(k, size));
    }

    // Add the cotangent of the momentum of a called share, whose rotations about e1, e2, e3 have those given.
    void add_called(uint32_t k, double tau, const Covector<A, G>& at, const A* of_rotations) {
        const int64_t body = tables.called[k];
        const uint32_t* column = tables.body_column + BODY_COLUMNS * body;
        for (int j = 0; j < 3; ++j) units.at[column[j] * 3 + j] = A(1.0);
        A changes[BODY_ROTATIONS * 3];
        called_changes(tables, constants, body, tau, at.x, units.at, 3, changes);
        for (int j = 0; j < 3; ++j) units.at[column[j] * 3 + j] = A(0.0);
        const bool bond = column[3] != column[0];
        for (int j = 0; j < 3; ++j) {
            A total(0.0);
            for (int i = 1; i < BODY_ROTATIONS; ++i) total = fma(changes[i * 3 + j], of_rotations[i], total);
            at.of_x[column[j]] += total;
            if (bond) at.of_x[column[3 + j]] += total;
        }
    }
};

}  // namespace coadjoint
