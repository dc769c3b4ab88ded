// Changes of gradients along tangent vectors side by side: exact second derivatives.
#pragma once

#include "field/derivatives.hpp"

namespace coadjoint {

// The rows of the longest term that is a function of the user, and the largest number of its derivatives by coordinates or
// by coefficients.
struct FunctionSizes {
    int64_t rows = 0, columns = 0;
    explicit FunctionSizes(const Terms& terms) {
        for (int64_t k = 0; k < terms.size; ++k)
            if (terms.kind[k] == FUNCTION) {
                const int64_t count = terms.row[k + 1] - terms.row[k];
                rows = std::max(rows, count);
                columns = std::max({columns, count, int64_t(terms.monomial[k + 1] - terms.monomial[k])});
            }
    }
};

// Scratch memory for the arguments of such a function, its matrix, and the call.
template <class A>
struct HessianWorkspace {
    AlignedArray<A> arguments, matrix;
    std::vector<double> calls;
    explicit HessianWorkspace(const Terms& terms) : HessianWorkspace(FunctionSizes(terms)) {}

  private:
    explicit HessianWorkspace(const FunctionSizes& sizes)
        : arguments(sizes.rows + 1), matrix(sizes.rows * sizes.columns), calls((sizes.rows + 1) * (sizes.columns + 1)) {}
};

// The derivatives of the rows of a FUNCTION term by its coefficients, (coefficients, rows), from the function at its
// address; none if it has no coefficients.
template <class A, class C>
const A* by_coefficients(const Terms& terms, const C& constants, const int64_t* functions, int64_t k, const A* x,
                         const A& t, HessianWorkspace<A>& workspace) {
    const int64_t start = terms.row[k], count = terms.row[k + 1] - start;
    const int64_t results = int64_t(terms.monomial[k + 1] - terms.monomial[k]) * count;
    for (int64_t i = 0; i < count; ++i) workspace.arguments.at[i] = x[terms.target[start + i]];
    if (results > 0)
        call_function(constants, functions, k, workspace.arguments.at, count, t, workspace.matrix.at, results,
                      workspace.calls.data());
    return workspace.matrix.at;
}

// Fill out[(row - first) * rows] with the change of every row of term k along the vectors. The rows are those of
// `gradient_rows`.
template <class A, class V, class C>
NOINLINE void gradient_changes(const Terms& terms, const C& constants, const int64_t* hessians, int64_t k, const A* x,
                               const A& t, const V* vectors, int64_t rows, V* out, int64_t first,
                               HessianWorkspace<A>& workspace) {
    const int64_t start = terms.row[k], stop = terms.row[k + 1], count = stop - start;
    V* changes = out + (start - first) * rows;
    std::fill_n(changes, count * rows, V(0.0));
    const auto add = [&](int64_t position, const A& factor, int64_t coordinate) {
        const V by(factor);
        for (int64_t b = 0; b < rows; ++b)
            changes[position * rows + b] = fma(by, vectors[coordinate * rows + b], changes[position * rows + b]);
    };
    if (terms.kind[k] == LINEAR) {
        share(count, [&](int64_t low, int64_t high) {
            for (int64_t row = start + low; row < start + high; ++row)
                for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                    add(row - start, constants.template number_at<A>(terms.weight, entry), terms.column[entry]);
        });
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
            for (uint32_t one = low; one < high; ++one)
                for (uint32_t other = low; other < high; ++other) {
                    if (one == other && terms.exponent[one] < 2) continue;
                    A product = constants.template number_at<A>(terms.coefficient, monomial);
                    for (uint32_t factor = low; factor < high; ++factor)
                        product *= factor_derivative(x[terms.target[terms.factor_row[factor]]], terms.exponent[factor],
                                                     (factor == one) + (factor == other));
                    add(terms.factor_row[one] - start, product, terms.target[terms.factor_row[other]]);
                }
        }
    } else {
        for (int64_t i = 0; i < count; ++i) workspace.arguments.at[i] = x[terms.target[start + i]];
        call_function(constants, hessians, k, workspace.arguments.at, count, t, workspace.matrix.at,
                      count * count, workspace.calls.data());
        for (int64_t i = 0; i < count; ++i)
            for (int64_t j = 0; j < count; ++j) add(i, workspace.matrix.at[i * count + j], terms.target[start + j]);
    }
}

}  // namespace coadjoint
