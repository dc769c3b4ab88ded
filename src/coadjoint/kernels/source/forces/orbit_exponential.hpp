// Exponentials along the coadjoint orbit: x_new = exp(D_v) x with D_v x = sign J(x) v, and midpoint rules made of them.
// `A` is a double, or members as lanes, each with the bits that it has alone.
#pragma once

#include <memory>

#include "field/field.hpp"
#include "recording/watching.hpp"
#include "steps/exponential.hpp"

namespace coadjoint {

// `ExponentialAction` of members as lanes, for at most `FEW_OF_ACTION` substeps each.
template <class A>
class ExponentialOfLanes {
  public:
    typedef typename Numbers<A>::Mask Mask;
    AlignedArray<A> move;

    explicit ExponentialOfLanes(int64_t longest) : move(longest), parts(1.0), degree(1.0), total(longest), image(longest) {}

    // Where there are few substeps, and not more than a series has.
    Mask measure(const A* sums, int64_t rows, int64_t work) {
        A norm(0.0);
        for (int64_t i = 0; i < rows; ++i) norm = select((sums[i] > norm) | !(sums[i] == sums[i]), sums[i], norm);
        const Mask few = norm <= A(double(FEW_OF_ACTION));
        norm = select(few, norm, A(0.0));
        parts = all(norm <= A(1.0)) ? A(1.0) : map(norm, [](double one) { return std::max(1.0, std::ceil(one)); });
        const A theta = norm / parts;
        degree = A(1.0);
        most_terms = 1;
        for (A term = 0.5 * theta; any(term > A(NEGLIGIBLE)); ++most_terms) {
            const Mask longer = term > A(NEGLIGIBLE);
            degree = select(longer, degree + 1.0, degree);
            term = select(longer, term * (theta / (degree + 1.0)), term);
        }
        most_parts = int64_t(largest_lane(parts));
        InterruptCheck::of_this_call().after(Numbers<A>::lanes * most_parts * most_terms * work);
        return few;
    }

    // As that of `ExponentialAction`, of vectors.
    template <class Apply>
    void act(const A* y, int64_t size, const Apply& apply) {
        std::fill_n(move.at, size, A(0.0));
        for (int64_t passed = 0; passed < most_parts; ++passed) {
            for (int64_t i = 0; i < size; ++i) total.at[i] = y[i] + move.at[i];
            for (int64_t power = most_terms; power > 0; --power) {
                apply(total.at, most_parts == 1 ? A(1.0 / double(power)) : 1.0 / (A(double(power)) * parts), image.at);
                if (power == 1) break;
                const Mask begun = A(double(power)) <= degree;
                const bool all_begun = all(begun);
                for (int64_t i = 0; i < size; ++i) {
                    const A start = y[i] + move.at[i];
                    total.at[i] = all_begun ? start + image.at[i] : select(begun, start + image.at[i], start);
                }
            }
            const Mask left = A(double(passed)) < parts;
            for (int64_t i = 0; i < size; ++i) move.at[i] = select(left, move.at[i] + image.at[i], move.at[i]);
        }
    }

  private:
    A parts, degree;
    int64_t most_parts = 1, most_terms = 1;
    AlignedArray<A> total, image;
};

// Stop some members for a reason.
template <class A, class Where, class Mask>
INLINE void stop_members(const Where& where, const A& reason, Mask& moving, A& status) {
    status = select(where, reason, status);
    moving = moving & !where;
}

// A field with its constants.
template <class C>
struct FieldOf {
    const Field& field;
    C constants;
};

// A field with those of its products that have a factor u_i in some columns: all others are zero.
template <class C>
struct RestrictedField {
    RestrictedField(const Field& whole, const C& all, const std::vector<bool>& used) : field(whole) {
        first.push_back(0);
        for (int64_t i = 0; i < whole.size; ++i) {
            for (uint32_t q = whole.first[i]; q < whole.first[i + 1]; ++q) {
                if (!used[whole.column[q]]) continue;
                column.push_back(whole.column[q]), state.push_back(whole.state[q]);
                for (int lane = 0; lane < lanes; ++lane)
                    constant.push_back(MemberConstants(all.of_lane(lane)).number_at<double>(whole.constant, q));
            }
            first.push_back(uint32_t(column.size()));
        }
        field.first = first.data(), field.column = column.data(), field.state = state.data();
        field.constant = constant.data();
    }
    RestrictedField(const RestrictedField&) = delete;

