// Derivatives of the stages of a substep with known slopes, along tangent vectors and transposed.
//
// The slopes are L_j = h_j J(P_j) grad H(Q_j). The points P and Q are the stages X_i = x + sum_j mix_ij L_j, the last
// function iterates Z, or one of them each, if a factor is frozen. The element of the group has the slopes M_j = -h_j
// sign G_j rho(u_j), with u_j = grad H(Q_j).
#pragma once

#include "numbers/linear_solve.hpp"
#include "stages/runge_kutta_loop.hpp"
#include "tangents/flow_cotangents.hpp"
#include "tangents/flow_tangents.hpp"

namespace coadjoint {

struct NotSolved {};  // thrown if the linear equations of the derivatives are not solved

constexpr int64_t MOST_DERIVATIVE_ITERATIONS = 64;
// Relative change that counts as rounding, and largest one at which the iteration may stagnate.
constexpr double DERIVATIVE_ROUNDING = 0x1p-51, DERIVATIVE_STAGNATION = 0x1p-40;

class StagePoints {
  public:
    const RungeKuttaCotangents& all;
    const RungeKuttaTables& tables;
    const Field& field;
    const GroupField& group;
    const int64_t n, s, d, square;

    explicit StagePoints(const RungeKuttaCotangents& all)
        : all(all), tables(all.base), field(all.base.field), group(all.base.group), n(field.size), s(tables.stages),
          d(group.size), square(d * d), iterated(tables.solver == ITERATED || tables.solver >= STRUCTURE), fields(field),
          points(s * n), iterates(iterated ? (tables.iterations + 1) * s * n : 0), slopes(s * n), gradients(s * n),
          elements(s * square) {}

    // A substep from x and the element g, of length h at the time t; `found` are its slopes, those of g after those of x.
    void begin(const double* x, const double* g, double t, double h, const double* found, bool gradients_needed) {
        time = t, length = h;
        mix(x, found, n, points.at);
        mix(g, found + s * n, square, elements.at);
        if (iterated)
            for (int64_t i = 0; i < s; ++i) std::copy_n(x, n, iterates.at + i * n);
        for (int64_t pass = 0; iterated && pass < tables.iterations; ++pass) {
            const double* from = iterates.at + pass * s * n;
            for (int64_t j = 0; j < s; ++j) {
                gradient(field, SharedConstants{}, from + j * n, time_of(j), gradients.at + j * n, fields);
                product(field, SharedConstants{}, from + j * n, gradients.at + j * n, length_of(j), slopes.at + j * n,
                        fields);
            }
            mix(x, slopes.at, n, iterates.at + (pass + 1) * s * n);
        }
        for (int64_t j = 0; gradients_needed && j < s; ++j)
            gradient(field, SharedConstants{}, of_gradient() + j * n, time_of(j), gradients.at + j * n, fields);
    }

    const double* last_iterates() const { return iterates.at + tables.iterations * s * n; }
    const double* iterates_of(int64_t pass) const { return iterates.at + pass * s * n; }
    const double* of_structure() const {
        return tables.solver == ITERATED || tables.solver == STRUCTURE ? last_iterates() : points.at;
    }
    const double* of_gradient() const {
        return tables.solver == ITERATED || tables.solver == GRADIENT ? last_iterates() : points.at;
    }
    const double* gradient_of(int64_t j) const { return gradients.at + j * n; }
    const double* element_of(int64_t j) const { return elements.at + j * square; }
    double time_of(int64_t j) const { return time + tables.node[j] * length; }
    double length_of(int64_t j) const { return length * tables.scale[j]; }
    int64_t longest_added() const {
        int64_t longest = 1;
        for (int64_t k = 0; k < all.added.size; ++k)
            longest = std::max<int64_t>(longest, all.added.row[k + 1] - all.added.row[k]);
        return longest;
    }

    const bool iterated;
    FieldWorkspace<double> fields;

  private:
    AlignedArray<double> points, iterates, slopes, gradients, elements;
    double time = 0.0, length = 0.0;

    void mix(const double* base, const double* from, int64_t size, double* to) const {
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < size; ++c) {
                double total = 0.0;
                for (int64_t j = 0; j < s; ++j) total = fma(tables.mix[i * s + j], from[j * size + c], total);
                to[i * size + c] = base[c] + total;
            }
    }
};

