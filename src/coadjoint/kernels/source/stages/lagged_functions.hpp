// Expensive linear functions in a fixed point iteration, such as the fields of dipoles by FFT: their values are reused as
// long as what the points have moved since is too little to be seen beside the last correction. The solution is that
// without reuse, up to round-off: at the end they are evaluated, or are those of points that are equal up to round-off.
// A larger distance, although it would change the points by less than half a rounding, has a sign, and energies drift.
#pragma once

#include "boundary/codes.hpp"
#include "stages/stagnation.hpp"

namespace coadjoint {

constexpr double SEEN_BESIDE = 0.5;     // part of the last correction: a larger error of reused values is seen
constexpr double UNSEEN = 0x1p-53;      // of the size of the points: so far apart they are equal up to round-off
constexpr double LARGEST_UNSEEN = 0x1p-54;  // of that size: reused values may not move points further
constexpr double ROUNDINGS = 4.0;       // of the terms of a slope: of its factors, of the products, and of their sum

// Sums of squares: how far points are from those of the last evaluation, and from the previous ones.
struct Distances {
    static constexpr int64_t together = 8;
    Lanes<together> since, last;

    explicit Distances(double value) : since(value), last(value) {}
    Distances(const Lanes<together>& since, const Lanes<together>& last) : since(since), last(last) {}
    Distances operator+(const Distances& other) const { return {since + other.since, last + other.last}; }
    static double root(const Lanes<together>& squares) {
        double total = 0.0;
        for (int lane = 0; lane < together; ++lane) total += squares[lane];
        return square_root(total);
    }
};

// Whether values are reused: members of few coordinates have the bits that they have as lanes, which decide together.
template <class C>
bool reuses_functions(const Field& field, const C& constants) {
    bool found = false;
    for (int64_t k = 0; k < field.terms.size; ++k) found |= norm_of_term(field, constants, k) > 0.0;
    return found && field.size > WIDEST && !field.nonlinear;
}

template <class Layout>
class LaggedFunctions {
    typedef typename Layout::A A;

  public:
    template <class C>
    LaggedFunctions(const Field& field, const C& constants, int64_t blocks, FieldWorkspace<A>& workspace)
        : workspace(workspace), count(Numbers<A>::lanes * blocks * field.size), evaluated(0), before(0),
          rounding(0) {
        if (Numbers<typename Layout::V>::lanes > 1 || blocks > 1 || !reuses_functions(field, constants)) return;
        int64_t rows = 0;
        for (int64_t k = 0; k < field.terms.size; ++k)
            if (const double one = norm_of_term(field, constants, k)) {
                norm += one;
                rows += field.terms.row[k + 1] - field.terms.row[k];
            }
        workspace.holds = true;
        workspace.held.clear(rows);
        evaluated.clear(blocks * field.size);
        before.clear(blocks * field.size);
        rounding.clear(blocks * field.size);
    }
    bool exist() const { return norm > 0.0; }

    // A step begins at x, whose slopes are multiplied by `factor` in points.
    template <class C>
    void begin(const Field& field, const C& constants, const double* x, double factor) {
        double square = 0.0, structure = 0.0;
        for (int64_t i = 0; i < field.size; ++i) {
            double row = 0.0;
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                row += absolute(constants.template number_at<double>(field.constant, q) * x[field.state[q]]);
            structure = larger(structure, row);
            square = fma(x[i], x[i], square);
        }
        step = absolute(factor);
        rate = norm * structure * step;
        unseen = smaller(UNSEEN * rate, LARGEST_UNSEEN) * square_root(square);
        begun = always = measured = false;
    }

    // The round-off of points whose slopes are J(x) u: of each component, measured once a step.
    template <class C>
    const A* round_off(const Field& field, const C& constants, const A* x, const A* u) {
        if (measured) return rounding.at;
        measured = true;
        const A scale(ROUNDINGS * UNIT_ROUNDOFF * step);
        share(field.size, [&](int64_t first, int64_t last) {
            for (int64_t i = first; i < last; ++i) {
                A sum(0.0), most = absolute(u[i]);
                for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q) {
                    sum = sum + absolute(constants.template number_at<A>(field.constant, q) * x[field.state[q]]);
                    most = larger(most, absolute(u[field.column[q]]));
                }
                rounding.at[i] = scale * sum * most;
            }
        });
        return rounding.at;
    }

    // Decide whether the evaluation at these points reuses the last values.
    void decide(const A* points) {
        const double *now = numbers(points), *then = numbers(evaluated.at);
        double* const previous = const_cast<double*>(numbers(before.at));
        error = 0.0;
        workspace.reused = false;
        if (begun) {
            const Distances found = shared_sum<Distances>(count, [&](int64_t first, int64_t stop) {
                Distances sums(0.0);
                for (int64_t k = first; k < stop; k += Distances::together)
                    sums = sums + squares(now + k, then + k, previous + k, std::min(Distances::together, stop - k));
                return sums;
            });
            error = rate * Distances::root(found.since);
            workspace.reused = !always && error <= larger(SEEN_BESIDE * Distances::root(found.last), unseen);
        } else {
            shared_copy(now, count, previous);
        }
        begun = true;
        if (workspace.reused) return;
        error = 0.0;
        shared_copy(now, count, const_cast<double*>(then));
    }

    // Whether a settled iteration ended with values that are not those of its points; from then on nothing is reused.
    bool must_evaluate() { return always = !always && error > unseen; }
    void end() { workspace.reused = false; }

  private:
    typedef Lanes<Distances::together> Numbers8;
    FieldWorkspace<A>& workspace;
    const int64_t count;
    AlignedArray<A> evaluated, before;  // points
    AlignedArray<A> rounding;
    double norm = 0.0, step = 0.0, rate = 0.0, unseen = 0.0, error = 0.0;
    bool begun = false, always = false, measured = false;

    static const double* numbers(const A* at) { return reinterpret_cast<const double*>(at); }

    // Set the previous numbers to those of now.
    static INLINE Distances squares(const double* now, const double* then, double* previous, int64_t length) {
        if (__builtin_expect(length == Distances::together, 1)) {
            const Numbers8 here = load<Numbers8>(now), since = here - load<Numbers8>(then);
            const Numbers8 last = here - load<Numbers8>(previous);
            store(previous, here);
            return {since * since, last * last};
        }
        Distances rest(0.0);
        for (int lane = 0; lane < length; ++lane) {
            const double since = now[lane] - then[lane], last = now[lane] - previous[lane];
            rest.since.set(lane, since * since), rest.last.set(lane, last * last);
            previous[lane] = now[lane];
        }
        return rest;
    }
};

}  // namespace coadjoint