    FieldOf<C> products() const {
        if constexpr (std::is_same_v<C, SharedConstants>)
            return {field, {}};
        else
            return {field, {lanes, 0}};
    }

  private:
    static constexpr int lanes = std::is_same_v<C, LaneConstants> ? MEMBER_LANES : 1;
    Field field;
    std::vector<uint32_t> first, column, state;
    std::vector<double> constant;
};

template <class A, class C>
class OrbitExponential {
  public:
    typedef typename Numbers<A>::Mask Mask;
    // Of the last midpoint rule; `iterations` and `evaluations` are whole numbers.
    A iterations{0.0}, evaluations{0.0}, residual{0.0};

    OrbitExponential(const Field& field, const GroupField& group, const C& constants)
        : whole{field, constants}, group(group), n(field.size),
          exponential(std::max(n, group.size * group.size)), sums(std::max(n, group.size)), before(n), next(n),
          workspace(field) {
        if (is_lanes) alone.reset(new OrbitExponential<double, MemberConstants>(field, group, constants.of_lane(0)));
    }

    // Set out to exp(factor D_v) x for the members that are `moving`; return where it is defined, and not too long. The
    // field may be restricted to the columns in which v is not zero.
    Mask operator()(const A* v, double factor, const A* x, A* out, const Mask& moving) {
        return (*this)(v, factor, x, out, moving, whole);
    }
    Mask operator()(const A* v, double factor, const A* x, A* out, const Mask& moving, const FieldOf<C>& products) {
        const Field& used = products.field;
        const C& numbers = products.constants;
        for (int64_t i = 0; i < n; ++i) {
            A sum(0.0);
            for (uint32_t q = used.first[i]; q < used.first[i + 1]; ++q)
                sum = fma(absolute(numbers.template number_at<A>(used.constant, q)), absolute(v[used.column[q]]), sum);
            sums.at[i] = A(factor) * sum;
        }
        const auto apply = [&](const A* from, const A& part, A* to) {
            product(used, numbers, from, v, A(factor) * part, to, workspace);
        };
        Mask defined = exponential.measure(sums.at, n, work_of(used));
        if constexpr (is_lanes) {
            exponential.act(x, n, apply);
            const Mask found = moving & defined, others = moving & !defined;
            if (__builtin_expect(any(others), 0)) defined = defined | one_by_one(v, factor, x, out, others, products);
            for (int64_t i = 0; i < n; ++i) out[i] = select(found, x[i] + exponential.move.at[i], out[i]);
        } else {
            if (!defined) return false;
            exponential.act(x, n, apply);
            for (int64_t i = 0; i < n; ++i) out[i] = x[i] + exponential.move[i];
        }
        return defined;
    }

    // Move the group element, which is transposed, by the same exponential; false as above.
    bool turn(const double* v, double* element) {
        std::fill_n(sums.at, group.size, 0.0);
        const C& constants = whole.constants;
        for (int64_t q = 0; q < group.entries; ++q)
            sums.at[group.column[q]] = fma(absolute(constants.template number_at<double>(group.value, q)),
                                           absolute(v[group.element[q]]), sums.at[group.column[q]]);
        if (!exponential.measure(sums.at, group.size, group.size * group.entries)) return false;
        exponential.act(element, group.size * group.size, [&](const double* from, double part, double* to) {
            group_slope(group, constants, v, from, part, to);
        }, group.size);
        for (int64_t i = 0; i < group.size * group.size; ++i) element[i] += exponential.move[i];
        return true;
    }

