// Blocks of several coordinates given by the entries of D: CUBIC ones by a closed form, others by a series.
#pragma once

#include <algorithm>
#include <vector>

#include "flows/blocks.hpp"
#include "boundary/interrupts.hpp"

namespace coadjoint {

constexpr int64_t OVERFLOW_CHECK_INTERVAL = 64;  // substeps between checks for blocks that have overflowed

// A CUBIC or SERIES block: its coordinates and the compressed sparse rows of D in them.
struct BlockRows {
    const uint32_t *coordinates, *starts, *columns;
    uint32_t width;
    int64_t constant, entries;

    INLINE BlockRows(const Action& action, uint32_t run)
        : coordinates(action.indices + action.position[run]), starts(coordinates + action.width[run]),
          columns(starts + action.width[run] + 1), width(action.width[run]), constant(action.constant[run]),
          entries(action.entries[run]) {}
};

// target = factor D source in the coordinates of the block (the operation `apply`).
template <class A, class V, class C>
INLINE void apply_block(const Action& action, const C& constants, const BlockRows& block, int64_t values,
                        const V* source, const A& factor, V* target, int64_t rows) {
    for (uint32_t k = 0; k < block.width; ++k) {
        for (int64_t row = 0; row < rows; ++row) {
            V total(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V value(constants.template number_at<A>(action.constants, values + entry));
                total = fma(value, source[block.columns[entry] * rows + row], total);
            }
            target[k * rows + row] = V(factor) * total;
        }
    }
}

template <class V>
INLINE void gather(const BlockRows& block, const Vectors<V>& x) {
    for (uint32_t k = 0; k < block.width; ++k)
        for (int64_t row = 0; row < x.rows; ++row)
            x.workspace[k * x.rows + row] = x.at[block.coordinates[k] * x.rows + row];
}

// Sine and cosine minus one of root * theta for lam < 0, their hyperbolic counterparts otherwise.
template <class A>
INLINE Rotation<A> cubic_rotation(const A& lam, const A& phi) {
    auto circular = lam < A(0.0);
    if (all(circular)) return rotation_by(phi);
    Rotation<A> hyperbolic = hyperbolic_rotation(phi);
    if (!any(circular)) return hyperbolic;
    Rotation<A> rotation = rotation_by(phi);
    return {select(circular, rotation.sine, hyperbolic.sine), select(circular, rotation.cosm1, hyperbolic.cosm1)};
}

// D^3 = lam D: exp(theta D) = 1 + S D + C D^2, Rodrigues' formula for lam < 0 and its hyperbolic counterpart for lam >
// 0.
template <class A>
struct CubicFactors {
    A lam, s, c;

    template <class C>
    INLINE CubicFactors(const Action& action, const C& constants, uint32_t run, const A& theta) {
        const int64_t base = action.constant[run];
        lam = constants.template number_at<A>(action.constants, base);
        const A phi = constants.template number_at<A>(action.constants, base + 1) * theta;
        scale(action, constants, base,
              action.kind[run] == RATIONAL_CUBIC ? rational_rotation(phi) : cubic_rotation(lam, phi));
    }

    // The factors of a circular rotation whose sine is known.
    template <class C>
    INLINE CubicFactors(const Action& action, const C& constants, uint32_t run, const Rotation<A>& rotation)
        : lam(constants.template number_at<A>(action.constants, action.constant[run])) {
        scale(action, constants, action.constant[run], rotation);
    }

  private:
    template <class C>
    INLINE void scale(const Action& action, const C& constants, int64_t base, const Rotation<A>& rotation) {
        auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, base + position); };
        // The rounding error of the constants is added, since it would stretch every step in the same way.
        s = fma(rotation.sine, constant(2), rotation.sine * constant(3));
        c = fma(rotation.cosm1, constant(4), rotation.cosm1 * constant(5));
    }
};

