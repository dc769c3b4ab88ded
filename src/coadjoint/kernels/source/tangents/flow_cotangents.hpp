// The rows of a program backward, with cotangents: the transposed derivative of each flow.
//
// The angles of a part do not change along its flow, x -> exp(sum tau theta_a(x) D_a) x. So a row is undone from its end,
// and the cotangent of angle a is that of x there times D_a x.
#pragma once

#include "flows/flow_alone.hpp"
#include "tangents/second_derivatives.hpp"

namespace coadjoint {

// out[a] += cotangents . D_a x for all angles of a part, for vectors side by side.
template <class V>
NOINLINE void angle_cotangents(const Action& action, uint32_t part, const V* x, const V* cotangents, int64_t rows,
                               V* out) {
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
        const int kind = action.kind[run] % RATIONAL;
        const uint32_t repeat = action.repeat[run], count = action.angles[run];
        const uint32_t* index = action.indices + action.position[run];
        const double* constants = action.constants + action.constant[run];
        V* total = out + action.angle[run];
        if (kind == CUBIC || kind == SERIES) {
            const BlockRows block(action, run);
            const double* values = constants + (kind == CUBIC ? CUBIC_HEADER : 1);
            for (uint32_t k = 0; k < block.width; ++k)
                for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                    const V value(values[entry]);
                    const int64_t i = block.coordinates[k] * rows, j = block.coordinates[block.columns[entry]] * rows;
                    for (int64_t row = 0; row < rows; ++row)
                        *total = fma(value * x[j + row], cotangents[i + row], *total);
                }
            continue;
        }
        for (uint32_t q = 0; q < count; ++q, ++total)
            for (uint32_t b = 0; b < repeat; ++b, index += kind == SCALE ? 1 : 2) {
                const int64_t i = index[0] * rows, j = kind == SCALE ? i : index[1] * rows;
                const V first(constants[kind == SHEAR ? q * repeat + b : kind == PLANE ? 4 * q : q]);
                for (int64_t row = 0; row < rows; ++row) {
                    const V a = x[i + row], c = x[j + row], u = cotangents[i + row], w = cotangents[j + row];
                    if (kind == SCALE) {
                        *total = fma(first * a, u, *total);
                    } else if (kind == ROTATE) {
                        *total = fma(first, fma(a, w, -(c * u)), *total);
                    } else if (kind == SHEAR) {
                        *total = fma(first * c, u, *total);
                    } else {
                        const double* plane = constants + 4 * q;
                        const V mean(plane[0]), half(plane[1]), upper(plane[2]), lower(plane[3]);
                        *total = fma(fma(mean + half, a, upper * c), u, *total);
                        *total = fma(fma(lower, a, (mean - half) * c), w, *total);
                    }
                }
            }
    }
}

// The sum over the rows of a group element that are lanes; members as lanes remain.
template <class A, class G>
INLINE A over_rows(const G& total) {
    if constexpr (Numbers<A>::lanes == Numbers<G>::lanes) {
        return total;
    } else {
        A sum(0.0);
        for (int lane = 0; lane < Numbers<G>::lanes; ++lane) sum += lane_of(total, lane);
        return sum;
    }
}

// Derivatives by the offsets, weights and coefficients of the terms, one after the other.
template <class A>
struct CoefficientCotangents {
    A *offset, *weight, *coefficient;
    CoefficientCotangents(const Terms& terms, A* at)
        : offset(at), weight(at + rows_of(terms)), coefficient(weight + terms.entry[rows_of(terms)]) {}
    static int64_t rows_of(const Terms& terms) { return terms.row[terms.size]; }
    static int64_t count(const Terms& terms) {
        return rows_of(terms) + terms.entry[rows_of(terms)] + terms.monomial[terms.size];
    }
};