// Solve y_i = b_i + sum_j c_ij z_j, z_j = apply(j, y_j), for the y_i and z_i of `size` numbers; c is `mix`, or its
// transpose. By iteration, each stage with the latest slopes, and if it does not converge, by LU factors of the equations of one number after the other.
template <class V>
class StageEquations {
  public:
    StageEquations(const RungeKuttaTables& tables, int64_t size, int64_t copies, bool transposed)
        : tables(tables), s(tables.stages), size(size), copies(copies), transposed(transposed), y(s * size * copies),
          z(s * size * copies), before(s * size * copies), forecast(tables.substeps == 1 ? s * s : 0) {
        // z_j, transposed z_j / out_j, is a smooth function of the node, continued to those of the adjacent step.
        const double shift = transposed ? -1.0 : 1.0;
        for (int64_t i = 0; i < s && tables.substeps == 1; ++i)
            for (int64_t j = 0; j < s; ++j) {
                double entry = transposed ? tables.out[i] / tables.out[j] : 1.0;
                for (int64_t k = 0; k < s; ++k)
                    if (k != j) entry *= (tables.node[i] + shift - tables.node[k]) / (tables.node[j] - tables.node[k]);
                forecast.at[i * s + j] = entry - entry == 0.0 ? entry : 0.0;
            }
    }

    V* of_stage(int64_t i) { return y.at + i * size * copies; }
    V* slope_of(int64_t j) { return z.at + j * size * copies; }

    // `base(i, y_i)` sets b_i; `apply(j, y_j, z_j)` sets z_j, and is affine in y_j.
    template <class Base, class Apply>
    void solve(Base base, Apply apply) {
        const int64_t count = s * size * copies;
        if (tables.solver == EXPLICIT) return one_by_one(base, apply);
        extrapolate(count);
        double earlier = 0.0;
        for (int64_t passed = 0; passed < MOST_DERIVATIVE_ITERATIONS; ++passed) {
            std::copy_n(z.at, count, before.at);
            for (int64_t j = 0; j < s; ++j) {
                mix(j, 0, s, base);
                apply(j, of_stage(j), slope_of(j));
            }
            V change_of(0.0), largest_of(0.0), undefined(0.0);
            for (int64_t k = 0; k < count; ++k) {
                change_of = larger(change_of, absolute(z.at[k] - before.at[k]));
                largest_of = larger(largest_of, absolute(z.at[k]));
                undefined += 0.0 * z.at[k];
            }
            if (!all(undefined == V(0.0))) break;
            const double change = over_lanes(change_of), largest = over_lanes(largest_of);
            // The next change, predicted from the last two, would be rounding.
            if (change <= DERIVATIVE_ROUNDING * largest || change * change <= DERIVATIVE_ROUNDING * largest * earlier ||
                (passed > 0 && change >= earlier && change <= DERIVATIVE_STAGNATION * largest))
                return;
            earlier = change;
        }
        by_factors(base, apply);
    }

  private:
    const RungeKuttaTables& tables;
    const int64_t s, size, copies;
    const bool transposed;
    AlignedArray<V> y, z, before;
    AlignedArray<double> forecast;

    // Begin with the solution of the last step, continued, or with zero.
    void extrapolate(int64_t count) {
        if (tables.substeps > 1) return std::fill_n(z.at, count, V(0.0)), void();
        std::copy_n(z.at, count, before.at);
        const int64_t length = size * copies;
        for (int64_t i = 0; i < s; ++i)
            for (int64_t k = 0; k < length; ++k) {
                V total(0.0);
                for (int64_t j = 0; j < s; ++j) total = fma(V(forecast.at[i * s + j]), before.at[j * length + k], total);
                z.at[i * length + k] = total;
            }
    }

    double weight(int64_t i, int64_t j) const { return transposed ? tables.mix[j * s + i] : tables.mix[i * s + j]; }

    static double over_lanes(const V& value) {
        double most = 0.0;
        for (int lane = 0; lane < Numbers<V>::lanes; ++lane) most = std::max(most, lane_of(value, lane));
        return most;
    }

    template <class Base>
    void mix(int64_t i, int64_t first, int64_t last, Base base) {
        V* to = of_stage(i);
        base(i, to);
        for (int64_t j = first; j < last; ++j)
            if (const double by = weight(i, j))
                for (int64_t k = 0; k < size * copies; ++k) to[k] = fma(V(by), slope_of(j)[k], to[k]);
    }

