// Derivatives of the stages of a substep with known slopes, along tangent vectors and transposed.
#pragma once

#include "tangents/flow_tangents.hpp"
#include "tangents/stage_jacobians.hpp"

namespace coadjoint {

// Tangent vectors of one member, `rows` blocks of lanes V, through a substep. The equations of its stages are solved by
// iteration, or `by_factors`.
template <class V>
class StageTangents {
  public:
    StageTangents(StagePoints& at, int64_t rows, bool by_factors = false)
        : at(at), rows(rows), n(at.n), s(at.s), d(at.d), by_factors(by_factors), jacobians(at, false, !by_factors),
          momentum(at.tables, n, rows, false), element(at.tables, at.square, rows, false), workspace(at.field.terms),
          of_added(at.all.added), of_gradients(s * n * rows), of_iterates(s * n * rows), of_slopes(s * n * rows),
          part(longest() * rows), found(jacobians.used ? 2 * s * n * rows : 0), spare(n),
          derivative(at.field.nonlinear ? n * n * n : 0), calls(at.field.nonlinear ? n * (1 + n * n) : 0) {}

    // The next substep does not follow the last one.
    void restart() {
        jacobians.restart(), momentum.restart(), element.restart();
        std::fill_n(found.at, jacobians.used ? 2 * s * n * rows : 0, V(0.0));
    }

    // Move vectors of the state and, unless null, of the element; `directions` are those of the coefficients of `added`.
    void move(V* vectors, V* of_group, const V* directions) {
        const RungeKuttaTables& tables = at.tables;
        const int64_t count = n * rows;
        if (jacobians.used) jacobians.set();
        if (!jacobians.used || of_group || directions) at.set();
        if (jacobians.used) {
            for (int64_t j = 0; directions && j < s; ++j) {
                const double* point = at.of_gradient() + j * n;
                std::fill_n(of_gradients.at + j * count, count, V(0.0));
                add_directions(j, point, directions);
                of_product(j, point, of_slopes.at + j * count);
            }
            if (!of_group && jacobians.push(vectors, directions ? of_slopes.at : nullptr, rows, found.at)) return;
        }
        for (int64_t i = 0; i < s; ++i) std::copy_n(vectors, count, of_iterates.at + i * count);
        if (at.iterated)
            for (int64_t pass = 0; pass < tables.iterations; ++pass) {
                for (int64_t j = 0; j < s; ++j) {
                    const double* point = at.iterates_of(pass) + j * n;
                    set_gradient_change(j, point, of_iterates.at + j * count, directions);
                    gradient(at.field, SharedConstants{}, point, at.time_of(j), spare.data(), at.fields);
                    slope(j, point, spare.data(), of_iterates.at + j * count, of_slopes.at + j * count);
                }
                for (int64_t i = 0; i < s; ++i) {
                    V* to = of_iterates.at + i * count;
                    std::copy_n(vectors, count, to);
                    for (int64_t j = 0; j < s; ++j)
                        for (int64_t k = 0; k < count; ++k)
                            to[k] = fma(V(tables.mix[i * s + j]), of_slopes.at[j * count + k], to[k]);
                }
            }
        const auto base = [&](int64_t, V* y) { std::copy_n(vectors, count, y); };
        // Unless `linear`, with the effect of the frozen factor and of the coefficients.
        const auto apply = [&](int64_t j, const V* y, V* z, bool linear) {
            const V* frozen = linear ? nullptr : of_iterates.at + j * count;
            set_gradient_change(j, at.of_gradient() + j * n, tables.solver == GRADIENT ? frozen : y,
                                linear ? nullptr : directions);
            slope(j, at.of_structure() + j * n, at.gradient_of(j), tables.solver == STRUCTURE ? frozen : y, z);
        };
        if (jacobians.used) {
            momentum.solve(base, [&](int64_t j, const V* y, V* z, bool linear) {
                jacobians.template multiply<false>(j, y, z, rows);
                for (int64_t k = 0; directions && !linear && k < count; ++k) z[k] += of_slopes.at[j * count + k];
            });
            for (int64_t j = 0; of_group && j < s; ++j)
                set_gradient_change(j, at.of_gradient() + j * n, momentum.of_stage(j), directions);
        } else if (tables.solver == ITERATED) {
            for (int64_t j = 0; j < s; ++j) apply(j, of_iterates.at + j * count, momentum.slope_of(j), false);
        } else if (by_factors && tables.solver != EXPLICIT) {
            momentum.solve_by_factors(base, apply, tables.solver == IMPLICIT && !directions);
        } else {
            momentum.solve(base, apply);
        }
        if (of_group) move_element(of_group);
        for (int64_t j = 0; j < s; ++j)
            for (int64_t k = 0; k < count; ++k) vectors[k] = fma(V(tables.out[j]), momentum.slope_of(j)[k], vectors[k]);
    }

