// Stopping criterion of fixed point iterations: E. Hairer, R. I. McLachlan, A. Razakarivony, Achieving Brouwer's law with
// implicit Runge-Kutta methods, BIT 48 (2008) 231-243. An iteration ends when its corrections no longer fall, at the level
// of round-off; a tolerance would leave an error that has a sign, and energies would drift. Here each component is watched
// by itself, since components differ in size, and for several iterations in a row, since corrections oscillate where
// eigenvalues are complex. Corrections that stop falling above the round-off of their component are tested once more from
// the start; then they are round-off of larger terms, as samples of disturbed points show, or have not converged.
#pragma once

#include <limits>
#include <type_traits>

#include "boundary/codes.hpp"
#include "numbers/arithmetic.hpp"
#include "boundary/interrupts.hpp"
#include "stages/stages.hpp"

namespace coadjoint {

constexpr int64_t FIRST_TEST = 3;  // early corrections may rise before they fall
constexpr int64_t MAX_ITERATIONS = 192;
constexpr double DIVERGENCE_FACTOR = power_of_two(GROWTH_BITS);  // corrections this much larger than the first diverge
constexpr int64_t TEST_INTERVAL = 16;     // iterations between two tests for slow convergence
constexpr double SLOWEST_RATE = 0x1p-6;   // a smaller fall since the last test would take more than MAX_ITERATIONS
constexpr double ROUND_OFF_LEVEL = 0x1p-32;  // of the size of the stages: only smaller corrections may be round-off
constexpr double SPREAD_OF_ROUND_OFF = 0x1p-16;  // of that: 32 roundings of the largest components, which reach the others
constexpr double COMPONENT_LEVEL = 0x1p-47;  // of a component: a larger correction may be no round-off
constexpr double UNCONVERGED_LEVEL = 0x1p-20;    // of a component: corrections that stop falling above have not converged
constexpr double MOST_UNTESTED = 12.0;       // iterations, so that the first test can compare
constexpr double LARGEST_SAMPLED = 0x1p-8;   // of the size of the stages: larger corrections are not sampled
constexpr int64_t SAMPLES = 8;        // points that differ by roundings, of which few can end alike by chance
constexpr int64_t SAMPLE_LENGTH = 3;  // iterations from these: round-off spreads from one component to the others
constexpr double SAMPLED = 32.0;      // corrections at most so many times their distances are round-off
constexpr double ROUNDING = 0x1p-52;
constexpr double SPACING_OF_SUBNORMALS = 0x1p-1074;  // their rounding, however small they are
constexpr int64_t LONG_ITERATION = int64_t(1) << 14;  // multiplications above which each checks for interrupts

// The number of iterations without a new smallest correction that counts as stagnation. Few can be chance: with complex
// eigenvalues the corrections oscillate while they shrink, the longer the more slowly they shrink.
INLINE double stagnation_length(int64_t passed) { return double(passed < 12 ? 2 : passed / 4); }
// The same where all corrections are at a known level of round-off: these reduce them by 2^5 if 50 bits took `passed`.
INLINE double quiet_length(int64_t passed) { return double(passed < 30 ? 2 : passed / 10); }

// Components whose corrections fell, and those whose corrections are not round-off: zero if there are none.
template <class A>
struct Corrections {
    A fell, large;
    explicit Corrections(double value) : fell(value), large(value) {}
    Corrections(const A& fell, const A& large) : fell(fell), large(large) {}
    Corrections operator+(const Corrections& other) const { return {fell + other.fell, large + other.large}; }
};

// A component in a sample: up to eight roundings of either sign away, of subnormal numbers spacings; none in the first.
template <class A>
INLINE A disturbed(int64_t sample, int64_t component, const A& value) {
    const double roundings = sample == 0 ? 0.0 : double((7 * component + 5 * sample) % 17 - 8);
    return fma(A(roundings * ROUNDING), value, value) + A(roundings * SPACING_OF_SUBNORMALS);
}

// Stages that solve points = base + (error + sum_j mix_ij slopes_j), `size` components each, and scratch memory.
template <class Layout>
struct Unknowns {
    typedef typename Layout::A A;
    typedef typename Layout::V V;
    const int64_t stages, blocks, size;
    const typename Layout::Coefficient* mix;
    int64_t work;  // approximate number of multiplications of an iteration
    V *base = nullptr, *error = nullptr;
    const A* rounding = nullptr;  // of the terms of a component, beside that of its size, if it is known
    AlignedArray<A> points, slopes, before, settled_slopes, change, moved, least, level;