    template <class Base, class Apply>
    void one_by_one(Base base, Apply apply) {
        for (int64_t position = 0; position < s; ++position) {
            const int64_t j = transposed ? s - 1 - position : position;
            transposed ? mix(j, j + 1, s, base) : mix(j, 0, j, base);
            apply(j, of_stage(j), slope_of(j));
        }
    }

    // With the matrix of `apply`, found from its values at unit vectors.
    template <class Base, class Apply>
    NOINLINE void by_factors(Base base, Apply apply) {
        const int64_t edge = s * size, lanes = Numbers<V>::lanes;
        if (edge > LARGEST_FACTORED) throw NotSolved();
        InterruptCheck::of_this_call().after(edge * edge * edge);
        AlignedArray<double> matrix(edge * edge), pivots(edge), blocks(s * size * size);
        AlignedArray<V> zero(size * copies), constant(s * size * copies), image(size * copies);
        for (int64_t j = 0; j < s; ++j) {
            apply(j, zero.at, constant.at + j * size * copies);
            for (int64_t k = 0; k < size; ++k) {
                for (int64_t c = 0; c < copies; ++c) zero.at[k * copies + c] = V(1.0);
                apply(j, zero.at, image.at);
                for (int64_t c = 0; c < copies; ++c) zero.at[k * copies + c] = V(0.0);
                for (int64_t i = 0; i < size; ++i)
                    blocks.at[(j * size + i) * size + k] =
                        lane_of(image.at[i * copies] - constant.at[(j * size + i) * copies], 0);
            }
        }
        for (int64_t i = 0; i < s; ++i)
            for (int64_t j = 0; j < s; ++j)
                for (int64_t a = 0; a < size; ++a)
                    for (int64_t b = 0; b < size; ++b)
                        matrix.at[(i * size + a) * edge + j * size + b] =
                            fma(-weight(i, j), blocks.at[(j * size + a) * size + b], i == j && a == b ? 1.0 : 0.0);
        if (!factorize(matrix.at, edge, pivots.at)) throw NotSolved();
        std::copy_n(constant.at, s * size * copies, z.at);
        for (int64_t i = 0; i < s; ++i) mix(i, 0, s, base);
        substitute(matrix.at, edge, pivots.at, reinterpret_cast<double*>(y.at), copies * lanes);
        for (int64_t j = 0; j < s; ++j) apply(j, of_stage(j), slope_of(j));
    }
};

constexpr int64_t LARGEST_DENSE_STAGE = 8;  // coordinates up to which the Jacobian of a stage is stored

// The Jacobians h_j f'(X_j) of the stages of small systems with a quadratic energy: f' is an affine function of the state,
// whose coefficients are found from its values at the unit vectors.
class StageJacobians {
  public:
    const bool used;

    explicit StageJacobians(StagePoints& at)
        : used(suitable(at)), at(at), n(at.n), coefficients(used ? (n + 1) * n * n : 0),
          jacobians(used ? at.s * n * n : 0) {
        if (!used) return;
        const Terms& terms = at.field.terms;
        AlignedArray<double> hessian(n * n), product(n * n), point(n), u(n);
        for (uint32_t row = 0; row < terms.row[terms.size]; ++row)
            for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                hessian.at[terms.target[row] * n + terms.column[entry]] += terms.weight[entry];
        for (int64_t k = 0; k <= n; ++k) {
            if (k > 0) point.at[k - 1] = 1.0;
            gradient(at.field, SharedConstants{}, point.at, 0.0, u.at, at.fields);
            double* here = coefficients.at + k * n * n;
            coadjoint_matrix(at.field, SharedConstants{}, u.at, 1.0, here);
            structure_times_matrix(at.field, SharedConstants{}, point.at, hessian.at, 1.0, product.at, at.fields);
            for (int64_t e = 0; e < n * n; ++e) here[e] += product.at[e] - (k > 0 ? coefficients.at[e] : 0.0);
            if (k > 0) point.at[k - 1] = 0.0;
        }
    }

