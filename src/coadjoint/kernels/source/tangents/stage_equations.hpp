// The stages of a substep with known slopes, and the linear equations of their derivatives.
//
// The slopes are L_j = h_j J(P_j) grad H(Q_j). The points P and Q are the stages X_i = x + sum_j mix_ij L_j, the last
// function iterates Z, or one of them each, if a factor is frozen. The element of the group has the slopes M_j = -h_j
// sign G_j rho(u_j), with u_j = grad H(Q_j).
#pragma once

#include "numbers/linear_solve.hpp"
#include "stages/runge_kutta_loop.hpp"
#include "tangents/angle_cotangents.hpp"

namespace coadjoint {

struct NotSolved {};  // thrown if the linear equations of the derivatives are not solved

// The iteration converges as that of the stages, in some ten.
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
    // The points and gradients of the stages follow by `set`.
    void begin(const double* x, const double* g, double t, double h, const double* found) {
        time = t, length = h, start = x, element = g, start_slopes = found;
    }

    void set() {
        const double *x = start, *g = element, *found = start_slopes;
        mix(x, found, n, points.at);
        mix(g, found + s * n, square, elements.at);
        if (iterated)
            for (int64_t i = 0; i < s; ++i) std::copy_n(x, n, iterates.at + i * n);
        for (int64_t pass = 0; iterated && pass < tables.iterations; ++pass) {
            const double* from = iterates.at + pass * s * n;
            for (int64_t j = 0; j < s; ++j) {
                slope_at(field, SharedConstants{}, from + j * n, time_of(j), length_of(j), gradients.at + j * n,
                         slopes.at + j * n, fields);
            }
            mix(x, slopes.at, n, iterates.at + (pass + 1) * s * n);
        }
        for (int64_t j = 0; j < s; ++j)
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
    const double *start = nullptr, *element = nullptr, *start_slopes = nullptr;
    double time_of(int64_t j) const { return time + tables.node[j] * length; }
    double length_of(int64_t j) const { return length * tables.scale[j]; }
    double length_of_step() const { return length; }
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
            share(size, [&](int64_t low, int64_t high) {
                for (int64_t c = low; c < high; ++c) {
                    double total = 0.0;
                    for (int64_t j = 0; j < s; ++j) total = fma(tables.mix[i * s + j], from[j * size + c], total);
                    to[i * size + c] = base[c] + total;
                }
            });
    }
};

// The coefficients that continue the z_j of the last step, or of the last two, the last one first, to the adjacent one:
// z_j / scale_j, transposed z_j / (scale_j out_j), is a smooth function of the node. Zero for several substeps, and where nodes coincide.
inline std::vector<double> forecast_of(const RungeKuttaTables& tables, bool transposed, int64_t steps) {
    const int64_t s = tables.stages, count = steps * s;
    std::vector<double> forecast(s * count);
    const double shift = transposed ? -1.0 : 1.0;
    const auto factor = [&](int64_t j) { return tables.scale[j] * (transposed ? tables.out[j] : 1.0); };
    const auto node = [&](int64_t j) { return j < s ? tables.node[j] : tables.node[j - s] - shift; };
    for (int64_t i = 0; tables.substeps == 1 && i < s; ++i)
        for (int64_t j = 0; j < count; ++j) {
            double entry = factor(i) / factor(j % s);
            for (int64_t k = 0; k < count; ++k)
                if (k != j) entry *= (tables.node[i] + shift - node(k)) / (node(j) - node(k));
            forecast[i * count + j] = entry - entry == 0.0 ? entry : 0.0;
        }
    return forecast;
}

// Whether an iteration has converged: the next change, predicted from the last two, would be rounding. In an iteration
// that diverges, the products overflow.
INLINE bool converged(double change, double earlier, double largest) {
    const double bound = DERIVATIVE_ROUNDING * largest * earlier;
    return change <= DERIVATIVE_ROUNDING * largest || (bound - bound == 0.0 && change * change <= bound) ||
           (earlier > 0.0 && change >= earlier && change <= DERIVATIVE_STAGNATION * largest);
}

// Solve y_i = b_i + sum_j c_ij z_j, z_j = apply(j, y_j), for the y_i and z_i of `size` numbers; c is `mix`, or its
// transpose. By iteration, each stage with the latest slopes, and if it does not converge, by LU factors.
template <class V>
class StageEquations {
  public:
    StageEquations(const RungeKuttaTables& tables, int64_t size, int64_t copies, bool transposed)
        : tables(tables), s(tables.stages), size(size), copies(copies), transposed(transposed), y(s * size * copies),
          z(s * size * copies), before(s * size * copies), forecast(forecast_of(tables, transposed, 1)) {}

    // The next step does not follow the last one.
    void restart() { std::fill_n(z.at, s * size * copies, V(0.0)); }

    V* of_stage(int64_t i) { return y.at + i * size * copies; }
    V* slope_of(int64_t j) { return z.at + j * size * copies; }

