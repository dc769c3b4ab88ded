// Dense output: a series as a function of the time within its step.
#pragma once

#include "steps/series.hpp"

namespace coadjoint {

// The sums of |x_k h^k| over the blocks of rows. Their sum is the size of the term.
template <int W>
INLINE Lanes<W> sizes_in_term(const Series<W>& series, int64_t k) {
    Lanes<W> total = absolute(series.x.at[k * series.stride]);
    for (int64_t b = 1; b < series.blocks; ++b)
        total = total + absolute(series.x.at[k * series.stride + b]);
    return total;
}

// x_1 (s h) + ... + x_p (s h)^p of one block of rows: even and odd terms by Horner's rule, each from its smallest
// terms.
template <int W>
INLINE Lanes<W> increment_at(const Series<W>& series, int64_t block, double s) {
    typedef Lanes<W> Row;
    const int64_t stride = series.stride;
    const Row* const first = series.x.at + block;
    const Row square(s * s);
    Row even(0.0), odd(0.0);
    int64_t k = series.order;
    if (k % 2 == 0) even = first[k-- * stride];
    for (; k > 1; k -= 2) {
        odd = fma(odd, square, first[k * stride]);
        even = fma(even, square, first[(k - 1) * stride]);
    }
    odd = fma(odd, square, first[stride]);
    return Row(s) * fma(Row(s), even, odd);
}

}  // namespace coadjoint
