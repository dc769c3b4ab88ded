// Small systems with a quadratic energy: the equations of the derivatives of the stages, solved in registers.
#pragma once

#include "tangents/stage_equations.hpp"

namespace coadjoint {

constexpr int64_t LARGEST_DENSE_STAGE = 8;  // coordinates up to which the Jacobian of a stage is stored
constexpr int MOST_STAGES = 8;              // stages side by side
constexpr int64_t FAST = 4;                 // untested iterations up to which two steps are continued, else one

// The Jacobians h_j f'(X_j) with the stages as lanes: f' is an affine function of the state, whose coefficients are found
// from its values at the unit vectors. Lanes beyond the last stage are zero.
class StageJacobians {
  public:
    typedef Lanes<MOST_STAGES> S;
    const bool used;

    StageJacobians(StagePoints& at, bool transposed, bool wanted)
        : used(wanted && suitable(at)), at(at), n(at.n), s(at.s), jacobians(used ? n * n : 0), scales(1), mixed(s), weights(s), outs(1),
          continued(3 * s), exact(at.tables.solver == EXPLICIT ? (transposed ? s : 1) : 0), untested(exact) {
        if (!used) return;
        find_coefficients();
        const RungeKuttaTables& tables = at.tables;
        const std::vector<double> one = forecast_of(tables, transposed, 1), two = forecast_of(tables, transposed, 2);
        for (int lane = 0; lane < s; ++lane) {
            set_lane(scales.at[0], lane, tables.scale[lane]);
            set_lane(outs.at[0], lane, tables.out[lane]);
            for (int64_t j = 0; j < s; ++j) {
                set_lane(mixed.at[j], lane, tables.mix[lane * s + j]);
                set_lane(weights.at[j], lane, tables.mix[transposed ? j * s + lane : lane * s + j]);
                if (exact > 0) continue;
                set_lane(continued.at[j], lane, one[lane * s + j]);
                set_lane(continued.at[s + j], lane, two[lane * 2 * s + j]);
                set_lane(continued.at[2 * s + j], lane, two[lane * 2 * s + s + j]);
            }
        }
    }

    // The next step does not follow the last one.
    void restart() {
        std::fill_n(&solution[0][0][0], sizeof(solution) / sizeof(double), 0.0);
        untested = exact;
    }

    // The Jacobians of the substep at which the points are.
    void set() {
        for (int64_t c = 0; c < n; ++c) {
            S total(0.0);
            for (int64_t j = 0; j < s; ++j) total = fma(mixed.at[j], S(at.start_slopes[j * n + c]), total);
            points[c] = S(at.start[c]) + total;
        }
        lengths = S(at.length_of_step()) * scales.at[0];
        for (size_t entry = 0; entry < constants.size(); ++entry) {
            S total(constants[entry]);
            for (uint32_t q = first[entry]; q < first[entry + 1]; ++q)
                total = fma(S(coefficients[q]), points[coordinate[q]], total);
            jacobians.at[position[entry]] = lengths * total;
        }
    }

    // z = the Jacobian of stage j, or its transpose, times y, for vectors side by side.
    template <bool transposed, class V>
    INLINE void multiply(int64_t j, const V* y, V* z, int64_t rows) const {
        for (int64_t b = 0; b < rows; ++b)
            for (int64_t i = 0; i < n; ++i) {
                V total(0.0);
                for (int64_t k = 0; k < n; ++k)
                    total = fma(V(number(transposed ? k * n + i : i * n + k, j)), y[k * rows + b], total);
                z[i * rows + b] = total;
            }
    }

    // Replace cotangents after the substep by those before it, and add those of the coefficients of the linear terms
    // `added` to `of_coefficients`, stage by stage. False if the iteration does not converge; then nothing has changed.
    bool pull(double* cotangents, const Terms& added, S* of_coefficients) {
        S y[LARGEST_DENSE_STAGE], z[LARGEST_DENSE_STAGE];
        const auto solve = [&](auto size) __attribute__((always_inline)) {
            return solve_transposed(size, cotangents, y, z);
        };
        if (!of_size(solve)) return false;
        for (int64_t c = 0; c < n; ++c)
            for (int j = 0; j < s; ++j) cotangents[c] += lane_of(z[c], j);
        if (added.size == 0) return true;
        const Field& field = at.field;
        S w[LARGEST_DENSE_STAGE];
        std::fill_n(w, n, S(0.0));
        for (int64_t i = 0; i < n; ++i)
            for (uint32_t e = field.first[i]; e < field.first[i + 1]; ++e) {
                S& entry = w[field.column[e]];
                entry = fma(S(field.constant[e]) * points[field.state[e]], y[i], entry);
            }
        S* of_weight = of_coefficients + added.row[1];
        for (uint32_t row = 0, entry = 0; row < added.row[1]; ++row) {
            const S of_row = lengths * w[added.target[row]];
            of_coefficients[row] += of_row;
            for (const uint32_t stop = added.entry[row + 1]; entry < stop; ++entry)
                of_weight[entry] = fma(of_row, points[added.column[entry]], of_weight[entry]);
        }
        return true;
    }

