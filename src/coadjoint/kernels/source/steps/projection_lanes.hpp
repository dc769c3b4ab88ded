// Projection of many members to the level sets of their invariants, with the operations of `projection.hpp`: the same
// bits.
#pragma once

#include <memory>
#include <type_traits>

#include "numbers/constants.hpp"
#include "steps/projection.hpp"

namespace coadjoint {

// Few invariants have lanes, with coefficients of their own. For others each member is projected alone.
template <int W, class A>
class ProjectionLanes {
  public:
    typedef Lanes<W> Row;
    typedef typename Numbers<A>::Mask Mask;
    static constexpr int lanes = Numbers<A>::lanes;
    A corrections{0.0}, residual{0.0};

    template <class C>
    ProjectionLanes(const Watch& watch, const C& constants, int64_t n)
        : n(n), size(watch.size), targets(2 * size), slopes(size * n), unused(n), row(blocks_of<W>(n)),
          remainder(blocks_of<W>(n)), numbers(2 * size) {
        bool few = size <= 4 && n <= W;
        invariants.reserve(few ? size : 0);
        for (int64_t i = size; few && i-- > 0;) few = add(InvariantGradient<A>(watch, constants, i));
        if (few) return;
        invariants.clear();
        for (int lane = 0; lane < (std::is_same_v<C, MemberConstants> ? 1 : lanes); ++lane)
            alone.push_back(std::make_unique<Projection<W, MemberConstants>>(watch, constants.of_lane(lane), n));
    }

    // Load and store the memory of a member.
    void read(int lane, const double* memory) {
        for (int64_t a = 0; a < 2 * size; ++a) set_lane(targets.at[a], lane, memory[a]);
    }
    void write(int lane, double* memory) const {
        for (int64_t a = 0; a < 2 * size; ++a) memory[a] = lane_of(targets.at[a], lane);
    }

    // The target values of active members without a memory.
    void begin(const A* x, const Mask& active) {
        if (size == 0) return;
        const Mask fresh = active & !(targets.at[0] == targets.at[0]);
        if (!any(fresh)) return;
        for (int lane = 0; lane < lanes && !alone.empty(); ++lane) {
            if (!at(fresh, lane)) continue;
            take_row(lane, x, row.at);
            of(lane).begin(row.at, numbers.data());
            read(lane, numbers.data());
        }
        for (size_t a = 0; a < invariants.size(); ++a) {
            targets.at[a] = select(fresh, value(a, x), targets.at[a]);
            targets.at[size + a] = select(fresh, A(EXACT) * terms_of(a, x), targets.at[size + a]);
        }
    }

    // Move x + dx of the active members; false without convergence.
    Mask restore(A* x, A* dx, const Mask& active) {
        corrections = residual = A(0.0);
        if (size == 0) return active;
        if (alone.empty()) {
            if (size == 1) return restore_few<1>(x, dx, active);
            if (size == 2) return restore_few<2>(x, dx, active);
            if (size == 3) return restore_few<3>(x, dx, active);
            return restore_few<4>(x, dx, active);
        }
        A restored(0.0);
        for (int lane = 0; lane < lanes; ++lane) {
            if (!at(active, lane)) continue;
            auto& one = of(lane);
            take_row(lane, x, row.at), take_row(lane, dx, remainder.at);
            write(lane, numbers.data());
            set_lane(restored, lane, one.restore(row.at, remainder.at, blocks_of<W>(n), numbers.data()));
            read(lane, numbers.data());
            set_lane(corrections, lane, double(one.corrections)), set_lane(residual, lane, one.residual);
            for (int64_t i = 0; i < n; ++i) {
                set_lane(x[i], lane, reinterpret_cast<const double*>(row.at)[i]);
                set_lane(dx[i], lane, reinterpret_cast<const double*>(remainder.at)[i]);
            }
        }
        return restored == A(1.0);
    }

  private:
    // As `InvariantRows`: the components of the gradient have `length` entries each, from `first` on, of which the first
    // is the coordinate itself if it is `diagonal`; `curvature` bounds the second derivatives.
    struct Invariant {
        A constant, curvature;
        int64_t first, length, diagonal;
        std::map<size_t, Stored<A>> further{};  // as `second_derivatives` there, beside `curvature`
    };
    const int64_t n, size;
    std::vector<Invariant> invariants;
    ProductRows<W, A> products;
    std::vector<Stored<A>> offsets, weights;
    std::vector<int64_t> lefts;
    std::vector<std::unique_ptr<Projection<W, MemberConstants>>> alone;  // of every member, or of all; none for few
    AlignedArray<A> targets, slopes, unused;
    AlignedArray<Row> row, remainder;
    std::vector<double> numbers;