  private:
    StagePoints& at;
    const int64_t rows, n, s, d;
    const bool by_factors;
    StageJacobians jacobians;
    StageEquations<V> momentum, element;
    HessianWorkspace<double> workspace, of_added;
    AlignedArray<V> of_gradients, of_iterates, of_slopes, part, found;
    std::vector<double> spare, derivative, calls;

    int64_t longest() const { return std::max(at.field.longest, at.longest_added()); }

    // Add the change of the rows of a term, in `part`, to that of grad H(Q_j).
    void add_rows(const Terms& terms, int64_t k, V* to) {
        const uint32_t start = terms.row[k];
        share(terms.row[k + 1] - start, [&](int64_t first, int64_t last) {
            for (int64_t row = first; row < last; ++row)
                for (int64_t b = 0; b < rows; ++b) to[terms.target[start + row] * rows + b] += part.at[row * rows + b];
        });
    }

    void add_directions(int64_t j, const double* point, const V* directions) {
        const Terms& added = at.all.added;
        for (int64_t k = 0; k < added.size; ++k) {
            std::fill_n(part.at, (added.row[k + 1] - added.row[k]) * rows, V(0.0));
            add_coefficient_changes(added, SharedConstants{}, at.all.functions, k, point, at.time_of(j), directions, rows,
                                    part.at, added.row[k], of_added);
            add_rows(added, k, of_gradients.at + j * n * rows);
        }
    }

    // The change of grad H(Q_j) for a change of Q_j and of the coefficients; none of them for null pointers.
    void set_gradient_change(int64_t j, const double* point, const V* vectors, const V* directions) {
        V* to = of_gradients.at + j * n * rows;
        std::fill_n(to, n * rows, V(0.0));
        const Terms& terms = at.field.terms;
        for (int64_t k = 0; vectors && k < terms.size; ++k) {
            gradient_changes(terms, SharedConstants{}, at.all.hessians, k, point, at.time_of(j), vectors, rows, part.at,
                             terms.row[k], workspace);
            add_rows(terms, k, to);
        }
        if (directions) add_directions(j, point, directions);
    }

    // z = h_j J(P_j) times the change of grad H(Q_j).
    void of_product(int64_t j, const double* point, V* z) {
        const Field& field = at.field;
        const V* of_gradient = of_gradients.at + j * n * rows;
        const double h = at.length_of(j);
        if (field.nonlinear) structure(field, SharedConstants{}, point, at.fields);
        share(n, [&](int64_t first, int64_t last) {
            std::fill(z + first * rows, z + last * rows, V(0.0));
            for (int64_t i = first; i < last; ++i)
                if (field.nonlinear)
                    for (int64_t k = 0; k < n; ++k)
                        add(i, h * field.sign * at.fields.matrix.at[i * n + k], of_gradient + k * rows, z);
                else
                    for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                        add(i, h * (field.constant[q] * point[field.state[q]]), of_gradient + field.column[q] * rows, z);
        });
    }

    INLINE void add(int64_t i, double factor, const V* from, V* z) const {
        for (int64_t b = 0; b < rows; ++b) z[i * rows + b] = fma(V(factor), from[b], z[i * rows + b]);
    }

    // The change of h_j J(P_j) u_j for that of P_j, none for a null pointer, with that of u_j in `of_gradients`.
    void slope(int64_t j, const double* point, const double* u, const V* of_point, V* z) {
        of_product(j, point, z);
        if (!of_point) return;
        const Field& field = at.field;
        const double h = at.length_of(j);
        if (!field.nonlinear) {
            return share(n, [&](int64_t first, int64_t last) {
                for (int64_t i = first; i < last; ++i)
                    for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                        add(i, h * (field.constant[q] * u[field.column[q]]), of_point + field.state[q] * rows, z);
            });
        }
        call_function(SharedConstants{}, at.all.derivative, 0, point, n, 0.0, derivative.data(), n * n * n, calls.data());
        for (int64_t i = 0; i < n; ++i)
            for (int64_t k = 0; k < n; ++k) {
                double entry = 0.0;
                for (int64_t l = 0; l < n; ++l) entry = fma(derivative[(i * n + l) * n + k], u[l], entry);
                add(i, h * (field.sign * entry), of_point + k * rows, z);
            }
    }