    // Solve y_i = v + sum_j mix_ij z_j, z_j = the Jacobian of stage j times y_j, for `rows` vectors v side by side, and add
    // sum_j out_j z_j to them. `further`, unless null, is added to the z_j: component c of stage j is at (j n + c) rows.
    // `found` are the z of the last two substeps, for each vector those of the last one, and of the one before. False if the iteration does not
    // converge; then nothing has changed.
    template <class V>
    bool push(V* vectors, const V* further, int64_t rows, V* found) {
        for (int64_t b = 0; b < rows; ++b) {
            V* z = found + 2 * b * s * n;
            const auto solve = [&](auto size) __attribute__((always_inline)) {
                return solve_along(size, vectors + b, further ? further + b : nullptr, rows, z);
            };
            if (!of_size(solve)) return false;
        }
        for (int64_t b = 0; b < rows; ++b)
            for (int64_t j = 0; j < s; ++j)
                for (int64_t c = 0; c < n; ++c)
                    vectors[c * rows + b] = fma(V(at.tables.out[j]), found[(2 * b * s + j) * n + c], vectors[c * rows + b]);
        return true;
    }

  private:
    StagePoints& at;
    const int64_t n, s;
    // The entries of f' that are not zero: constants, and coefficients of coordinates.
    std::vector<double> constants, coefficients;
    std::vector<uint32_t> position, first, coordinate;
    AlignedArray<S> jacobians, scales, mixed, weights, outs, continued;
    S points[LARGEST_DENSE_STAGE], lengths;
    alignas(64) double solution[2][LARGEST_DENSE_STAGE][MOST_STAGES] = {};  // z of the last substep, and of the one before
    const int64_t exact;  // iterations that solve the equations of explicit methods, else zero
    int64_t untested;      // iterations that the last substep needed before the last two

    double number(int64_t entry, int64_t j) const { return reinterpret_cast<const double*>(jacobians.at + entry)[j]; }

    static bool suitable(const StagePoints& at) {
        const Terms& terms = at.field.terms;
        bool linear = at.n <= LARGEST_DENSE_STAGE && at.s <= MOST_STAGES && !at.field.nonlinear &&
                      at.tables.solver <= IMPLICIT && !at.iterated;
        for (int64_t k = 0; k < terms.size; ++k) linear = linear && terms.kind[k] == LINEAR;
        return linear;
    }

    void find_coefficients() {
        const Terms& terms = at.field.terms;
        AlignedArray<double> hessian(n * n), product(n * n), point(n), u(n), dense((n + 1) * n * n);
        for (uint32_t row = 0; row < terms.row[terms.size]; ++row)
            for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                hessian.at[terms.target[row] * n + terms.column[entry]] += terms.weight[entry];
        for (int64_t k = 0; k <= n; ++k) {
            if (k > 0) point.at[k - 1] = 1.0;
            gradient(at.field, SharedConstants{}, point.at, 0.0, u.at, at.fields);
            double* here = dense.at + k * n * n;
            coadjoint_matrix(at.field, SharedConstants{}, u.at, 1.0, here);
            structure_times_matrix(at.field, SharedConstants{}, point.at, hessian.at, 1.0, product.at, at.fields);
            for (int64_t e = 0; e < n * n; ++e) here[e] += product.at[e] - (k > 0 ? dense.at[e] : 0.0);
            if (k > 0) point.at[k - 1] = 0.0;
        }
        first.push_back(0);
        for (int64_t e = 0; e < n * n; ++e) {
            for (int64_t k = 1; k <= n; ++k)
                if (const double coefficient = dense.at[k * n * n + e])
                    coefficients.push_back(coefficient), coordinate.push_back(uint32_t(k - 1));
            if (dense.at[e] == 0.0 && coefficients.size() == first.back()) continue;
            constants.push_back(dense.at[e]);
            position.push_back(uint32_t(e));
            first.push_back(uint32_t(coefficients.size()));
        }
    }

    // Call `solve(size)`; loops of known length are unrolled.
    template <class Solve>
    INLINE bool of_size(const Solve& solve) {
        if (n == 3) return solve(std::integral_constant<int64_t, 3>());
        if (n == 6) return solve(std::integral_constant<int64_t, 6>());
        return solve(n);
    }