    // `base(i, y_i)` sets b_i; `apply(j, y_j, z_j, linear)` sets z_j, which is affine in y_j, or its linear part.
    template <class Base, class Apply>
    void solve(Base base, Apply apply) {
        const int64_t count = s * size * copies;
        if (tables.solver == EXPLICIT) return one_by_one(base, apply);
        extrapolate(count);
        double earlier = 0.0;
        for (int64_t passed = 0; passed < MOST_DERIVATIVE_ITERATIONS; ++passed) {
            shared_copy(z.at, count, before.at);
            for (int64_t j = 0; j < s; ++j) {
                mix(j, 0, s, base);
                apply(j, of_stage(j), slope_of(j), false);
            }
            V found[3] = {V(0.0), V(0.0), V(0.0)};
            shared_results<V>(
                count, 3, found,
                [&](int64_t first, int64_t last, V* to) {
                    for (int64_t k = first; k < last; ++k) {
                        to[0] = larger(to[0], absolute(z.at[k] - before.at[k]));
                        to[1] = larger(to[1], absolute(z.at[k]));
                        to[2] += 0.0 * z.at[k];
                    }
                },
                [](V* to, const V* more) {
                    to[0] = larger(to[0], more[0]), to[1] = larger(to[1], more[1]), to[2] += more[2];
                });
            if (!all(found[2] == V(0.0))) break;
            const double change = over_lanes(found[0]), largest = over_lanes(found[1]);
            if (converged(change, earlier, largest)) return;
            earlier = change;
        }
        if (s * size > LARGEST_FACTORED) throw NotSolved();
        solve_by_factors(base, apply, false);
    }

    // With the matrix of `apply`, found from its values at unit vectors. If `linear`, it has no constant part.
    NOINLINE void solve_by_factors(const Called<void(int64_t, V*)>& base,
                                   const Called<void(int64_t, const V*, V*, bool)>& apply, bool linear) {
        const int64_t edge = s * size, length = size * copies, width = copies * Numbers<V>::lanes;
        InterruptCheck::of_this_call().after(edge * edge * (edge + width));
        if (matrix.empty()) {
            matrix.resize(edge * edge), pivots.resize(edge), blocks.resize(edge * size);
            units.clear(length), image.clear(length);
        }
        double* unit = reinterpret_cast<double*>(units.at);
        for (int64_t j = 0; j < s; ++j) {
            if (linear)
                std::fill_n(slope_of(j), length, V(0.0));
            else
                apply(j, units.at, slope_of(j), false);
            for (int64_t first = 0; first < size; first += width) {
                const int64_t count = std::min(width, size - first);
                for (int64_t k = 0; k < count; ++k) unit[(first + k) * width + k] = 1.0;
                apply(j, units.at, image.at, true);
                for (int64_t k = 0; k < count; ++k) unit[(first + k) * width + k] = 0.0;
                for (int64_t i = 0; i < size; ++i)
                    std::copy_n(reinterpret_cast<const double*>(image.at) + i * width, count,
                                blocks.data() + (j * size + i) * size + first);
            }
        }
        for (int64_t i = 0; i < s; ++i)
            for (int64_t j = 0; j < s; ++j)
                for (int64_t a = 0; a < size; ++a)
                    for (int64_t b = 0; b < size; ++b)
                        matrix[(i * size + a) * edge + j * size + b] =
                            fma(-weight(i, j), blocks[(j * size + a) * size + b], i == j && a == b ? 1.0 : 0.0);
        if (!factorize(matrix.data(), edge, pivots.data())) throw NotSolved();
        for (int64_t i = 0; i < s; ++i) mix(i, 0, s, base);
        substitute(matrix.data(), edge, pivots.data(), reinterpret_cast<double*>(y.at), width);
        for (int64_t row = 0; row < edge; ++row)
            for (int64_t b = 0; b < size; ++b) {
                const double entry = blocks[row * size + b];
                if (entry == 0.0) continue;
                const V *from = y.at + (row / size * size + b) * copies;
                for (int64_t c = 0; c < copies; ++c)
                    z.at[row * copies + c] = fma(V(entry), from[c], z.at[row * copies + c]);
            }
    }

  private:
    const RungeKuttaTables& tables;
    const int64_t s, size, copies;
    const bool transposed;
    AlignedArray<V> y, z, before, units{0}, image{0};
    const std::vector<double> forecast;
    std::vector<double> matrix, pivots, blocks;  // of factors, if they were needed

    // Begin with the solution of the last step, continued, or with zero.
    void extrapolate(int64_t count) {
        if (tables.substeps > 1) return std::fill_n(z.at, count, V(0.0)), void();
        std::copy_n(z.at, count, before.at);
        const int64_t length = size * copies;
        for (int64_t i = 0; i < s; ++i)
            share(length, [&](int64_t low, int64_t high) {
                for (int64_t k = low; k < high; ++k) {
                    V total(0.0);
                    for (int64_t j = 0; j < s; ++j)
                        total = fma(V(forecast[i * s + j]), before.at[j * length + k], total);
                    z.at[i * length + k] = total;
                }
            });
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
                share(size * copies, [&](int64_t low, int64_t high) {
                    for (int64_t k = low; k < high; ++k) to[k] = fma(V(by), slope_of(j)[k], to[k]);
                });
    }

    template <class Base, class Apply>
    void one_by_one(Base base, Apply apply) {
        for (int64_t position = 0; position < s; ++position) {
            const int64_t j = transposed ? s - 1 - position : position;
            transposed ? mix(j, j + 1, s, base) : mix(j, 0, j, base);
            apply(j, of_stage(j), slope_of(j), false);
        }
    }
};

}  // namespace coadjoint
