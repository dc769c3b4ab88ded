// Cotangents of the angles of parts and of the coefficients of terms.
#pragma once

#include "flows/flow_alone.hpp"
#include "tangents/second_derivatives.hpp"

namespace coadjoint {

// Call `visit(a, i, component)` for each component i that D_a changes, of all angles a of a part: component(at) is that of
// D_a x for the x with the components at(0), at(1), ... A constant is an N.
template <class N, class C, class Visit>
INLINE void each_generator(const Action& action, const C& constants, uint32_t part, bool apart, const Visit& visit) {
    share_runs(action, part, apart, [&](uint32_t run, uint32_t low, uint32_t high) {
        const int kind = action.kind[run] % RATIONAL;
        const uint32_t repeat = action.repeat[run], angle = action.angle[run];
        const uint32_t* index = action.indices + action.position[run] + (kind == SCALE ? 1 : 2) * uint64_t(repeat) * low;
        const double* values_of_run = constants.from(action.constants, action.constant[run]);
        const auto number = [&](int64_t position) {
            return constants.template number_at<N>(values_of_run, position);
        };
        if (kind == CUBIC || kind == SERIES) {
            const BlockRows block(action, run);
            const int64_t values = kind == CUBIC ? CUBIC_HEADER : 1;
            for (uint32_t k = 0; k < block.width; ++k)
                visit(angle, block.coordinates[k], [&](const auto& at) {
                    typedef std::decay_t<decltype(at(0u))> V;
                    V total(0.0);
                    for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry)
                        total = fma(V(number(values + entry)), at(block.coordinates[block.columns[entry]]), total);
                    return total;
                });
            return;
        }
        for (uint32_t q = low; q < high; ++q)
            for (uint32_t b = 0; b < repeat; ++b, index += kind == SCALE ? 1 : 2) {
                const uint32_t i = index[0], j = kind == SCALE ? i : index[1];
                const N by = number(kind == SHEAR ? q * repeat + b : q);
                if (kind == ROTATE) {
                    visit(angle + q, i, [&](const auto& at) { return -(by * at(j)); });
                    visit(angle + q, j, [&](const auto& at) { return by * at(i); });
                } else if (kind == PLANE) {
                    const auto sum = [](const N& first, const auto& x, const N& second, const auto& y) {
                        return fma(std::decay_t<decltype(x)>(first), x, second * y);
                    };
                    const N mean = number(4 * q), half = number(4 * q + 1), upper = number(4 * q + 2),
                            lower = number(4 * q + 3);
                    visit(angle + q, i, [&](const auto& at) { return sum(mean + half, at(i), upper, at(j)); });
                    visit(angle + q, j, [&](const auto& at) { return sum(lower, at(i), mean - half, at(j)); });
                } else {
                    visit(angle + q, i, [&](const auto& at) { return by * at(j); });
                }
            }
    });
}

// out[a] += cotangents . D_a x for all angles of a part, for the vectors first, first + step, ... of those side by
// side.
template <class N, class V, class C>
NOINLINE void angle_cotangents(const Action& action, const C& constants, uint32_t part, bool apart, const V* x,
                               const V* cotangents, int64_t rows, V* out, int64_t first = 0, int64_t step = 1) {
    each_generator<N>(action, constants, part, apart, [&](uint32_t a, uint32_t i, const auto& component) {
        V total = out[a];
        for (int64_t row = first; row < rows; row += step)
            total = fma(component([&](uint32_t j) { return x[j * rows + row]; }), cotangents[i * rows + row], total);
        out[a] = total;
    });
}

// The change of the rotation by an angle theta over the time tau: a rational rotation by phi rotates by 2 atan(phi/2).
template <class A, class N>
INLINE A rate_of(double tau, const N& frequency, const A& theta) {
    const A half = 0.5 * frequency * (tau * theta);
    return A(tau) / fma(half, half, A(1.0));
}

// The angles of the group element for the `count` angles from `base` on, of a part with rational rotations.
template <class A, class C>
const A* rational_angles(const FlowTables& tables, const C& constants, int64_t base, int64_t count, double tau,
                         AngleWorkspace<A>& workspace) {
    for (int64_t a = 0; a < count; ++a)
        workspace.rotated.at[a] = rational_angle(tau * workspace.theta.at[a],
                                                 constants.template number_at<A>(tables.frequency, base + a));
    return workspace.rotated.at;
}