    // Call `pass(measured, change, largest)` until nothing changes; the first passes are untested and not `measured`. False
    // if the iteration does not converge.
    template <class V, class Pass>
    INLINE bool iterate(const Pass& pass) {
        double earlier = 0.0;
        for (int64_t passed = 0; passed < MOST_DERIVATIVE_ITERATIONS; ++passed) {
            V change_of(0.0), largest_of(0.0);
            pass(passed >= untested, change_of, largest_of);
            if (passed + 1 == exact) return true;
            if (passed < untested) continue;
            const double change = largest_lane(change_of), largest = largest_lane(largest_of);
            if (!(largest - largest == 0.0)) break;
            if (converged(change, earlier, largest)) return untested = std::max<int64_t>(0, passed - 1), true;
            earlier = change;
        }
        return false;
    }

    // y_j = out_j cotangents + sum_i mix_ij z_i, z_j = the transposed Jacobian times y_j: all stages at once.
    template <class Size>
    INLINE bool solve_transposed(Size size, const double* cotangents, S* y, S* z) {
        S base[LARGEST_DENSE_STAGE];
        const auto mix = [&](const S* by, int step, S* to) __attribute__((always_inline)) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < size; ++c) to[c] = fma(by[i], S(solution[step][c][i]), to[c]);
        };
        const auto keep = [&] { for (int64_t c = 0; c < size; ++c) store(solution[0][c], z[c]); };
        for (int64_t c = 0; c < size; ++c) base[c] = outs.at[0] * S(cotangents[c]), z[c] = S(0.0);
        const bool both = untested <= FAST;
        mix(continued.at + (both ? s : 0), 0, z);
        if (both) mix(continued.at + 2 * s, 1, z);
        for (int64_t c = 0; c < size; ++c) std::copy_n(solution[0][c], MOST_STAGES, solution[1][c]);
        keep();
        const bool solved = iterate<S>([&](bool measured, S& change_of, S& largest_of) __attribute__((always_inline)) {
            for (int64_t c = 0; c < size; ++c) y[c] = base[c];
            mix(weights.at, 0, y);
            for (int64_t c = 0; c < size; ++c) {
                S total(0.0);
                for (int64_t k = 0; k < size; ++k) total = fma(jacobians.at[k * size + c], y[k], total);
                if (measured) {
                    change_of = change_of + absolute(total - z[c]);
                    largest_of = largest_of + absolute(total);
                }
                z[c] = total;
            }
            keep();
        });
        return solved || (restart(), false);
    }

    // For one vector, whose components are at a distance of `rows`: each stage with the latest slopes.
    template <class Size, class V>
    INLINE bool solve_along(Size size, const V* vector, const V* further, int64_t rows, V* z) {
        V y[LARGEST_DENSE_STAGE], before[2 * MOST_STAGES * LARGEST_DENSE_STAGE];
        std::copy_n(z, 2 * s * size, before);
        std::copy_n(z, s * size, z + s * size);
        const bool both = untested <= FAST;
        for (int64_t i = 0; i < s; ++i) {
            for (int64_t c = 0; c < size; ++c) y[c] = V(0.0);
            for (int64_t j = 0; j < (both ? 2 * s : s); ++j) {
                const V by(lane(continued, both ? s + j : j, i));
                for (int64_t c = 0; c < size; ++c) y[c] = fma(by, before[j * size + c], y[c]);
            }
            for (int64_t c = 0; c < size; ++c) z[i * size + c] = y[c];
        }
        const bool solved = iterate<V>([&](bool measured, V& change_of, V& largest_of) __attribute__((always_inline)) {
            for (int64_t j = 0; j < s; ++j) {
                for (int64_t c = 0; c < size; ++c) y[c] = vector[c * rows];
                for (int64_t i = 0; i < s; ++i) {
                    const V by(lane(weights, i, j));
                    for (int64_t c = 0; c < size; ++c) y[c] = fma(by, z[i * size + c], y[c]);
                }
                for (int64_t c = 0; c < size; ++c) {
                    V total = further ? further[(j * size + c) * rows] : V(0.0);
                    for (int64_t k = 0; k < size; ++k) total = fma(V(number(c * size + k, j)), y[k], total);
                    if (measured) {
                        change_of = change_of + absolute(total - z[j * size + c]);
                        largest_of = largest_of + absolute(total);
                    }
                    z[j * size + c] = total;
                }
            }
        });
        if (!solved) std::fill_n(z, 2 * s * size, V(0.0)), untested = exact;
        return solved;
    }

    double lane(const AlignedArray<S>& from, int64_t position, int64_t j) const {
        return reinterpret_cast<const double*>(from.at + position)[j];
    }

};

}  // namespace coadjoint