template <Summation summation, class A, class V, class C>
INLINE void cubic_by(const Action& action, const C& constants, uint32_t run, const CubicFactors<A>& factors,
                     const Vectors<V>& x) {
    const BlockRows block(action, run);
    const int64_t values = block.constant + CUBIC_HEADER, squares = values + block.entries,
                  rests = squares + block.entries;
    auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, position); };
    const int64_t length = block.width * x.rows;
    const V along(factors.s), across(factors.c);
    if constexpr (summation == CORRECTED) {
        // D (D x) and not D^2 x: the rounding of the entries of D^2 has a systematic sign.
        apply_block(action, constants, block, values, x.workspace, A(1.0), x.workspace + length, x.rows);
        apply_block(action, constants, block, values, x.workspace + length, A(1.0), x.workspace + 2 * length, x.rows);
        const V deficit(shortfall(factors.s, factors.c, -factors.lam));
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V first = x.workspace[length + k * x.rows + row], second = x.workspace[2 * length + k * x.rows + row];
                add_compensated(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second),
                                x.errors[i + row], deficit * second);
            }
        }
        return;
    }
    // Rows of D and D^2 are summed in registers, during the latency of the sine.
    for (uint32_t k = 0; k < block.width; ++k) {
        int64_t i = block.coordinates[k] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V first(0.0), second(0.0), rest(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V v = x.workspace[block.columns[entry] * x.rows + row];
                first = fma(V(constant(values + entry)), v, first);
                second = fma(V(constant(squares + entry)), v, second);
                rest = fma(V(constant(rests + entry)), v, rest);
            }
            second += rest;
            add<summation>(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second));
        }
    }
}

// The same for one vector and a block of three coordinates with all nine entries, without indices.
template <Summation summation, class C>
INLINE void cubic_triple(const Action& action, const C& constants, const BlockRows& block,
                         const CubicFactors<double>& factors, double* x, double* errors) {
    const int64_t values = block.constant + CUBIC_HEADER;
    auto constant = [&](int64_t position) {
        return constants.template number_at<double>(action.constants, values + position);
    };
    const uint32_t* coordinates = block.coordinates;
    const double old[3] = {x[coordinates[0]], x[coordinates[1]], x[coordinates[2]]};
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
        double first = 0.0, second = 0.0, rest = 0.0;
#pragma GCC unroll 3
        for (int j = 0; j < 3; ++j) {
            first = fma(constant(3 * k + j), old[j], first);
            second = fma(constant(9 + 3 * k + j), old[j], second);
            rest = fma(constant(18 + 3 * k + j), old[j], rest);
        }
        second += rest;
        add<summation>(x, errors, coordinates[k], old[k], fma(factors.s, first, factors.c * second));
    }
}

template <Summation summation, class A, class V, class C>
INLINE void cubic(const Action& action, const C& constants, uint32_t run, const A& theta, const Vectors<V>& x) {
    gather(BlockRows(action, run), x);
    cubic_by<summation>(action, constants, run, CubicFactors<A>(action, constants, run, theta), x);
}

// Up to the norm r = REACH[m - 1] the series is truncated after the degree m. There r^m / (m + 1)! is below 2^-65. It
// must be so small, since the truncation error has one sign and adds up over the steps.
constexpr double REACH[] = {5.42e-20, 4.03e-10, 8.66e-07, 4.24e-05, 0.000455, 0.00227, 0.00728, 0.0177, 0.0358,
                            0.0635, 0.102, 0.153, 0.217, 0.293, 0.383, 0.485, 0.6, 0.727,
                            0.866, 1.02};

INLINE uint32_t degree_of(double r, uint32_t most) {
    uint32_t degree = 1;
    while (degree < most && r > REACH[degree - 1]) ++degree;
    return degree;
}

// Whether all coordinates of a block are finite, for each lane of members separately.
template <class A, class V>
INLINE auto finite_block(const BlockRows& block, const Vectors<V>& x) {
    V total(0.0);
    for (uint32_t k = 0; k < block.width; ++k)
        for (int64_t row = 0; row < x.rows; ++row) total = total + 0.0 * x.at[block.coordinates[k] * x.rows + row];
    if constexpr (Numbers<A>::lanes == 1)
        return all(total == V(0.0));
    else
        return total == V(0.0);
}