    Projection<W, MemberConstants>& of(int lane) { return *alone[alone.size() == 1 ? 0 : lane]; }

    // Add an invariant; false if a product has too many factors, or if the members have other rows.
    bool add(InvariantGradient<A>&& gradient) {
        if (!gradient.terms.empty()) return false;
        bool diagonal;
        const auto block = gradient.template block<W>(0, diagonal);
        invariants.push_back({gradient.constant, A(0.0), int64_t(weights.size()), int64_t(block[0].size()), diagonal});
        Invariant& last = invariants.back();
        std::vector<typename ProductRows<W, A>::Sum> longer(W);
        for (int64_t c = 0; c < n; ++c) {
            offsets.push_back(gradient.offset_of(c));
            for (const auto& entry : block[c]) weights.push_back(entry.weight), lefts.push_back(entry.left);
            last.curvature = larger(last.curvature, sum_of_sizes(block[c]));
            if (!gradient.products.empty()) longer[c].swap(gradient.products[c]);
            for (const auto& [factors, some] : longer[c]) {
                A all(0.0);
                for (const auto& [product, weight] : some) all = all + A(double(factors)) * absolute(A(weight));
                Stored<A>& bound = last.further[factors - 1];
                bound = larger(A(bound), all);
            }
        }
        products.add(longer, 0);
        return products.alike;
    }

    // Beyond the last coordinate there are zeros, and no data of the previous member.
    void take_row(int lane, const A* from, Row* to) const {
        double* const numbers = reinterpret_cast<double*>(to);
        for (int64_t i = 0; i < n; ++i) numbers[i] = lane_of(from[i], lane);
        std::fill(numbers + n, numbers + blocks_of<W>(n) * W, 0.0);
    }

    // As `sum_of_lanes` of a row of W with n entries.
    template <class Term>
    INLINE A sum(Term term) const {
        auto padded = [&](int64_t i) { return i < n ? term(i) : A(0.0); };
        if constexpr (W == 4) return (padded(0) + padded(2)) + (padded(1) + padded(3));
        const A p = padded(0) + padded(4), q = padded(1) + padded(5), r = padded(2) + padded(6), s = padded(3) + padded(7);
        return (p + r) + (q + s);
    }

    template <int R>
    NOINLINE Mask restore_few(A* x, A* dx, const Mask& active) {
        A defect[R], L[R][R], inverse[R];
        Mask done = active & evaluate_defects<R>(x, slopes.at, defect, residual, active), running = active & !done;
        if (!any(running)) return done;
        for (int i = 0; i < R; ++i)
            for (int j = 0; j <= i; ++j)
                L[i][j] = sum([&](int64_t c) { return slopes.at[i * n + c] * slopes.at[j * n + c]; });
        for (int j = 0; j < R; ++j) {
            const A square = L[j][j];
            for (int k = 0; k < j; ++k) L[j][j] = fma(-L[j][k] * L[j][k], inverse[k], L[j][j]);
            inverse[j] = select(L[j][j] > A(DEPENDENT) * square, A(1.0) / L[j][j], A(0.0));
            for (int i = j + 1; i < R; ++i)
                for (int k = 0; k < j; ++k) L[i][j] = fma(-L[i][k] * L[j][k], inverse[k], L[i][j]);
        }
        A total[W], bound[R], largest(0.0);
        for (int64_t c = 0; c < n; ++c) total[c] = A(0.0), largest = larger(largest, absolute(x[c]));
        for (int a = 0; a < R; ++a) {
            bound[a] = invariants[a].curvature;
            for (const auto& [exponent, factor] : invariants[a].further)
                bound[a] = bound[a] + A(factor) * power(largest, uint32_t(exponent));
            bound[a] = select(inverse[a] == A(0.0), A(INFINITY), bound[a]);  // as in `Projection`
        }
        for (int64_t round = 1; round <= PROJECTION_CORRECTIONS; ++round) {
            const A before = residual;
            corrections = select(running, A(double(round)), corrections);
            running = running & (before - before == A(0.0));
            if (!any(running)) return done;
            for (int j = 0; j < R; ++j) {
                for (int k = 0; k < j; ++k) defect[j] = fma(-L[j][k], defect[k], defect[j]);
                defect[j] = defect[j] * inverse[j];
            }
            for (int j = R - 1; j >= 0; --j)
                for (int k = j + 1; k < R; ++k) defect[j] = fma(-L[k][j] * inverse[j], defect[k], defect[j]);
            A moved[W];
            for (int64_t c = 0; c < n; ++c) {
                A more(0.0);
                for (int i = 0; i < R; ++i) more = fma(defect[i], slopes.at[i * n + c], more);
                A now = x[c], rest = dx[c];
                add_to(now, rest, more);
                x[c] = select(running, now, x[c]), dx[c] = select(running, rest, dx[c]);
                total[c] = total[c] + more;
                moved[c] = absolute(more);
            }
            const A product = sum([&](int64_t c) { return moved[c]; }) * sum([&](int64_t c) { return absolute(total[c]); });
            Mask found = running;
            for (int64_t a = 0; a < R; ++a)
                found = found & (product * bound[a] <= A(0.25) * targets.at[R + a]);
            done = done | found, running = running & !found;
            if (!any(running)) return done;
            A now(0.0);
            found = running & evaluate_defects<R>(x, nullptr, defect, now, running);
            residual = select(running, now, residual);
            const Mask slow = running & !found & (residual >= A(0.5) * before);
            if (any(slow)) found = found | (slow & settled(x));
            done = done | found, running = running & !found;
            if (!any(running)) return done;
        }
        corrections = select(running, A(double(PROJECTION_CORRECTIONS + 1)), corrections);
        return done;
    }