    void move_element(V* of_group) {
        const int64_t count = at.square * rows;
        const GroupField& group = at.group;
        element.solve([&](int64_t, V* y) { std::copy_n(of_group, count, y); },
                      [&](int64_t j, const V* y, V* z, bool linear) {
                          std::fill_n(z, count, V(0.0));
                          const double h = at.length_of(j);
                          for (int64_t q = 0; q < group.entries; ++q) {
                              const double by = h * group.value[q];
                              const V entry(by * at.gradient_of(j)[group.element[q]]);
                              const V* change = of_gradients.at + (j * n + group.element[q]) * rows;
                              for (int64_t r = 0; r < d; ++r) {
                                  const int64_t from = group.row[q] * d + r, to = (group.column[q] * d + r) * rows;
                                  const V value(linear ? 0.0 : by * at.element_of(j)[from]);
                                  for (int64_t b = 0; b < rows; ++b)
                                      z[to + b] = fma(y[from * rows + b], entry, fma(value, change[b], z[to + b]));
                              }
                          }
                      });
        for (int64_t j = 0; j < s; ++j)
            for (int64_t k = 0; k < count; ++k)
                of_group[k] = fma(V(at.tables.out[j]), element.slope_of(j)[k], of_group[k]);
    }
};

// Cotangents of one member through a substep, from its end to its start.
class StageCotangents {
  public:
    explicit StageCotangents(StagePoints& at)
        : at(at), n(at.n), s(at.s), d(at.d), jacobians(at, true, true), momentum(at.tables, n, 1, true),
          element(at.tables, at.square, 1, true), workspace(at.field.terms), of_added(at.all.added), of_gradients(s * n), of_points(s * n),
          of_slopes(s * n), none_of(s * n), w(n), of_rows(std::max(at.field.longest, at.longest_added())),
          unused(CoefficientCotangents<double>::count(at.field.terms)), none(at.field.terms, unused.at),
          by_stage(CoefficientCotangents<double>::count(at.all.added)),
          linear(at.all.added.size == 0 || (at.all.added.size == 1 && at.all.added.kind[0] == LINEAR)),
          derivative(at.field.nonlinear ? n * n * n : 0), calls(at.field.nonlinear ? n * (1 + n * n) : 0),
          by_term(at.field.terms) {}

    // The next substep does not follow the last one.
    void restart() { jacobians.restart(), momentum.restart(), element.restart(); }

    // Add those of the coefficients that are held by stage.
    void finish(double* coefficients) {
        for (int64_t k = 0; jacobians.used && k < CoefficientCotangents<double>::count(at.all.added); ++k) {
            for (int j = 0; j < s; ++j) coefficients[k] += lane_of(by_stage.at[k], j);
            by_stage.at[k] = StageJacobians::S(0.0);
        }
    }