// Add to the cotangents of the coefficients of term k, and unless `of_coefficients_only`, of x. Those of its rows are
// `of_rows`, which begin at row `first`.
template <class A>
NOINLINE void term_cotangents(const Terms& terms, const int64_t* hessians, int64_t k, const A* x, const A& t,
                              const A* of_rows, int64_t first, bool of_coefficients_only, A* cotangents,
                              const CoefficientCotangents<A>& coefficients, HessianWorkspace<A>& workspace) {
    const int64_t start = terms.row[k], stop = terms.row[k + 1], count = stop - start;
    if (terms.kind[k] == LINEAR) {
        for (int64_t row = start; row < stop; ++row) {
            const A of_row = of_rows[row - first];
            coefficients.offset[row] += of_row;
            for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry) {
                const uint32_t column = terms.column[entry];
                coefficients.weight[entry] = fma(of_row, x[column], coefficients.weight[entry]);
                if (!of_coefficients_only)
                    cotangents[column] = fma(A(terms.weight[entry]), of_row, cotangents[column]);
            }
        }
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
            const auto product_without = [&](uint32_t one, uint32_t other) {
                A product(1.0);
                for (uint32_t factor = low; factor < high; ++factor)
                    product *= factor_derivative(x[terms.target[terms.factor_row[factor]]], terms.exponent[factor],
                                                 (factor == one) + (factor == other));
                return product;
            };
            for (uint32_t one = low; one < high; ++one) {
                const A of_row = of_rows[terms.factor_row[one] - first];
                coefficients.coefficient[monomial] =
                    fma(of_row, product_without(one, high), coefficients.coefficient[monomial]);
                if (of_coefficients_only) continue;
                for (uint32_t other = low; other < high; ++other) {
                    if (one == other && terms.exponent[one] < 2) continue;
                    A& cotangent = cotangents[terms.target[terms.factor_row[other]]];
                    cotangent = fma(A(terms.coefficient[monomial]) * product_without(one, other), of_row, cotangent);
                }
            }
        }
    } else if (!of_coefficients_only) {
        for (int64_t i = 0; i < count; ++i) workspace.arguments.at[i] = x[terms.target[start + i]];
        call_function(SharedConstants{}, hessians, k, workspace.arguments.at, count, t, workspace.matrix.at,
                      count * count, workspace.calls.data());
        for (int64_t i = 0; i < count; ++i)
            for (int64_t j = 0; j < count; ++j) {
                A& cotangent = cotangents[terms.target[start + j]];
                cotangent = fma(workspace.matrix.at[i * count + j], of_rows[start + i - first], cotangent);
            }
    }
}

// One term of an entry of D_a: x[to] changes by factor x[from], and if it rotates, x[from] by -factor x[to].
struct GeneratorEntry {
    uint32_t to, from;
    double factor;
    bool rotates;
};

// The angles of the added part: its generators and the linear terms, preprocessed when a loop starts.
class AddedAngles {
  public:
    bool simple = false;  // only linear terms, and blocks of one or two coordinates

    explicit AddedAngles(const FlowCotangents& all, bool with_group) {
        if (all.added < 0) return;
        const FlowTables& tables = all.base;
        const Terms& terms = tables.terms;
        const uint32_t part = uint32_t(all.added), low = tables.share[part], high = tables.share[part + 1];
        first = terms.row[low], count = terms.row[high] - first;
        simple = append(tables.state, part, state) && (!with_group || append(tables.group, part, group));
        for (uint32_t k = low; k < high; ++k) simple = simple && terms.kind[k] == LINEAR;
    }

