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

// `results` numbers of the function of FUNCTION term k, from its address in `functions`.
template <class A, class C>
const A* call_derivatives(const Terms& terms, const C& constants, const int64_t* functions, int64_t k, const A* x,
                          const A& t, int64_t results, HessianWorkspace<A>& workspace) {
    const int64_t start = terms.row[k], count = terms.row[k + 1] - start;
    for (int64_t i = 0; i < count; ++i) workspace.arguments.at[i] = x[terms.target[start + i]];
    if (results > 0)
        call_function(constants, functions, k, workspace.arguments.at, count, t, workspace.matrix.at, results,
                      workspace.calls.data());
    return workspace.matrix.at;
}

// `product` times the derivative of a monomial without its coefficient, once by each of two factors.
template <class A>
INLINE A times_derivative(A product, const Terms& terms, uint32_t monomial, const A* x, uint32_t one, uint32_t other) {
    for (uint32_t factor = terms.factor[monomial]; factor < terms.factor[monomial + 1]; ++factor)
        product *= factor_derivative(x[terms.target[terms.factor_row[factor]]], terms.exponent[factor],
                                     (factor == one) + (factor == other));
    return product;
}

// Call `visit(index, row, factor)` for the derivatives of the rows of term k by its offsets, weights and coefficients, whose
// indices are in this order, each after those of all terms. Those of functions are at `functions`.
template <class A, class C, class Visit>
INLINE void each_coefficient(const Terms& terms, const C& constants, const int64_t* functions, int64_t k, const A* x,
                             const A& t, HessianWorkspace<A>& workspace, const Visit& visit) {
    const int64_t start = terms.row[k], stop = terms.row[k + 1], all = terms.row[terms.size];
    const int64_t weights = all, coefficients = all + terms.entry[all];
    const uint32_t begin = terms.monomial[k], end = terms.monomial[k + 1];
    if (terms.kind[k] == LINEAR) {
        share(stop - start, [&](int64_t low, int64_t high) {
            for (int64_t row = start + low; row < start + high; ++row) {
                visit(row, row, A(1.0));
                for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                    visit(weights + entry, row, x[terms.column[entry]]);
            }
        });
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (uint32_t monomial = begin; monomial < end; ++monomial)
            for (uint32_t one = terms.factor[monomial]; one < terms.factor[monomial + 1]; ++one)
                visit(coefficients + monomial, int64_t(terms.factor_row[one]),
                      times_derivative(A(1.0), terms, monomial, x, one, terms.factor[monomial + 1]));
    } else {
        const A* change =
            call_derivatives(terms, constants, functions, k, x, t, int64_t(end - begin) * (stop - start), workspace);
        for (uint32_t monomial = begin; monomial < end; ++monomial)
            for (int64_t row = start; row < stop; ++row) visit(coefficients + monomial, row, *change++);
    }
}

// Call `visit(row, coordinate, number, product)` for the derivatives of the rows of term k by coordinates: each is
// product(number), or number * product(1). Those of functions are at `hessians`. Threads share linear rows if `shared`.
template <class A, class C, class Visit>
INLINE void each_second_derivative(const Terms& terms, const C& constants, const int64_t* hessians, int64_t k,
                                   const A* x, const A& t, HessianWorkspace<A>& workspace, bool shared,
                                   const Visit& visit) {
    const int64_t start = terms.row[k], count = terms.row[k + 1] - start;
    const auto itself = [](const A& number) { return number; };
    if (terms.kind[k] == LINEAR) {
        const auto rows = [&](int64_t low, int64_t high) {
            for (int64_t row = start + low; row < start + high; ++row)
                for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                    visit(row, terms.column[entry], constants.template number_at<A>(terms.weight, entry), itself);
        };
        shared ? share(count, rows) : rows(0, count);
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
            const A coefficient = constants.template number_at<A>(terms.coefficient, monomial);
            for (uint32_t one = low; one < high; ++one)
                for (uint32_t other = low; other < high; ++other)
                    if (one != other || terms.exponent[one] >= 2)
                        visit(int64_t(terms.factor_row[one]), terms.target[terms.factor_row[other]], coefficient,
                              [&](const A& number) { return times_derivative(number, terms, monomial, x, one, other); });
        }
    } else {
        const A* entry = call_derivatives(terms, constants, hessians, k, x, t, count * count, workspace);
        for (int64_t i = 0; i < count; ++i)
            for (int64_t j = 0; j < count; ++j) visit(start + i, terms.target[start + j], *entry++, itself);
    }
}

// Fill out[(row - first) * rows] with the change of every row of term k along the vectors. The rows are those of
// `gradient_rows`.
template <class A, class V, class C>
NOINLINE void gradient_changes(const Terms& terms, const C& constants, const int64_t* hessians, int64_t k, const A* x,
                               const A& t, const V* vectors, int64_t rows, V* out, int64_t first,
                               HessianWorkspace<A>& workspace) {
    std::fill_n(out + (terms.row[k] - first) * rows, (terms.row[k + 1] - terms.row[k]) * rows, V(0.0));
    each_second_derivative(terms, constants, hessians, k, x, t, workspace, true,
                           [&](int64_t row, uint32_t coordinate, const A& number, const auto& product) {
                               const V by(product(number)), *vector = vectors + coordinate * rows;
                               V* change = out + (row - first) * rows;
                               for (int64_t b = 0; b < rows; ++b) change[b] = fma(by, vector[b], change[b]);
                           });
}

}  // namespace coadjoint