    void set() {
        for (int64_t j = 0; j < at.s; ++j) {
            double* jacobian = jacobians.at + j * n * n;
            const double *x = at.of_structure() + j * n, h = at.length_of(j);
            for (int64_t e = 0; e < n * n; ++e) {
                double total = coefficients.at[e];
                for (int64_t k = 0; k < n; ++k) total = fma(x[k], coefficients.at[(k + 1) * n * n + e], total);
                jacobian[e] = h * total;
            }
        }
    }

    // z = the Jacobian of stage j, or its transpose, times y, for vectors side by side.
    template <bool transposed, class V>
    INLINE void multiply(int64_t j, const V* y, V* z, int64_t rows) const {
        const double* jacobian = jacobians.at + j * n * n;
        // Loops of known length are unrolled.
        if (n == 3) return multiply_by<transposed>(jacobian, std::integral_constant<int64_t, 3>(), y, z, rows);
        if (n == 6) return multiply_by<transposed>(jacobian, std::integral_constant<int64_t, 6>(), y, z, rows);
        multiply_by<transposed>(jacobian, n, y, z, rows);
    }

  private:
    StagePoints& at;
    const int64_t n;
    AlignedArray<double> coefficients, jacobians;

    template <bool transposed, class Size, class V>
    static INLINE void multiply_by(const double* jacobian, Size size, const V* y, V* z, int64_t rows) {
        for (int64_t b = 0; b < rows; ++b)
            for (int64_t i = 0; i < size; ++i) {
                V total(0.0);
                for (int64_t k = 0; k < size; ++k)
                    total = fma(V(jacobian[transposed ? k * size + i : i * size + k]), y[k * rows + b], total);
                z[i * rows + b] = total;
            }
    }

    static bool suitable(const StagePoints& at) {
        const Terms& terms = at.field.terms;
        bool linear = at.n <= LARGEST_DENSE_STAGE && !at.field.nonlinear && at.tables.solver <= IMPLICIT && !at.iterated;
        for (int64_t k = 0; k < terms.size; ++k) linear = linear && terms.kind[k] == LINEAR;
        return linear;
    }
};

// Tangent vectors of one member, `rows` blocks of lanes, through a substep.
class StageTangents {
  public:
    typedef TangentLanes V;
    StageTangents(StagePoints& at, int64_t rows)
        : at(at), rows(rows), n(at.n), s(at.s), d(at.d), tangents{n, 0, 0, nullptr, at.all.hessians, at.all.derivative},
          changes(at.field, tangents, rows), jacobians(at), momentum(at.tables, n, rows, false),
          element(at.tables, at.square, rows, false), workspace(std::max(at.field.longest, at.longest_added())),
          of_gradients(s * n * rows), of_iterates(s * n * rows), of_slopes(s * n * rows), part(longest() * rows) {}

    // Whether the gradients of the stages are read.
    bool needs_gradients(bool of_group) const { return of_group || !jacobians.used; }