    // Add the cotangents of the coefficients for a flow over the time tau.
    template <class A, class G, class C>
    INLINE void add(const Terms& terms, double tau, const C& at, bool with_group, const A& zero, A* of_offset,
                    A* of_weight) const {
        for (uint32_t a = 0; a < count; ++a) {
            A total = zero;
            for (uint32_t e = state.start[a]; e < state.start[a + 1]; ++e)
                total = product(state.entries[e], at.x, at.of_x, total);
            if (with_group) {
                const int64_t rows = at.group.rows;
                G sum(0.0);
                for (uint32_t e = group.start[a]; e < group.start[a + 1]; ++e)
                    for (int64_t row = 0; row < rows; ++row) {
                        const GeneratorEntry& entry = group.entries[e];
                        const GeneratorEntry moved{uint32_t(entry.to * rows + row), uint32_t(entry.from * rows + row),
                                                   entry.factor, entry.rotates};
                        sum = product(moved, at.group.at, at.of_group.at, sum);
                    }
                total += over_rows<A>(sum);
            }
            total *= A(tau);
            const uint32_t row = first + a;
            of_offset[row] += total;
            for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                of_weight[e] = fma(total, at.x[terms.column[e]], of_weight[e]);
        }
    }

  private:
    struct Generators {
        std::vector<uint32_t> start;
        std::vector<GeneratorEntry> entries;
    };
    Generators state, group;
    uint32_t first = 0, count = 0;

    template <class V>
    static INLINE V product(const GeneratorEntry& entry, const V* x, const V* cotangents, const V& total) {
        const V factor(entry.factor);
        V moved = x[entry.from] * cotangents[entry.to];
        if (entry.rotates) moved = moved - x[entry.to] * cotangents[entry.from];
        return fma(factor, moved, total);
    }

    bool append(const Action& action, uint32_t part, Generators& to) const {
        std::vector<std::vector<GeneratorEntry>> of_angle(count);
        for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
            const int kind = action.kind[run];
            if (kind != ROTATE && kind != SHEAR && kind != SCALE) return false;
            const uint32_t repeat = action.repeat[run], *index = action.indices + action.position[run];
            const double* constants = action.constants + action.constant[run];
            for (uint32_t q = 0; q < action.angles[run]; ++q)
                for (uint32_t b = 0; b < repeat; ++b, index += kind == SCALE ? 1 : 2) {
                    const double factor = constants[kind == SHEAR ? q * repeat + b : q];
                    const uint32_t from = kind == SCALE ? index[0] : index[1];
                    of_angle[action.angle[run] + q].push_back(
                        {index[0], from, kind == ROTATE ? -factor : factor, kind == ROTATE});
                }
        }
        to.start.push_back(0);
        for (const auto& entries : of_angle) {
            to.entries.insert(to.entries.end(), entries.begin(), entries.end());
            to.start.push_back(uint32_t(to.entries.size()));
        }
        return true;
    }
};

// A state, a group element and their cotangents: of one member, the rows of its group element as lanes, or of members as
// lanes.
template <class A, class G>
struct Covector {
    A *x, *of_x;
    Vectors<G> group, of_group;
};

template <class A, class G>
class RowsBackward {
  public:
    RowsBackward(const FlowCotangents& tables, const CoefficientCotangents<A>& coefficients, bool with_group)
        : tables(tables.base), all(tables), coefficients(coefficients), size(tables.base.state.size),
          with_group(with_group), added(tables, with_group), scratch(3 * size), units(3 * size), changes(BODY_ROTATIONS * 3), of_angles(tables.base.longest),
          of_groups(tables.base.longest), angles(tables.base.longest), hessians(tables.base.longest) {}

    // Undo the rows last - 1 to first of a step from t of length h; `flows` are their elementary flows, if there are any.
    void sweep(uint32_t first, uint32_t last, const std::vector<ElementaryFlow>& flows, const Covector<A, G>& at,
               const A& t, double h) {
        if (flows.empty())
            for (uint32_t r = last; r-- > first;) row(r, at, t, h);
        for (size_t position = flows.size(); position-- > 0;) {
            const ElementaryFlow& flow = flows[position];
            if (__builtin_expect(flow.kind != WHOLE_ROW, 1))
                undo(flow, at);
            else if (int64_t(tables.part[flow.row]) == all.added && added.simple)
                added.template add<A, G>(tables.terms, tables.tau[flow.row], at, with_group, A(0.0), coefficients.offset,
                                         coefficients.weight);
            else
                row(flow.row, at, t, h);
        }
    }