    Unknowns(int64_t stages, int64_t size, const typename Layout::Coefficient* mix)
        : stages(stages), blocks(Layout::blocks(stages)), size(size), mix(mix), work(stages * stages * size),
          points(blocks * size), slopes(blocks * size), before(blocks * size),
          settled_slopes(Numbers<V>::lanes > 1 ? blocks * size : 0), change(blocks * size), moved(blocks),
          least(blocks * size), level(blocks) {}

    void start_at_base() {
        for (int64_t b = 0; b < blocks; ++b)
            share(size, [&](int64_t first, int64_t last) {
                for (int64_t c = first; c < last; ++c) points.at[b * size + c] = Layout::spread(base[c]);
            });
    }

    // Start at the extrapolation of the polynomial through the slopes of the previous step, unless that is not finite;
    // return the lanes where it is finite.
    auto start_extrapolated(const typename Layout::Coefficient* forecast) {
        A total(0.0);
        for (int64_t b = 0; b < blocks; ++b)
            total = total + shared_sum<A>(size, [&](int64_t first, int64_t last) __attribute__((always_inline)) {
                A nothing(0.0);
                mix_slice<Layout>(forecast + b * stages, stages, before.at, size, error, first, last,
                                  [&](int64_t c, const A& sum) {
                                      const A point = Layout::spread(base[c]) + sum;
                                      nothing = nothing + 0.0 * point;
                                      points.at[b * size + c] = point;
                                  });
                return nothing;
            });
        const auto valid = Layout::every(total == A(0.0));
        if (all(valid)) return valid;
        if constexpr (Numbers<V>::lanes == 1)
            start_at_base();
        else
            for (int64_t k = 0; k < blocks * size; ++k) points.at[k] = select(valid, points.at[k], base[k % size]);
        return valid;
    }

    // Set the points of the blocks low to high - 1 from the first `count` slopes, and record their moves if these are
    // watched.
    template <bool watched>
    INLINE void update_points(int64_t low, int64_t high, int64_t count) {
        for (int64_t b = low; b < high; ++b) {
            A *here = points.at + b * size, *changed = change.at + b * size;
            const A far = shared_sum<A>(size, [&](int64_t first, int64_t last) __attribute__((always_inline)) {
                A moves(0.0);
                mix_slice<Layout>(mix + b * stages, count, slopes.at, size, error, first, last,
                                  [&](int64_t c, const A& sum) {
                                      const A point = Layout::spread(base[c]) + sum;
                                      if constexpr (watched) {
                                          const A distance = absolute(point - here[c]);
                                          changed[c] = distance;
                                          moves = moves + distance;
                                      }
                                      here[c] = point;
                                  });
                return moves;
            });
            if constexpr (watched) moved.at[b] = far;
        }
    }

    // Set `change` to what the slopes add to the base, minus the points.
    NOINLINE void find_defect() {
        for (int64_t b = 0; b < blocks; ++b)
            mix_each<Layout>(mix + b * stages, stages, slopes.at, size, error, [&](int64_t c, const A& sum) {
                change.at[b * size + c] = (Layout::spread(base[c]) - points.at[b * size + c]) + sum;
            });
    }

    // Set the threshold for round-off relative to each stage at its start; if that may be a poor guess, relative to its
    // first move too.
    INLINE void measure(int64_t blocks, int64_t size) {
        for (int64_t b = 0; b < blocks; ++b) {
            level.at[b] = A(ROUND_OFF_LEVEL) * shared_sum<A>(size, [&](int64_t first, int64_t last) {
                A total(0.0);
                for (int64_t c = first; c < last; ++c) total = total + absolute(points.at[b * size + c]);
                return total;
            });
        }
    }
    NOINLINE void measure_move(const typename Numbers<V>::Mask& where, int64_t blocks) {
        for (int64_t b = 0; b < blocks; ++b)
            level.at[b] = Layout::choose(where, level.at[b] + A(ROUND_OFF_LEVEL) * moved.at[b], level.at[b]);
    }

    // The largest sum of the components of a stage.
    NOINLINE V extent() const {
        V result(0.0);
        for (int64_t b = 0; b < blocks; ++b) {
            A total(0.0);
            for (int64_t c = 0; c < size; ++c) total = total + absolute(points.at[b * size + c]);
            result = larger(result, V(Layout::largest(total)));
        }
        return result;
    }