    // Replace the cotangents of the state and, unless null, of the element after the substep by those before it.
    void move(double* cotangents, double* of_group, const CoefficientCotangents<double>& coefficients) {
        const RungeKuttaTables& tables = at.tables;
        if (jacobians.used) jacobians.set();
        if (jacobians.used && !of_group && linear && jacobians.pull(cotangents, at.all.added, by_stage.at)) return;
        at.set();
        std::fill_n(of_gradients.at, s * n, 0.0);
        if (of_group) move_element(of_group);
        const auto base = [&](int64_t j, double* y) {
            share(n, [&](int64_t first, int64_t last) {
                for (int64_t i = first; i < last; ++i) y[i] = tables.out[j] * cotangents[i];
            });
        };
        // The slopes are those of the stages that vary; the frozen factor follows.
        const auto apply = [&](int64_t j, const double* y, double* z, bool linear) {
            std::fill_n(z, n, 0.0);
            if (tables.solver != GRADIENT) pull_gradient(j, at.of_structure(), at.of_gradient(), y, !linear, nullptr, z);
            if (tables.solver != STRUCTURE) pull_structure(j, at.of_structure(), at.gradient_of(j), y, z);
        };
        if (jacobians.used) {
            // The effect of the element on the gradients, through their derivatives.
            std::fill_n(of_points.at, s * n, 0.0);
            std::fill_n(none_of.at, s * n, 0.0);
            for (int64_t j = 0; of_group && j < s; ++j)
                pull_gradient(j, at.of_structure(), at.of_gradient(), none_of.at, true, nullptr, of_points.at + j * n);
            momentum.solve(base, [&](int64_t j, const double* y, double* z, bool linear) {
                jacobians.multiply<true>(j, y, z, 1);
                for (int64_t i = 0; of_group && !linear && i < n; ++i) z[i] += of_points.at[j * n + i];
            });
        } else if (tables.solver == ITERATED) {
            for (int64_t j = 0; j < s; ++j) {
                base(j, momentum.of_stage(j));
                apply(j, momentum.of_stage(j), of_points.at + j * n, false);
            }
        } else {
            momentum.solve(base, apply);
            std::fill_n(of_points.at, s * n, 0.0);
        }
        for (int64_t j = 0; j < s; ++j) {
            const double* y = momentum.of_stage(j);
            if (at.all.added.size > 0) pull_gradient(j, at.of_structure(), at.of_gradient(), y, true, &coefficients, nullptr);
            if (tables.solver == STRUCTURE) pull_structure(j, at.of_structure(), at.gradient_of(j), y, of_points.at + j * n);
            if (tables.solver == GRADIENT)
                pull_gradient(j, at.of_structure(), at.of_gradient(), y, true, nullptr, of_points.at + j * n);
        }
        if (tables.solver != ITERATED)
            for (int64_t j = 0; j < s; ++j)
                for (int64_t i = 0; i < n; ++i) cotangents[i] += momentum.slope_of(j)[i];
        if (at.iterated) move_iterates(cotangents, coefficients);
    }

  private:
    StagePoints& at;
    const int64_t n, s, d;
    StageJacobians jacobians;
    StageEquations<double> momentum, element;
    HessianWorkspace<double> workspace, of_added;
    AlignedArray<double> of_gradients, of_points, of_slopes, none_of, w, of_rows, unused;
    const CoefficientCotangents<double> none;
    AlignedArray<StageJacobians::S> by_stage;
    const bool linear;
    std::vector<double> derivative, calls, gradients;
    EntriesOfTerms by_term;
    EntriesByColumn by_column, by_state;  // of the structure constants

    // Whether threads share the products with structure constants.
    bool is_shared() const { return team_of_this_thread && !at.field.nonlinear && n >= LEAST_SHARED; }