// exp(theta D) - 1 of one block as a matrix, by a series and repeated squares: for flows of so many substeps that these
// take longer.
class DenseExponential {
  public:
    // Whether `substeps` of the series take longer, for the `rows` of a group element or one vector. Few never do.
    static bool is_faster(double substeps, const BlockRows& block, bool rows) {
        if (!(substeps > (rows ? FEW_SUBSTEPS_OF_ROWS : FEW_SUBSTEPS))) return false;
        const double width = double(block.width), entries = double(block.entries), vectors = rows ? width : 1.0;
        double squares = 1.0;
        for (double reach = substeps; reach > 1.0; reach *= 0.5) squares += 1.0;
        return DENSE_DEGREE * entries * width + squares * width * width * width <
               substeps * DENSE_DEGREE * (entries + width) * vectors;
    }

    // `values` are those of D.
    NOINLINE DenseExponential(const BlockRows& block, const double* values, double theta, double norm)
        : size(block.width), increment(size * size, 0.0), other(size * size) {
        int64_t halvings = 0;
        for (double reach = absolute(theta) * norm; reach > 1.0; reach *= 0.5, theta *= 0.5) ++halvings;
        InterruptCheck& interrupts = InterruptCheck::of_this_call();
        interrupts.after(int64_t(DENSE_DEGREE) * block.entries * size);
        for (int64_t k = int64_t(DENSE_DEGREE); k > 0; --k) {
            // In Horner's order: increment <- (theta / k) D (1 + increment).
            for (int64_t i = 0; i < size; ++i) increment[i * size + i] += 1.0;
            std::fill(other.begin(), other.end(), 0.0);
            for (int64_t i = 0; i < size; ++i)
                for (uint32_t entry = block.starts[i]; entry < block.starts[i + 1]; ++entry)
                    add_row(values[entry] * (theta / double(k)), &increment[block.columns[entry] * size], &other[i * size]);
            increment.swap(other);
        }
        for (; halvings > 0; --halvings) {
            // (1 + increment)^2 - 1 = 2 increment + increment^2.
            interrupts.after(size * size * size);
            for (int64_t k = 0; k < size * size; ++k) other[k] = 2.0 * increment[k];
            for (int64_t i = 0; i < size; ++i)
                for (int64_t j = 0; j < size; ++j) add_row(increment[i * size + j], &increment[j * size], &other[i * size]);
            increment.swap(other);
        }
    }

    // Component i of the increment of the vector y, whose components are `stride` apart.
    template <class V>
    INLINE V times(int64_t i, const V* y, int64_t stride) const {
        V total(0.0);
        for (int64_t j = 0; j < size; ++j) total = fma(V(increment[i * size + j]), y[j * stride], total);
        return total;
    }

  private:
    // Numbers of substeps up to which no matrix is formed, and terms of a series of a substep, for the cost model.
    static constexpr double FEW_SUBSTEPS = 64.0, FEW_SUBSTEPS_OF_ROWS = 8.0, DENSE_DEGREE = 20.0;
    const int64_t size;
    std::vector<double> increment, other;

    void add_row(double factor, const double* from, double* to) const {
        for (int64_t j = 0; j < size; ++j) to[j] = fma(factor, from[j], to[j]);
    }
};

// Move one lane of vectors by the matrix of its exponential; all of them if a single angle moves them.
template <Summation summation, class A, class V>
NOINLINE void move_densely(const DenseExponential& exponential, const BlockRows& block, int lane, const Vectors<V>& x) {
    constexpr Summation limited = summation == PLAIN ? PLAIN : COMPENSATED;
    typedef std::conditional_t<Numbers<A>::lanes == 1, V, double> Moved;
    gather(block, x);
    std::vector<Moved> here(block.width);
    for (int64_t row = 0; row < x.rows; ++row) {
        for (uint32_t k = 0; k < block.width; ++k)
            if constexpr (Numbers<A>::lanes == 1)
                here[k] = x.workspace[k * x.rows + row];
            else
                here[k] = lane_of(x.workspace[k * x.rows + row], lane);
        for (uint32_t k = 0; k < block.width; ++k) {
            const int64_t position = block.coordinates[k] * x.rows + row;
            const Moved move = exponential.times(k, here.data(), 1);
            if constexpr (Numbers<A>::lanes == 1) {
                add<limited>(x.at, x.errors, position, here[k], move);
            } else {
                double after = here[k], error = summation == PLAIN ? 0.0 : lane_of(x.errors[position], lane);
                add<limited>(&after, &error, 0, here[k], move);
                set_lane(x.at[position], lane, after);
                if constexpr (summation != PLAIN) set_lane(x.errors[position], lane, error);
            }
        }
    }
}

