// Small dense linear systems, one for each lane: LU factors with partial pivoting, in a fixed order of operations.
#pragma once

#include "numbers/lanes.hpp"

namespace coadjoint {

// Overwrite a (size * size) matrix by its LU factors, with row exchanges in `pivots`. Return the lanes whose matrix is
// finite and not singular.
template <class V>
NOINLINE typename Numbers<V>::Mask factorize(V* matrix, int64_t size, V* pivots) {
    typename Numbers<V>::Mask valid = V(0.0) == V(0.0);
    for (int64_t k = 0; k < size; ++k) {
        V pivot = V(double(k)), most = absolute(matrix[k * size + k]);
        for (int64_t i = k + 1; i < size; ++i) {
            const V entry = absolute(matrix[i * size + k]);
            pivot = select(entry > most, V(double(i)), pivot);
            most = larger(most, entry);
        }
        pivots[k] = pivot;
        valid = valid & (most > V(0.0)) & (most - most == V(0.0));
        if (any(pivot > V(double(k))))
            for (int64_t i = k + 1; i < size; ++i) {
                const auto here = pivot == V(double(i));
                if (!any(here)) continue;
                for (int64_t j = 0; j < size; ++j) {
                    const V above = matrix[k * size + j], below = matrix[i * size + j];
                    matrix[k * size + j] = select(here, below, above);
                    matrix[i * size + j] = select(here, above, below);
                }
            }
        const V* row = matrix + k * size;
        for (int64_t i = k + 1; i < size; ++i) {
            V* other = matrix + i * size;
            const V factor = other[k] / row[k];
            other[k] = factor;
            for (int64_t j = k + 1; j < size; ++j) other[j] = fma(-factor, row[j], other[j]);
        }
    }
    return valid;
}

// Overwrite `count` right-hand sides, side by side in rows, by the solutions.
template <class V>
NOINLINE void substitute(const V* matrix, int64_t size, const V* pivots, V* right, int64_t count) {
    for (int64_t k = 0; k < size; ++k) {
        if (!any(pivots[k] > V(double(k)))) continue;
        for (int64_t i = k + 1; i < size; ++i) {
            const auto here = pivots[k] == V(double(i));
            if (!any(here)) continue;
            for (int64_t c = 0; c < count; ++c) {
                const V above = right[k * count + c], below = right[i * count + c];
                right[k * count + c] = select(here, below, above);
                right[i * count + c] = select(here, above, below);
            }
        }
    }
    // Column by column, so that the entries of a column are independent.
    for (int64_t k = 0; k < size; ++k)
        for (int64_t i = k + 1; i < size; ++i) {
            const V factor = -matrix[i * size + k];
            for (int64_t c = 0; c < count; ++c)
                right[i * count + c] = fma(factor, right[k * count + c], right[i * count + c]);
        }
    for (int64_t k = size - 1; k >= 0; --k) {
        for (int64_t c = 0; c < count; ++c) right[k * count + c] = right[k * count + c] / matrix[k * size + k];
        for (int64_t i = 0; i < k; ++i) {
            const V factor = -matrix[i * size + k];
            for (int64_t c = 0; c < count; ++c)
                right[i * count + c] = fma(factor, right[k * count + c], right[i * count + c]);
        }
    }
}

#if !defined(COADJOINT_APART)
extern template bool factorize(double*, int64_t, double*);  // in newton.cpp
extern template void substitute(const double*, int64_t, const double*, double*, int64_t);
#endif

}  // namespace coadjoint