    // Function iterates backward; `of_points` are the cotangents of the last ones.
    void move_iterates(double* cotangents, const CoefficientCotangents<double>& coefficients) {
        const RungeKuttaTables& tables = at.tables;
        gradients.resize(n);
        for (int64_t pass = tables.iterations; pass >= 0; --pass) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < n; ++c) cotangents[c] += of_points.at[i * n + c];
            if (pass == 0) return;
            for (int64_t j = 0; j < s; ++j)
                for (int64_t c = 0; c < n; ++c) {
                    double total = 0.0;
                    for (int64_t i = 0; i < s; ++i) total = fma(tables.mix[i * s + j], of_points.at[i * n + c], total);
                    of_slopes.at[j * n + c] = total;
                }
            const double* points = at.iterates_of(pass - 1);
            std::fill_n(of_points.at, s * n, 0.0);
            for (int64_t j = 0; j < s; ++j) {
                const double* y = of_slopes.at + j * n;
                gradient(at.field, SharedConstants{}, points + j * n, at.time_of(j), gradients.data(), at.fields);
                pull_gradient(j, points, points, y, false, &coefficients, of_points.at + j * n);
                pull_structure(j, points, gradients.data(), y, of_points.at + j * n);
            }
        }
    }

    // Add to `out` the cotangent of Q_j, and to the coefficients, for that of h_j J(P_j) grad H(Q_j), and of the element.
    void pull_gradient(int64_t j, const double* of_structure, const double* of_gradient, const double* y, bool with_element,
                       const CoefficientCotangents<double>* coefficients, double* out) {
        const Field& field = at.field;
        const double *p = of_structure + j * n, *q = of_gradient + j * n, h = at.length_of(j);
        for (int64_t i = 0; i < n; ++i) w.at[i] = with_element ? of_gradients.at[j * n + i] : 0.0;
        if (is_shared()) {
            by_column.find(0, uint32_t(n), field.first, field.column, n);
            by_column.add(w.at, [&](uint32_t e) { return h * (field.constant[e] * p[field.state[e]]); },
                          [&](uint32_t i) { return y[i]; });
        } else if (field.nonlinear) {
            structure(field, SharedConstants{}, p, at.fields);
            for (int64_t i = 0; i < n; ++i)
                for (int64_t k = 0; k < n; ++k)
                    w.at[k] = fma(h * field.sign * at.fields.matrix.at[i * n + k], y[i], w.at[k]);
        } else {
            for (int64_t i = 0; i < n; ++i)
                for (uint32_t e = field.first[i]; e < field.first[i + 1]; ++e) {
                    double& entry = w.at[field.column[e]];
                    entry = fma(h * (field.constant[e] * p[field.state[e]]), y[i], entry);
                }
        }
        const auto each_term = [&](const Terms& terms, bool of_coefficients_only,
                                   const CoefficientCotangents<double>& of) {
            for (int64_t k = 0; k < terms.size; ++k) {
                const int64_t first = terms.row[k];
                for (int64_t row = first; row < int64_t(terms.row[k + 1]); ++row)
                    of_rows.at[row - first] = w.at[terms.target[row]];
                term_cotangents(terms, SharedConstants{}, of_coefficients_only ? at.all.functions : at.all.hessians, k,
                                q, at.time_of(j), of_rows.at, first, of_coefficients_only, out, of,
                                of_coefficients_only ? of_added : workspace,
                                of_coefficients_only ? nullptr : by_term(k, n));
            }
        };
        if (out) each_term(field.terms, false, none);
        if (coefficients) each_term(at.all.added, true, *coefficients);
    }

    // Add to `out` the cotangent of P_j for that of h_j J(P_j) u.
    void pull_structure(int64_t j, const double* of_structure, const double* u, const double* y, double* out) {
        const Field& field = at.field;
        const double h = at.length_of(j);
        if (is_shared()) {
            by_state.find(0, uint32_t(n), field.first, field.state, n);
            return by_state.add(out, [&](uint32_t e) { return h * (field.constant[e] * u[field.column[e]]); },
                                [&](uint32_t i) { return y[i]; });
        }
        if (!field.nonlinear) {
            for (int64_t i = 0; i < n; ++i)
                for (uint32_t e = field.first[i]; e < field.first[i + 1]; ++e) {
                    double& entry = out[field.state[e]];
                    entry = fma(h * (field.constant[e] * u[field.column[e]]), y[i], entry);
                }
            return;
        }
        call_function(SharedConstants{}, at.all.derivative, 0, of_structure + j * n, n, 0.0, derivative.data(), n * n * n,
                      calls.data());
        for (int64_t i = 0; i < n; ++i)
            for (int64_t l = 0; l < n; ++l)
                for (int64_t k = 0; k < n; ++k)
                    out[k] = fma(h * field.sign * derivative[(i * n + l) * n + k] * u[l], y[i], out[k]);
    }

    void move_element(double* of_group) {
        const GroupField& group = at.group;
        element.solve([&](int64_t j, double* y) {
                          for (int64_t e = 0; e < at.square; ++e) y[e] = at.tables.out[j] * of_group[e];
                      },
                      [&](int64_t j, const double* y, double* z, bool) {
                          std::fill_n(z, at.square, 0.0);
                          for (int64_t q = 0; q < group.entries; ++q) {
                              const double by = at.length_of(j) * group.value[q] * at.gradient_of(j)[group.element[q]];
                              for (int64_t r = 0; r < d; ++r) {
                                  double& entry = z[group.row[q] * d + r];
                                  entry = fma(by, y[group.column[q] * d + r], entry);
                              }
                          }
                      });
        for (int64_t j = 0; j < s; ++j) {
            const double *y = element.of_stage(j), *point = at.element_of(j);
            for (int64_t q = 0; q < group.entries; ++q) {
                double total = 0.0;
                for (int64_t r = 0; r < d; ++r) total = fma(point[group.row[q] * d + r], y[group.column[q] * d + r], total);
                double& entry = of_gradients.at[j * n + group.element[q]];
                entry = fma(at.length_of(j) * group.value[q], total, entry);
            }
            for (int64_t e = 0; e < at.square; ++e) of_group[e] += element.slope_of(j)[e];
        }
    }
};

}  // namespace coadjoint