    // The midpoint rule: x = exp(D_v) x for the v that `direction(middle, v)` sets at the middle exp(D_v / 2) x, for the
    // members that are `moving`; return their statuses. It preserves every Casimir even if the iteration ends early.
    template <class Direction>
    A midpoint(A* x, A* v, A* middle, const Mask& moving, const Direction& direction) {
        A status = double(NOT_CONVERGED), last(std::numeric_limits<double>::infinity()), first = last, scale(0.0);
        std::copy_n(x, n, middle);
        for (int64_t i = 0; i < n; ++i) scale += absolute(x[i]);
        Mask running = moving;
        iterations = evaluations = A(0.0);
        for (int64_t k = 1; k <= MOST_MIDPOINTS && any(running); ++k) {
            iterations = select(running, A(double(k)), iterations);
            evaluations = iterations;
            direction(middle, next.at);
            for (int64_t i = 0; i < n; ++i) v[i] = select(running, next.at[i], v[i]);
            std::copy_n(middle, n, before.at);
            const Mask defined = (*this)(v, 0.5, x, middle, running);
            A change(0.0);
            for (int64_t i = 0; i < n; ++i) change += absolute(middle[i] - before.at[i]);
            residual = select(running & defined, change, residual);
            const Mask valid = defined & (change - change == A(0.0));
            if (!all(valid)) status = select(running & !valid, failed(v), status);
            if (k == 1) first = change;
            // Stop if corrections are round-off, and have stopped falling.
            const Mask settled = (change == A(0.0)) | ((change >= 0.5 * last) & (change <= NEAR_ROUND_OFF * scale));
            status = select(running & valid & settled, A(double(DONE)), status);
            running = running & valid & !settled & !(change > GROWN * (first + scale));
            last = change;
        }
        iterations = select(running, iterations + 1.0, iterations);
        const Mask found = moving & (status == A(double(DONE)));
        const Mask moved = (*this)(v, 1.0, x, x, found);
        return select(found & !moved, failed(v), status);
    }

    // The status after a failed exponential.
    A failed(const A* v) const { return select(finite(n, v), A(double(UNDEFINED)), A(double(OVERFLOWED))); }

  private:
    static constexpr bool is_lanes = Numbers<A>::lanes > 1;
    const FieldOf<C> whole;
    const GroupField& group;
    const int64_t n;
    std::conditional_t<is_lanes, ExponentialOfLanes<A>, ExponentialAction> exponential;
    AlignedArray<A> sums, before, next;
    FieldWorkspace<A> workspace;
    std::unique_ptr<OrbitExponential<double, MemberConstants>> alone;  // for members with many substeps

    NOINLINE Mask one_by_one(const A* v, double factor, const A* x, A* out, const Mask& moving,
                             const FieldOf<C>& products) {
        std::vector<double> rows(2 * n);
        A defined(0.0);
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
            if (!at(moving, lane)) continue;
            for (int64_t i = 0; i < n; ++i) rows[i] = lane_of(x[i], lane), rows[n + i] = lane_of(v[i], lane);
            const FieldOf<MemberConstants> own{products.field, products.constants.of_lane(lane)};
            if (!(*alone)(rows.data() + n, factor, rows.data(), rows.data(), true, own)) continue;
            for (int64_t i = 0; i < n; ++i) set_lane(out[i], lane, rows[i]);
            set_lane(defined, lane, 1.0);
        }
        return defined > A(0.0);
    }

    // Some ten iterations converge.
    static constexpr int64_t MOST_MIDPOINTS = 192;
    // Of the state: residuals that may stagnate as round-off, and multiple of the first one that diverges.
    static constexpr double NEAR_ROUND_OFF = 0x1p-40, GROWN = 0x1p20;
};

}  // namespace coadjoint