  private:
    const FlowTables& tables;
    const FlowCotangents& all;
    const CoefficientCotangents<A>& coefficients;
    const int64_t size;
    const bool with_group;
    const AddedAngles added;
    AlignedArray<A> scratch, units, changes, of_angles;
    AlignedArray<G> of_groups;
    AngleWorkspace<A> angles;
    HessianWorkspace<A> hessians;

    // The cotangent of the angle of blocks, without their factor.
    template <class V>
    static INLINE V of_blocks(const AngleBlocks& blocks, const V* x, const V* cotangents, int64_t rows) {
        V total(0.0);
        for (uint32_t block = 0; block < blocks.repeat; ++block) {
            const int64_t i = blocks.pairs[2 * block] * rows, j = blocks.pairs[2 * block + 1] * rows;
            for (int64_t row = 0; row < rows; ++row)
                total = blocks.kind == ROTATE
                            ? total + fma(x[i + row], cotangents[j + row], -(x[j + row] * cotangents[i + row]))
                            : fma(V(blocks.constants[block]) * x[j + row], cotangents[i + row], total);
        }
        return total;
    }

    // Shear backward: transposed for cotangents, whose pairs are exchanged.
    template <class V>
    static INLINE void unshear(const AngleBlocks& blocks, const A& theta, V* x, V* cotangents, int64_t rows) {
        for (uint32_t block = 0; block < blocks.repeat; ++block) {
            const V by(theta * (blocks.factor * blocks.constants[block]));
            const int64_t i = blocks.pairs[2 * block] * rows, j = blocks.pairs[2 * block + 1] * rows;
            for (int64_t row = 0; row < rows; ++row) {
                x[i + row] = fma(-by, x[j + row], x[i + row]);
                cotangents[j + row] = fma(by, cotangents[i + row], cotangents[j + row]);
            }
        }
    }