// The sum of theta^k D^k / k!: finite if D is nilpotent, else in substeps of norm at most 1, or by repeated squares.
template <Summation summation, class A, class V, class C>
NOINLINE void series(const Action& action, const C& constants, uint32_t run, const A& theta, const Vectors<V>& x) {
    const BlockRows block(action, run);
    const int64_t length = block.width * x.rows;
    // The same for rows as lanes and for members as lanes.
    const bool of_group = summation == CORRECTED && (Numbers<V>::lanes > Numbers<A>::lanes || x.rows > 1);
    A step = theta, substeps(1.0), degrees(1.0);
    const A norm = constants.template number_at<A>(action.constants, block.constant);
    int64_t most = 0;
    uint32_t longest = 1;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        double needed = std::ceil(absolute(lane_of(theta, lane)) * lane_of(norm, lane));
        double lane_substeps = needed > 1.0 ? needed : 1.0;
        if (!(needed <= double(MOST_SUBSTEPS))) {
            // Near a blow-up the loop would not end; NaN stops it.
            if (x.too_long) x.too_long[lane] = 1;
            set_lane(step, lane, NAN);
            lane_substeps = 1.0;
        } else if (DenseExponential::is_faster(needed, block, of_group)) {
            std::vector<double> values(block.entries);
            for (int64_t entry = 0; entry < block.entries; ++entry)
                values[entry] =
                    lane_of(constants.template number_at<A>(action.constants, block.constant + 1 + entry), lane);
            move_densely<summation, A>(
                DenseExponential(block, values.data(), lane_of(theta, lane), lane_of(norm, lane)), block, lane, x);
            lane_substeps = 0.0;
        } else {
            const double reached = absolute(lane_of(theta, lane)) * lane_of(norm, lane) / lane_substeps;
            const uint32_t degree = reached > 0.0 ? degree_of(reached, action.degree[run]) : action.degree[run];
            set_lane(step, lane, lane_of(theta, lane) / lane_substeps);
            set_lane(degrees, lane, double(degree));
            longest = std::max(longest, degree);
        }
        set_lane(substeps, lane, lane_substeps);
        most = lane_substeps > double(most) ? int64_t(lane_substeps) : most;
    }
    InterruptCheck& interrupts = InterruptCheck::of_this_call();
    for (int64_t done = 0; done < most; ++done) {
        interrupts.after(longest * (block.entries + block.width) * x.rows * Numbers<V>::lanes);
        auto active = A(double(done)) < substeps;
        // In Horner's order. Added one by one, terms below half a unit in the last place would all be lost with the
        // same sign.
        gather(block, x);
        V *start = x.workspace, *inner = x.workspace + length, *total = x.workspace + 2 * length;
        std::copy_n(start, length, inner);
        for (uint32_t k = longest; k > 0; --k) {
            apply_block(action, constants, block, block.constant + 1, inner, step / double(k), total, x.rows);
            const auto begun = A(double(k)) <= degrees;
            for (int64_t position = 0; k > 1 && position < length; ++position) {
                inner[position] = start[position] + total[position];
                if constexpr (Numbers<A>::lanes > 1) inner[position] = select(begun, inner[position], start[position]);
            }
        }
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V before = x.at[i + row], error = summation == PLAIN ? before : x.errors[i + row];
                add<summation == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, before, total[k * x.rows + row]);
                if constexpr (Numbers<A>::lanes > 1) {
                    x.at[i + row] = select(active, x.at[i + row], before);
                    if constexpr (summation != PLAIN) x.errors[i + row] = select(active, x.errors[i + row], error);
                }
            }
        }
        if (done % OVERFLOW_CHECK_INTERVAL != OVERFLOW_CHECK_INTERVAL - 1) continue;
        // A NaN block remains NaN; the remaining substeps are skipped.
        substeps = select(finite_block<A>(block, x), substeps, A(0.0));
        if (!any(A(double(done)) < substeps)) return;
    }
}

}  // namespace coadjoint