    // The largest correction of a stage, summed over its components; NaN if any is NaN.
    NOINLINE V largest_move() const {
        V result(0.0), nan_sum(0.0);
        for (int64_t b = 0; b < blocks; ++b) {
            result = larger(result, V(Layout::largest(moved.at[b])));
            const V infinite(std::numeric_limits<double>::infinity());
            nan_sum = select(Layout::every(moved.at[b] - moved.at[b] == A(0.0)), nan_sum, infinite - infinite);
        }
        return result + nan_sum;
    }

    // Whether the correction of any component of a stage is smaller than all previous ones: components differ in size,
    // and each must stop falling. One unit in the last place is ignored, since among many components one would always
    // fall; and the `rounding` where it is known, and then `is_quiet` is whether no correction is larger.
    INLINE auto falling(const typename Numbers<V>::Mask& where, int64_t blocks, int64_t size, bool& is_quiet) {
        const Corrections<A> number = shared_sum<Corrections<A>>(blocks * size, [&](int64_t first, int64_t last) {
            auto found = A(0.0) < A(0.0), large = found;
            for (int64_t k = first; k < last; ++k) {
                A unit = A(2.0 * UNIT_ROUNDOFF) * absolute(points.at[k]);
                if (__builtin_expect(rounding != nullptr, 0)) {
                    unit = unit + rounding[k];
                    large = large | (unit < change.at[k]);
                }
                const A correction = select(change.at[k] <= unit, A(0.0), change.at[k]);
                auto decreased = correction < least.at[k];
                if constexpr (Numbers<V>::lanes > 1) decreased = decreased & where;
                least.at[k] = select(decreased, correction, least.at[k]);
                found = found | decreased;
            }
            return Corrections<A>(select(found, A(1.0), A(0.0)), select(large, A(1.0), A(0.0)));
        });
        is_quiet = rounding && !any(Layout::some(A(0.0) < number.large));
        return Layout::some(A(0.0) < number.fell);
    }

    // The same for lanes that are `again` tested from the start. Where components move each other in turns, every other
    // correction vanishes: a component then rests, which is the sign of `least`, and falls as before if it moves again
    // by more than round-off.
    NOINLINE auto falling_again(const typename Numbers<V>::Mask& where, const typename Numbers<V>::Mask& again,
                                int64_t blocks, int64_t size) {
        auto any_falls = A(0.0) < A(0.0);
        for (int64_t b = 0; b < blocks; ++b)
            for (int64_t c = 0; c < size; ++c) {
                const int64_t k = b * size + c;
                const A extent = absolute(points.at[k]), correction = change.at[k], known = least.at[k];
                const A own = extent + absolute(Layout::spread(base[c]));
                const auto resting = known <= A(0.0), still = correction <= A(2.0 * UNIT_ROUNDOFF) * extent;
                const auto moves_again = (A(COMPONENT_LEVEL) * own < correction) & (correction < -known) & !still;
                auto decreased = (still | (correction < known)) & !resting;
                if constexpr (Numbers<V>::lanes > 1)
                    decreased = (decreased | (resting & moves_again & again)) & where;
                else
                    decreased = decreased | (resting & moves_again);
                least.at[k] = select(decreased, select(still, -known, correction), known);
                any_falls = any_falls | decreased;
            }
        return Layout::some(any_falls);
    }
    NOINLINE void test_again(const typename Numbers<V>::Mask& where, int64_t blocks, int64_t size) {
        for (int64_t k = 0; k < blocks * size; ++k)
            least.at[k] = Layout::choose(where, A(std::numeric_limits<double>::infinity()), least.at[k]);
    }