// The sum over the rows of a group element: `part(first, step)` is that of the rows first, first + step, ..., which are
// lanes, or for members as lanes as many sums, so that a member has the bits of its run alone.
template <class A, class G, class Part>
INLINE A over_rows(const Part& part) {
    A sum(0.0);
    if constexpr (Numbers<A>::lanes == Numbers<G>::lanes) {
        for (int64_t first = 0; first < ROWS; ++first) sum += part(first, ROWS);
    } else {
        const G total = part(0, 1);
        for (int lane = 0; lane < Numbers<G>::lanes; ++lane) sum += lane_of(total, lane);
    }
    return sum;
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

// The entries of sparse rows by column, in their order, so that threads can share the columns.
class EntriesByColumn {
  public:
    // Entries of the rows `low` to `high` - 1 with columns below `size`.
    void find(uint32_t low, uint32_t high, const uint32_t* start, const uint32_t* column, int64_t size) {
        if (!begin.empty()) return;
        entries.resize(start[high] - start[low]);
        begin.assign(size + 1, 0);
        for (uint32_t entry = start[low]; entry < start[high]; ++entry) ++begin[column[entry] + 1];
        for (int64_t c = 0; c < size; ++c) begin[c + 1] += begin[c];
        std::vector<uint32_t> next(begin.begin(), begin.end() - 1);
        for (uint32_t row = low; row < high; ++row)
            for (uint32_t entry = start[row]; entry < start[row + 1]; ++entry)
                entries[next[column[entry]]++] = {entry, row};
    }

    // Add the products of factor(entry) and of_row(row) to the entries of `out` in their columns, bitwise as entry after
    // entry.
    template <class A, class Factor, class OfRow>
    void add(A* out, const Factor& factor, const OfRow& of_row) const {
        share(int64_t(begin.size()) - 1, [&](int64_t low, int64_t high) {
            for (int64_t c = low; c < high; ++c) {
                A total = out[c];
                for (uint32_t e = begin[c]; e < begin[c + 1]; ++e)
                    total = fma(factor(entries[e].entry), of_row(entries[e].row), total);
                out[c] = total;
            }
        });
    }

  private:
    struct Position {
        uint32_t entry, row;
    };
    std::vector<uint32_t> begin;
    std::vector<Position> entries;
};

// The entries of the linear terms by column, found when threads share them.
class EntriesOfTerms {
  public:
    explicit EntriesOfTerms(const Terms& terms) : terms(terms), by_term(terms.size) {}

    // Null if threads do not share the entries of term k, of coordinates below `size`.
    const EntriesByColumn* operator()(int64_t k, int64_t size) {
        const bool many = terms.row[k + 1] - terms.row[k] >= LEAST_SHARED;
        if (!team_of_this_thread || terms.kind[k] != LINEAR || !many) return nullptr;
        by_term[k].find(terms.row[k], terms.row[k + 1], terms.entry, terms.column, size);
        return &by_term[k];
    }

  private:
    const Terms& terms;
    std::vector<EntriesByColumn> by_term;
};

// Add to the cotangents of the coefficients of term k, and unless `of_coefficients_only`, of x. Those of its rows are
// `of_rows`, which begin at row `first`. The derivatives of functions by x, or then by coefficients, are at `functions`.
template <class A, class C>
NOINLINE void term_cotangents(const Terms& terms, const C& constants, const int64_t* functions, int64_t k, const A* x,
                              const A& t, const A* of_rows, int64_t first, bool of_coefficients_only, A* cotangents,
                              const CoefficientCotangents<A>& coefficients, HessianWorkspace<A>& workspace,
                              const EntriesByColumn* by_column = nullptr) {
    if (of_coefficients_only || terms.kind[k] != FUNCTION)
        each_coefficient(terms, constants, functions, k, x, t, workspace,
                         [&](int64_t index, int64_t row, const A& factor) {
                             coefficients.offset[index] = fma(of_rows[row - first], factor, coefficients.offset[index]);
                         });
    if (of_coefficients_only) return;
    if (by_column)
        return by_column->add(cotangents,
                              [&](uint32_t entry) { return constants.template number_at<A>(terms.weight, entry); },
                              [&](uint32_t row) { return of_rows[row - first]; });
    each_second_derivative(terms, constants, functions, k, x, t, workspace, false,
                           [&](int64_t row, uint32_t coordinate, const A& number, const auto& product) {
                               cotangents[coordinate] =
                                   fma(number * product(A(1.0)), of_rows[row - first], cotangents[coordinate]);
                           });
}

// One term of an entry of D_a: x[to] changes by factor x[from], and if it rotates, x[from] by -factor x[to].
template <class N>
struct GeneratorEntry {
    uint32_t to, from;
    N factor;
    bool rotates;
};

// The angles of the added part: its generators and the linear terms, preprocessed when a loop starts.
template <class N>
class AddedAngles {
  public:
    bool simple = false;  // only linear terms, and blocks of one or two coordinates

    template <class C>
    AddedAngles(const FlowCotangents& all, const C& constants, bool with_group) {
        if (all.added < 0) return;
        const FlowTables& tables = all.base;
        const Terms& terms = tables.terms;
        const uint32_t part = uint32_t(all.added), low = tables.share[part], high = tables.share[part + 1];
        first = terms.row[low], count = terms.row[high] - first;
        for (uint32_t a = 0; a < count; ++a)
            angle_of.insert(angle_of.end(), terms.entry[first + a + 1] - terms.entry[first + a], a);
        simple = append(tables.state, constants, part, state) &&
                 (!with_group || append(tables.group, constants, part, group));
        for (uint32_t k = low; k < high; ++k) simple = simple && terms.kind[k] == LINEAR;
    }

    // Add the cotangents of the coefficients for a flow over the time tau; fill `totals` with those of the angles.
    template <class A, class G, class C>
    INLINE void add(const Terms& terms, double tau, const C& at, bool with_group, A* totals, A* of_offset,
                    A* of_weight) const {
        const uint32_t* column = terms.column + terms.entry[first];
        A* of_entry = of_weight + terms.entry[first];
        share(count, [&](int64_t low, int64_t high) {
            for (int64_t a = low; a < high; ++a) {
                A total(0.0);
                for (uint32_t e = state.start[a]; e < state.start[a + 1]; ++e)
                    total = product(state.entries[e], at.x, at.of_x, total);
                if (with_group)
                    total += over_rows<A, G>([&](int64_t first, int64_t step) {
                        const int64_t rows = at.group.rows;
                        G sum(0.0);
                        for (uint32_t e = group.start[a]; e < group.start[a + 1]; ++e)
                            for (int64_t row = first; row < rows; row += step) {
                                const GeneratorEntry<N>& entry = group.entries[e];
                                const GeneratorEntry<N> moved{uint32_t(entry.to * rows + row),
                                                              uint32_t(entry.from * rows + row), entry.factor,
                                                              entry.rotates};
                                sum = product(moved, at.group.at, at.of_group.at, sum);
                            }
                        return sum;
                    });
                totals[a] = total * A(tau);
                of_offset[first + a] += totals[a];
            }
        });
        share(int64_t(angle_of.size()), [&](int64_t low, int64_t high) {
            for (int64_t e = low; e < high; ++e) of_entry[e] = fma(totals[angle_of[e]], at.x[column[e]], of_entry[e]);
        });
    }

  private:
    struct Generators {
        std::vector<uint32_t> start;
        std::vector<GeneratorEntry<N>> entries;
    };
    Generators state, group;
    std::vector<uint32_t> angle_of;  // the angles of the entries of the terms
    uint32_t first = 0, count = 0;

    template <class V>
    static INLINE V product(const GeneratorEntry<N>& entry, const V* x, const V* cotangents, const V& total) {
        const V factor(entry.factor);
        V moved = x[entry.from] * cotangents[entry.to];
        if (entry.rotates) moved = moved - x[entry.to] * cotangents[entry.from];
        return fma(factor, moved, total);
    }

    template <class C>
    bool append(const Action& action, const C& constants, uint32_t part, Generators& to) const {
        std::vector<std::vector<GeneratorEntry<N>>> of_angle(count);
        for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
            const int kind = action.kind[run];
            if (kind != ROTATE && kind != SHEAR && kind != SCALE) return false;
            const uint32_t repeat = action.repeat[run], *index = action.indices + action.position[run];
            for (uint32_t q = 0; q < action.angles[run]; ++q)
                for (uint32_t b = 0; b < repeat; ++b, index += kind == SCALE ? 1 : 2) {
                    const N factor = constants.template number_at<N>(
                        action.constants, action.constant[run] + (kind == SHEAR ? q * repeat + b : q));
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

}  // namespace coadjoint