    // Undo a CUBIC block, transposed for cotangents; return the cotangent of its angle, without the time.
    template <class V>
    INLINE V undo_cubic(const Action& action, const AngleBlocks& blocks, const A& theta, const Vectors<V>& x,
                        const Vectors<V>& of_x) const {
        const BlockRows block(action, blocks.run);
        const CubicFactors<A> factors(action, SharedConstants{}, blocks.run, blocks.factor * theta);
        const double *values = action.constants + block.constant + CUBIC_HEADER, *squares = values + block.entries,
                     *rests = squares + block.entries;
        const V along(factors.s), across(factors.c);
        V *before = x.workspace, *covector = before + block.width, *pulled = covector + block.width, total(0.0);
        for (int64_t row = 0; row < x.rows; ++row) {
            for (uint32_t k = 0; k < block.width; ++k) {
                const int64_t i = block.coordinates[k] * x.rows + row;
                before[k] = x.at[i], covector[k] = pulled[k] = of_x.at[i];
            }
            for (uint32_t k = 0; k < block.width; ++k) {
                V first(0.0), second(0.0), rest(0.0);
                for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                    const uint32_t column = block.columns[entry];
                    const V value(values[entry]), square(squares[entry]), v = before[column];
                    first = fma(value, v, first);
                    second = fma(square, v, second);
                    rest = fma(V(rests[entry]), v, rest);
                    pulled[column] = fma(fma(along, value, across * square), covector[k], pulled[column]);
                }
                total = fma(first, covector[k], total);
                const int64_t i = block.coordinates[k] * x.rows + row;
                x.at[i] = before[k] + fma(-along, first, across * (second + rest));
            }
            for (uint32_t k = 0; k < block.width; ++k) of_x.at[block.coordinates[k] * x.rows + row] = pulled[k];
        }
        return total;
    }

    INLINE void undo(const ElementaryFlow& flow, const Covector<A, G>& at) {
        A theta(flow.offset);
        for (uint32_t entry = 0; entry < flow.entries; ++entry)
            theta = fma(A(flow.weight[entry]), at.x[flow.column[entry]], theta);
        if (flow.kind == CUBIC) {
            A of_angle = undo_cubic(tables.state, flow.momentum, theta, Vectors<A>{at.x, nullptr, 1, scratch.at},
                                    Vectors<A>{at.of_x, nullptr, 1, nullptr});
            if (with_group) of_angle += over_rows<A>(undo_cubic(tables.group, flow.group, theta, at.group, at.of_group));
            return pull_angle(flow, A(flow.momentum.factor) * of_angle, at);
        }
        A of_angle = A(flow.momentum.factor) * of_blocks(flow.momentum, at.x, at.of_x, 1);
        if (with_group)
            of_angle += A(flow.group.factor) *
                        over_rows<A>(of_blocks(flow.group, at.group.at, at.of_group.at, at.group.rows));
        if (flow.kind == ROTATE) {
            const auto back = [&](const AngleBlocks& blocks, const auto& x, const auto& of_x) {
                const Rotation<A> rotation = rotation_by(-(theta * blocks.factor));
                rotate<PLAIN>(rotation, blocks.pairs, blocks.repeat, x);
                rotate<PLAIN>(rotation, blocks.pairs, blocks.repeat, of_x);
            };
            back(flow.momentum, Vectors<A>{at.x, nullptr, 1, nullptr}, Vectors<A>{at.of_x, nullptr, 1, nullptr});
            if (with_group) back(flow.group, at.group, at.of_group);
        } else {
            unshear(flow.momentum, theta, at.x, at.of_x, 1);
            if (with_group) unshear(flow.group, theta, at.group.at, at.of_group.at, at.group.rows);
        }
        pull_angle(flow, of_angle, at);
    }

    // Add the cotangents of the weights of an angle, and of x.
    INLINE void pull_angle(const ElementaryFlow& flow, const A& of_angle, const Covector<A, G>& at) {
        coefficients.offset[flow.angle] += of_angle;
        A* of_weight = coefficients.weight + (flow.weight - tables.terms.weight);
        for (uint32_t entry = 0; entry < flow.entries; ++entry) {
            const uint32_t column = flow.column[entry];
            of_weight[entry] = fma(of_angle, at.x[column], of_weight[entry]);
            at.of_x[column] = fma(A(flow.weight[entry]), of_angle, at.of_x[column]);
        }
    }

    // The cotangents of the angles of a part, in `of_angles`, without the factor of the time.
    void find_angle_cotangents(uint32_t part, int64_t count, const Covector<A, G>& at) {
        std::fill_n(of_angles.at, count, A(0.0));
        angle_cotangents(tables.state, part, at.x, at.of_x, 1, of_angles.at);
        if (!with_group) return;
        std::fill_n(of_groups.at, count, G(0.0));
        angle_cotangents(tables.group, part, at.group.at, at.of_group.at, at.group.rows, of_groups.at);
        for (int64_t a = 0; a < count; ++a) of_angles.at[a] += over_rows<A>(of_groups.at[a]);
    }

    void row(uint32_t r, const Covector<A, G>& at, const A& t, double h) {
        const Terms& terms = tables.terms;
        const uint32_t part = tables.part[r], low = tables.share[part], high = tables.share[part + 1];
        const int64_t base = terms.row[low], count = terms.row[high] - base;
        const double tau = tables.tau[r];
        const A moment = t + A(tables.moment[r] * h);
        find_angle_cotangents(part, count, at);
        if (int64_t(part) == all.added) {
            for (int64_t a = 0; a < count; ++a) of_angles.at[a] *= A(tau);
            for (uint32_t k = low; k < high; ++k)
                term_cotangents(terms, all.hessians, k, at.x, moment, of_angles.at, base, true, at.of_x, coefficients,
                                hessians);
            return;
        }
        const Vectors<A> x{at.x, nullptr, 1, scratch.at}, of_x{at.of_x, nullptr, 1, scratch.at};
        if (is_called(tables, part)) {
            const Rotations<A> rotations = rotations_of_part(tables, SharedConstants{}, part, -tau, at.x, angles);
            act_called<PLAIN>(tables.state, SharedConstants{}, part, rotations, x, size);
            act_called<PLAIN>(all.dual, SharedConstants{}, part, rotations, of_x, size);
            if (with_group) {
                act_called<PLAIN>(tables.group, SharedConstants{}, part, rotations, at.group, tables.group.size);
                act_called<PLAIN>(all.group_dual, SharedConstants{}, part, rotations, at.of_group, tables.group.size);
            }
            for (uint32_t k = low; k < high; ++k) add_called(k, tau, at, of_angles.at + (terms.row[k] - base));
            return;
        }
        A* theta = angles.theta.at;
        for (uint32_t k = low; k < high; ++k)
            gradient_rows(terms, SharedConstants{}, tables.addresses, k, at.x, moment, theta, base, angles.arguments.at,
                          angles.calls.data());
        for (int64_t a = 0; a < count; ++a) {
            // A rational rotation by phi rotates by 2 atan(phi/2).
            const A half = 0.5 * tables.frequency[base + a] * (tau * theta[a]);
            of_angles.at[a] *= A(tau) / fma(half, half, A(1.0));
        }
        const bool single = tables.only[part] >= 0;
        const A single_angle = single ? theta[0] : A(0.0);
        CachedRotation<A> cached;
        const auto undo_part = [&](const Action& action, const auto& vectors) {
            act<PLAIN, true>(action, SharedConstants{}, part, -tau, single, single_angle, theta, cached, vectors);
        };
        undo_part(tables.state, x);
        undo_part(all.dual, of_x);
        if (with_group && tables.bent[part]) {
            for (int64_t a = 0; a < count; ++a)
                angles.rotated.at[a] = rational_angle(-tau * theta[a], A(tables.frequency[base + a]));
            const auto undo_bent = [&](const Action& action, const Vectors<G>& vectors) {
                CachedRotation<A> other;
                act<PLAIN, true>(action, SharedConstants{}, part, 1.0, false, single_angle, angles.rotated.at, other,
                                 vectors);
            };
            undo_bent(tables.group, at.group);
            undo_bent(all.group_dual, at.of_group);
        } else if (with_group) {
            undo_part(tables.group, at.group);
            undo_part(all.group_dual, at.of_group);
        }
        for (uint32_t k = low; k < high; ++k)
            term_cotangents(terms, all.hessians, k, at.x, moment, of_angles.at, base, false, at.of_x, coefficients,
                            hessians);
    }

    // Add the cotangent of the momentum of a called share, whose rotations about e1, e2, e3 have those given.
    void add_called(uint32_t k, double tau, const Covector<A, G>& at, const A* of_rotations) {
        const int64_t body = tables.called[k];
        const uint32_t* column = tables.body_column + BODY_COLUMNS * body;
        for (int j = 0; j < 3; ++j) units.at[column[j] * 3 + j] = A(1.0);
        called_changes(tables, body, tau, at.x, units.at, 3, changes.at);
        for (int j = 0; j < 3; ++j) units.at[column[j] * 3 + j] = A(0.0);
        const bool bond = column[3] != column[0];
        for (int j = 0; j < 3; ++j) {
            A total(0.0);
            for (int i = 1; i < BODY_ROTATIONS; ++i) total = fma(changes.at[i * 3 + j], of_rotations[i], total);
            at.of_x[column[j]] += total;
            if (bond) at.of_x[column[3 + j]] += total;
        }
    }
};

}  // namespace coadjoint