    // Whether the correction of any component of a stage is larger than this part of it before and now, and, if `any_term`,
    // than the round-off of the largest components, which reaches the others.
    template <bool any_term>
    NOINLINE auto any_larger(double part, int64_t blocks, int64_t size) const {
        auto found = A(0.0) < A(0.0);
        for (int64_t b = 0; b < blocks; ++b)
            for (int64_t c = 0; c < size; ++c) {
                const A correction = change.at[b * size + c];
                const A own = absolute(points.at[b * size + c]) + absolute(Layout::spread(base[c]));
                auto larger = A(part) * own < correction;
                if constexpr (any_term) larger = larger & (A(SPREAD_OF_ROUND_OFF) * level.at[b] < correction);
                found = found | larger;
            }
        return Layout::some(found);
    }
};

// The largest correction of a component that is round-off, if samples end at this distance.
template <class A>
INLINE A most_rounding(const A& component, const A& distance) {
    return A(SAMPLED) * fma(A(ROUNDING), absolute(component), distance + A(SPACING_OF_SUBNORMALS));
}

// Whether corrections that do not fall are round-off of the terms of their components: iterations from points that
// differ by roundings end about as far apart. The slopes are then those at the points.
template <class Layout, class Evaluate>
NOINLINE bool at_round_off(Unknowns<Layout>& y, const Evaluate& evaluate) {
    typedef typename Layout::A A;
    const int64_t count = y.blocks * y.size;
    // Larger corrections have no digits left, or diverge.
    if (!(y.largest_move() <= LARGEST_SAMPLED * y.extent())) return false;
    AlignedArray<A> start(count), ends(SAMPLE_LENGTH * count), correction(count), distance(count);
    std::copy_n(y.points.at, count, start.at);
    std::fill_n(distance.at, count, A(0.0));
    for (int64_t sample = 0; sample <= SAMPLES; ++sample) {
        InterruptCheck::of_this_call().after(SAMPLE_LENGTH * y.work);
        for (int64_t k = 0; k < count; ++k)
            y.points.at[k] = disturbed(sample, k % y.size, start.at[k]);
        for (int64_t passed = 0; passed < SAMPLE_LENGTH; ++passed) {
            evaluate();
            y.template update_points<true>(0, y.blocks, y.stages);
            A* const end = ends.at + passed * count;
            if (sample == 0) std::copy_n(y.points.at, count, end);
            for (int64_t k = 0; k < count; ++k)
                distance.at[k] = larger(distance.at[k], absolute(y.points.at[k] - end[k]));
        }
        if (sample == 0) std::copy_n(y.change.at, count, correction.at);
    }
    std::copy_n(start.at, count, y.points.at);
    evaluate();
    auto round_off = A(0.0) <= A(0.0);
    for (int64_t k = 0; k < count; ++k)
        round_off = round_off & (correction.at[k] <= most_rounding(start.at[k], distance.at[k]));
    return Layout::every(round_off);
}

template <class V>
struct Outcome {
    typename Numbers<V>::Mask settled;
    V iterations, residual, untested{0.0};
};

// Iterate points = base + mix slopes(points) until every trajectory of `active` has settled or failed; settled ones
// keep their slopes. `iterate` sets the slopes at the points, then the points, and receives whether their moves are
// watched; `on_settled` receives the lanes that settled, to store more of them. Outcomes have the residual only of
// failed trajectories.
//
// If no trajectory is active, nothing is done.
//
// A trajectory has settled if nothing moves, or if, for some iterations in a row, no component's correction has fallen
// below its minimum since the corrections became small. It fails if corrections grow or fall slowly.
//
// The first `untested` iterations of each are not watched: in the previous step, corrections still fell in them.
template <class Layout, class Mask, class Iterate, class OnSettled>
INLINE auto settle_by(Unknowns<Layout>& y, Mask active, int64_t blocks, int64_t size, const typename Layout::V& untested,
                      Iterate iterate, OnSettled on_settled) {
    typedef typename Layout::V V;
    typedef typename Layout::A A;
    constexpr bool alone = Numbers<V>::lanes == 1;
    const V infinite(std::numeric_limits<double>::infinity());
    const auto no_lane = !(V(0.0) == V(0.0));
    Outcome<V> outcome{no_lane, V(0.0), V(0.0), V(0.0)};
    if (!any(active)) return outcome;
    const bool slow = y.work >= LONG_ITERATION;
    double unwatched = MOST_UNTESTED;
    for (int lane = 0; lane < Numbers<V>::lanes; ++lane)
        if (at(active, lane)) unwatched = smaller(unwatched, lane_of(untested, lane));
    y.measure(blocks, size);
    int64_t passed = 1;
    for (const int64_t last = int64_t(unwatched); passed <= last; ++passed) iterate(std::false_type());
    std::fill_n(y.least.at, blocks * size, A(std::numeric_limits<double>::infinity()));
    V first = infinite, last_tested = infinite, stagnant(0.0);
    double quiet = 0.0;
    typename Numbers<V>::Mask again = no_lane;
    bool any_stored = false;
    // After the last iteration every trajectory has settled or failed.
    for (; passed <= MAX_ITERATIONS; ++passed) {
        iterate(std::true_type());
        if (__builtin_expect(slow, 0)) InterruptCheck::of_this_call().after(y.work * Numbers<V>::lanes);
        const V count = V(double(passed));
        typename Numbers<V>::Mask small = active & (count > untested), ended = no_lane, failed = no_lane,
                                  unchanged = no_lane;
        for (int64_t b = 0; b < blocks; ++b) small = small & Layout::every(y.moved.at[b] <= y.level.at[b]);
        if (any(small)) {
            unchanged = small;
            for (int64_t b = 0; b < blocks; ++b) unchanged = unchanged & Layout::every(y.moved.at[b] == A(0.0));
            ended = unchanged;
            auto stagnating = small & !unchanged;
            if (any(stagnating)) {
                bool is_quiet = false;
                const typename Numbers<V>::Mask falls =
                    __builtin_expect(any(again), 0) ? y.falling_again(stagnating, again, blocks, size)
                                                    : y.falling(stagnating, blocks, size, is_quiet);
                quiet = is_quiet ? quiet + 1.0 : 0.0;
                stagnating = stagnating & !falls & (count > V(double(FIRST_TEST)));
            }
            stagnant = select(stagnating, stagnant + 1.0, V(0.0));
            typename Numbers<V>::Mask stagnated = stagnating & (stagnant >= V(stagnation_length(passed)));
            if (any(stagnated)) {
                const typename Numbers<V>::Mask large = stagnated & y.template any_larger<false>(COMPONENT_LEVEL, blocks, size);
                if (__builtin_expect(any(large), 0)) {
                    // Large for some component: round-off of other terms, or not yet, or never converged.
                    const typename Numbers<V>::Mask once_more = large & !again;
                    failed = large & again & y.template any_larger<true>(UNCONVERGED_LEVEL, blocks, size);
                    stagnated = stagnated & !once_more & !failed;
                    stagnant = select(once_more, V(0.0), stagnant);
                    y.test_again(once_more, blocks, size);
                    again = again | once_more;
                }
            }
            ended = ended | stagnated;
            if (alone && quiet >= quiet_length(passed)) ended = small, stagnant = V(quiet);
        } else {
            stagnant = V(quiet = 0.0);
        }
        if (__builtin_expect(passed == 1, 0)) {
            const auto tested_at_once = !(untested > V(0.0));
            first = last_tested = select(tested_at_once, y.largest_move(), infinite);
            y.measure_move(tested_at_once, blocks);
            failed = failed | (active & tested_at_once & !ended & !(first - first == V(0.0)));
        } else if (__builtin_expect(passed % TEST_INTERVAL == 0, 0)) {
            const V now = y.largest_move();
            const auto bounded = now <= V(DIVERGENCE_FACTOR) * first, fast = now <= V(SLOWEST_RATE) * last_tested;
            failed = failed | (active & !ended & !(bounded & (small | fast)));
            last_tested = now;
            InterruptCheck::of_this_call().after(TEST_INTERVAL * y.work * Numbers<V>::lanes);
            if (passed >= MAX_ITERATIONS) failed = active & !ended;
        }
        const auto over = ended | failed;
        if (!any(over)) continue;
        outcome.settled = outcome.settled | ended;
        outcome.iterations = select(over, count, outcome.iterations);
        const V falling_iterations = select(unchanged, count, count - stagnant) - 2.0;
        const V next = smaller(larger(falling_iterations, V(0.0)), V(MOST_UNTESTED));
        outcome.untested = select(ended, next, outcome.untested);
        if (__builtin_expect(any(failed), 0)) {
            const V move = y.largest_move();
            const V last_move = passed == 1 ? move : select(move - move == V(0.0), move, infinite);
            outcome.residual = select(failed, last_move, outcome.residual);
        }
        if constexpr (alone) {
            return outcome;
        } else {
            const bool last = !any(active & !over);
            if (any_stored || !last) {
                for (int64_t k = 0; k < y.blocks * y.size; ++k)
                    y.settled_slopes.at[k] = select(over, y.slopes.at[k], y.settled_slopes.at[k]);
                on_settled(over, last);
                any_stored = true;
            }
            active = active & !over;
            if (!last) continue;
            if (any_stored) std::swap(y.settled_slopes.at, y.slopes.at);
            return outcome;
        }
    }
    return outcome;
}

// The same with `evaluate`, which sets the slopes only, and every iteration watched.
template <class Layout, class Mask, class Evaluate, class OnSettled>
INLINE auto settle(Unknowns<Layout>& y, Mask active, Evaluate evaluate, OnSettled on_settled) {
    auto iterate = [&](auto watched) __attribute__((always_inline)) {
        evaluate();
        y.template update_points<decltype(watched)::value>(0, y.blocks, y.stages);
    };
    return settle_by(y, active, y.blocks, y.size, typename Layout::V(0.0), iterate, on_settled);
}

}  // namespace coadjoint
