// Changes of gradients and fields along tangent vectors side by side: exact second derivatives.
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

// Changes of the field of one system: of the gradient of H, and of sign J(x) u.
template <class V>
class FieldChanges {
  public:
    FieldChanges(const Field& field, const Tangents& tangents, int64_t rows)
        : field(field), tangents(tangents), rows(rows), workspace(field.terms), part(field.longest * rows),
          second_derivative(field.size * rows), derivative(field.nonlinear ? field.size * field.size * field.size : 0),
          calls(field.nonlinear ? field.size * (1 + field.size * field.size) : 0) {}

    // Set out = factor * sign * J(z) H''(x, t) v.
    void of_gradient(const double* z, const double* x, double t, const V* vectors, double factor, V* out,
                     FieldWorkspace<double>& workspace_of_field) {
        const Terms& terms = field.terms;
        std::fill_n(second_derivative.at, field.size * rows, V(0.0));
        for (int64_t k = 0; k < terms.size; ++k) {
            const int64_t first = terms.row[k];
            gradient_changes(terms, SharedConstants{}, tangents.hessians, k, x, t, vectors, rows, part.at, first,
                             workspace);
            for (int64_t row = first; row < int64_t(terms.row[k + 1]); ++row)
                for (int64_t b = 0; b < rows; ++b)
                    second_derivative.at[terms.target[row] * rows + b] += part.at[(row - first) * rows + b];
        }
        if (field.nonlinear) structure(field, SharedConstants{}, z, workspace_of_field);
        share(field.size, [&](int64_t first, int64_t last) {
            std::fill(out + first * rows, out + last * rows, V(0.0));
            for (int64_t i = first; i < last; ++i) {
                if (field.nonlinear)
                    for (int64_t j = 0; j < field.size; ++j)
                        add(i, factor * field.sign * workspace_of_field.matrix.at[i * field.size + j],
                            second_derivative.at + j * rows, out);
                else
                    for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                        add(i, factor * (field.constant[q] * z[field.state[q]]),
                            second_derivative.at + field.column[q] * rows, out);
            }
        });
    }

    // Add to out the factor times sign * (derivative of J at z along v) u.
    void of_structure(const double* z, const double* u, const V* vectors, double factor, V* out) {
        const int64_t n = field.size;
        if (!field.nonlinear) {
            return share(n, [&](int64_t first, int64_t last) {
                for (int64_t i = first; i < last; ++i)
                    for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                        add(i, factor * (field.constant[q] * u[field.column[q]]), vectors + field.state[q] * rows, out);
            });
        }
        call_function(SharedConstants{}, tangents.derivative, 0, z, n, 0.0, derivative.data(), n * n * n, calls.data());
        for (int64_t i = 0; i < n; ++i)
            for (int64_t k = 0; k < n; ++k) {
                double entry = 0.0;
                for (int64_t j = 0; j < n; ++j) entry = fma(derivative[(i * n + j) * n + k], u[j], entry);
                add(i, factor * (field.sign * entry), vectors + k * rows, out);
            }
    }

  private:
    const Field& field;
    const Tangents& tangents;
    const int64_t rows;
    HessianWorkspace<double> workspace;
    AlignedArray<V> part, second_derivative;
    std::vector<double> derivative, calls;

    void add(int64_t i, double factor, const V* from, V* out) const {
        for (int64_t b = 0; b < rows; ++b) out[i * rows + b] = fma(V(factor), from[b], out[i * rows + b]);
    }
};

}  // namespace coadjoint