    // Move vectors of the state and, unless null, of the element; `directions` are those of the coefficients of `added`.
    void move(V* vectors, V* of_group, const V* directions) {
        const RungeKuttaTables& tables = at.tables;
        const int64_t count = n * rows;
        for (int64_t i = 0; i < s; ++i) std::copy_n(vectors, count, of_iterates.at + i * count);
        if (at.iterated)
            for (int64_t pass = 0; pass < tables.iterations; ++pass) {
                for (int64_t j = 0; j < s; ++j) {
                    const double* point = at.iterates_of(pass) + j * n;
                    set_gradient_change(j, point, of_iterates.at + j * count, directions);
                    gradient(at.field, SharedConstants{}, point, at.time_of(j), scratch(), at.fields);
                    slope(j, point, scratch(), of_iterates.at + j * count, of_slopes.at + j * count);
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
        const auto apply = [&](int64_t j, const V* y, V* z) {
            const V* frozen = of_iterates.at + j * count;
            set_gradient_change(j, at.of_gradient() + j * n, at.tables.solver == GRADIENT ? frozen : y, directions);
            slope(j, at.of_structure() + j * n, at.gradient_of(j), at.tables.solver == STRUCTURE ? frozen : y, z);
        };
        if (jacobians.used) {
            jacobians.set();
            for (int64_t j = 0; directions && j < s; ++j) {
                const double* point = at.of_gradient() + j * n;
                std::fill_n(of_gradients.at + j * count, count, V(0.0));
                add_directions(j, point, directions);
                of_product(j, point, of_slopes.at + j * count);
            }
            momentum.solve(base, [&](int64_t j, const V* y, V* z) {
                jacobians.multiply<false>(j, y, z, rows);
                for (int64_t k = 0; directions && k < count; ++k) z[k] += of_slopes.at[j * count + k];
            });
            for (int64_t j = 0; of_group && j < s; ++j)
                set_gradient_change(j, at.of_gradient() + j * n, momentum.of_stage(j), directions);
        } else if (tables.solver == ITERATED) {
            for (int64_t j = 0; j < s; ++j) apply(j, of_iterates.at + j * count, momentum.slope_of(j));
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
    const Tangents tangents;
    FieldChanges<V> changes;
    StageJacobians jacobians;
    StageEquations<V> momentum, element;
    HessianWorkspace<double> workspace;
    AlignedArray<V> of_gradients, of_iterates, of_slopes, part;
    std::vector<double> spare;

    double* scratch() { return spare.resize(n), spare.data(); }
    int64_t longest() const { return std::max(at.field.longest, at.longest_added()); }

    // Add the change of the rows of a term, in `part`, to that of grad H(Q_j).
    void add_rows(const Terms& terms, int64_t k, V* to) {
        for (int64_t row = terms.row[k]; row < int64_t(terms.row[k + 1]); ++row)
            for (int64_t b = 0; b < rows; ++b)
                to[terms.target[row] * rows + b] += part.at[(row - terms.row[k]) * rows + b];
    }

    void add_directions(int64_t j, const double* point, const V* directions) {
        const Terms& added = at.all.added;
        for (int64_t k = 0; k < added.size; ++k) {
            std::fill_n(part.at, (added.row[k + 1] - added.row[k]) * rows, V(0.0));
            add_coefficient_changes(added, k, point, directions, rows, part.at, added.row[k]);
            add_rows(added, k, of_gradients.at + j * n * rows);
        }
    }

    // The change of grad H(Q_j) for a change of Q_j and of the coefficients.
    void set_gradient_change(int64_t j, const double* point, const V* vectors, const V* directions) {
        V* to = of_gradients.at + j * n * rows;
        std::fill_n(to, n * rows, V(0.0));
        const Terms& terms = at.field.terms;
        for (int64_t k = 0; k < terms.size; ++k) {
            gradient_changes(terms, at.all.hessians, k, point, at.time_of(j), vectors, rows, part.at, terms.row[k],
                             workspace);
            add_rows(terms, k, to);
        }
        if (directions) add_directions(j, point, directions);
    }

    // z = h_j J(P_j) times the change of grad H(Q_j).
    void of_product(int64_t j, const double* point, V* z) {
        const Field& field = at.field;
        const V* of_gradient = of_gradients.at + j * n * rows;
        const double h = at.length_of(j);
        std::fill_n(z, n * rows, V(0.0));
        if (field.nonlinear) structure(field, SharedConstants{}, point, at.fields);
        const auto add = [&](int64_t i, double factor, int64_t k) {
            for (int64_t b = 0; b < rows; ++b) z[i * rows + b] = fma(V(factor), of_gradient[k * rows + b], z[i * rows + b]);
        };
        for (int64_t i = 0; i < n; ++i)
            if (field.nonlinear)
                for (int64_t k = 0; k < n; ++k) add(i, h * field.sign * at.fields.matrix.at[i * n + k], k);
            else
                for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                    add(i, h * (field.constant[q] * point[field.state[q]]), field.column[q]);
    }

    // The change of h_j J(P_j) u_j, with that of u_j in `of_gradients`.
    void slope(int64_t j, const double* point, const double* u, const V* of_point, V* z) {
        of_product(j, point, z);
        changes.of_structure(point, u, of_point, at.length_of(j), z);
    }

    void move_element(V* of_group) {
        const int64_t count = at.square * rows;
        const GroupField& group = at.group;
        element.solve([&](int64_t, V* y) { std::copy_n(of_group, count, y); },
                      [&](int64_t j, const V* y, V* z) {
                          std::fill_n(z, count, V(0.0));
                          const double h = at.length_of(j);
                          for (int64_t q = 0; q < group.entries; ++q) {
                              const double by = h * group.value[q];
                              const V entry(by * at.gradient_of(j)[group.element[q]]);
                              const V* change = of_gradients.at + (j * n + group.element[q]) * rows;
                              for (int64_t r = 0; r < d; ++r) {
                                  const int64_t from = group.row[q] * d + r, to = (group.column[q] * d + r) * rows;
                                  const V value(by * at.element_of(j)[from]);
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
        : at(at), n(at.n), s(at.s), d(at.d), jacobians(at), momentum(at.tables, n, 1, true), element(at.tables, at.square, 1, true),
          workspace(std::max(at.field.longest, at.longest_added())), of_gradients(s * n), of_points(s * n),
          of_slopes(s * n), none_of(s * n), w(n), of_rows(std::max(at.field.longest, at.longest_added())),
          unused(CoefficientCotangents<double>::count(at.field.terms)), none(at.field.terms, unused.at),
          derivative(at.field.nonlinear ? n * n * n : 0), calls(at.field.nonlinear ? n * (1 + n * n) : 0) {}

    // Whether the gradients of the stages are read.
    bool needs_gradients(bool of_group) const { return of_group || !jacobians.used; }

    // Replace the cotangents of the state and, unless null, of the element after the substep by those before it.
    void move(double* cotangents, double* of_group, const CoefficientCotangents<double>& coefficients) {
        const RungeKuttaTables& tables = at.tables;
        std::fill_n(of_gradients.at, s * n, 0.0);
        if (of_group) move_element(of_group);
        const auto base = [&](int64_t j, double* y) {
            for (int64_t i = 0; i < n; ++i) y[i] = tables.out[j] * cotangents[i];
        };
        // The slopes are those of the stages that vary; the frozen factor follows.
        const auto apply = [&](int64_t j, const double* y, double* z) {
            std::fill_n(z, n, 0.0);
            if (tables.solver != GRADIENT) pull_gradient(j, at.of_structure(), at.of_gradient(), y, true, nullptr, z);
            if (tables.solver != STRUCTURE) pull_structure(j, at.of_structure(), at.gradient_of(j), y, z);
        };
        if (jacobians.used) {
            jacobians.set();
            // The effect of the element on the gradients, through their derivatives.
            std::fill_n(of_points.at, s * n, 0.0);
            std::fill_n(none_of.at, s * n, 0.0);
            for (int64_t j = 0; of_group && j < s; ++j)
                pull_gradient(j, at.of_structure(), at.of_gradient(), none_of.at, true, nullptr, of_points.at + j * n);
            momentum.solve(base, [&](int64_t j, const double* y, double* z) {
                jacobians.multiply<true>(j, y, z, 1);
                for (int64_t i = 0; of_group && i < n; ++i) z[i] += of_points.at[j * n + i];
            });
        } else if (tables.solver == ITERATED) {
            for (int64_t j = 0; j < s; ++j) {
                base(j, momentum.of_stage(j));
                apply(j, momentum.of_stage(j), of_points.at + j * n);
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
    HessianWorkspace<double> workspace;
    AlignedArray<double> of_gradients, of_points, of_slopes, none_of, w, of_rows, unused;
    const CoefficientCotangents<double> none;
    std::vector<double> derivative, calls, gradients;

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
        if (field.nonlinear) {
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
                term_cotangents(terms, at.all.hessians, k, q, at.time_of(j), of_rows.at, first, of_coefficients_only, out,
                                of, workspace);
            }
        };
        if (out) each_term(field.terms, false, none);
        if (!coefficients) return;
        const Terms& added = at.all.added;
        if (added.size > 1 || added.kind[0] != LINEAR) return each_term(added, true, *coefficients);
        for (uint32_t row = 0, entry = 0; row < added.row[1]; ++row) {
            const double of_row = w.at[added.target[row]];
            coefficients->offset[row] += of_row;
            for (const uint32_t stop = added.entry[row + 1]; entry < stop; ++entry)
                coefficients->weight[entry] = fma(of_row, q[added.column[entry]], coefficients->weight[entry]);
        }
    }

    // Add to `out` the cotangent of P_j for that of h_j J(P_j) u.
    void pull_structure(int64_t j, const double* of_structure, const double* u, const double* y, double* out) {
        const Field& field = at.field;
        const double h = at.length_of(j);
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
                      [&](int64_t j, const double* y, double* z) {
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