    // As `Projection::settled`.
    NOINLINE Mask settled(const A* x) const {
        Mask all = x[0] == x[0];
        for (int64_t a = 0; a < size; ++a)
            all = all & (absolute(targets.at[a] - value(a, x)) <= A(double(PROJECTION_STAGNANT) * EXACT) * terms_of(a, x));
        return all;
    }

    // The defects, and whether they are within rounding; the gradients, if there is memory for them.
    template <int R>
    INLINE Mask evaluate_defects(const A* x, A* gradients, A* defect, A& total, const Mask& active) {
        Mask every = active;
        total = A(0.0);
        for (int i = 0; i < R; ++i) {
            A* const slope = gradients ? gradients + i * n : unused.at;
            A whole[W];
            take_slopes(i, x, slope, whole);
            defect[i] = targets.at[i] -
                        (invariants[i].constant + A(0.5) * sum([&](int64_t c) { return x[c] * whole[c]; }));
            every = every & rounding_alone(i, defect[i], x, targets.at[R + i], active);
            total = total + absolute(defect[i]);
        }
        return every;
    }

    // As `InvariantRows::slope`, for all coordinates.
    INLINE void take_slopes(int64_t i, const A* x, A* slope, A* whole) const {
        for (int64_t c = 0; c < n; ++c) {
            slope[c] = slope_of(i, c, x);
            whole[c] = slope[c] + A(offsets[i * n + c]);
        }
        for (int64_t s = products.first[i]; s < products.first[i + 1]; ++s)
            products.add_sums(products.segments[s], n, x, slope, whole);
    }

    // The same without products of several coordinates, for one coordinate.
    INLINE A slope_of(int64_t i, int64_t c, const A* x) const {
        const Invariant& one = invariants[i];
        const Stored<A>* const weight = weights.data() + one.first + c * one.length;
        const int64_t* const left = lefts.data() + one.first + c * one.length;
        A total = offsets[i * n + c];
        int64_t e = 0;
        for (; e < one.diagonal; ++e) total = fma(A(weight[e]), x[c], total);
        for (; e < one.length; ++e) total = fma(A(weight[e]), x[left[e]], total);
        return total;
    }

    // As `InvariantRows::value`.
    NOINLINE A value(int64_t i, const A* x) const {
        A slope[W], whole[W];
        take_slopes(i, x, slope, whole);
        return invariants[i].constant + A(0.5) * sum([&](int64_t c) { return fma(x[c], whole[c], A(0.0)); });
    }

    // As `InvariantRows::terms_of`.
    NOINLINE A terms_of(int64_t i, const A* x) const {
        const Invariant& one = invariants[i];
        return sum([&](int64_t c) {
            A rising = absolute(A(offsets[i * n + c]));
            for (int64_t e = one.first + c * one.length; e < one.first + (c + 1) * one.length; ++e)
                rising = fma(absolute(A(weights[e])), absolute(x[lefts[e]]), rising);
            for (int64_t s = products.first[i]; s < products.first[i + 1]; ++s)
                rising = rising + products.sizes_in_row(products.segments[s], int(c), x);
            return absolute(x[c]) * rising;
        });
    }

    INLINE Mask rounding_alone(int64_t a, const A& defect, const A* x, A& least, const Mask& active) {
        const A size_of = absolute(defect);
        const Mask small = size_of <= least, near = active & !small & (size_of <= A(0x1p4) * least);
        if (__builtin_expect(!any(near), 1)) return small;
        least = select(near, larger(least, A(EXACT) * terms_of(a, x)), least);
        return size_of <= least;
    }
};

}  // namespace coadjoint
