// Directional derivatives of the field: exact for LINEAR and POLYNOMIAL terms and for structure constants, central
// differences for functions of the user.
#pragma once

#include "field/field.hpp"

namespace coadjoint {

constexpr double DIFFERENCE = 0x1p-17;  // about the cube root of the unit round-off: the best accuracy

// The step of a difference at y in the direction v: relative to the size of y; zero if v is zero.
template <class A>
NOINLINE A difference_step(const A* y, const A* v, int64_t count) {
    A large(0.0), wide(0.0);
    for (int64_t i = 0; i < count; ++i) {
        large = larger(large, absolute(y[i]));
        wide = larger(wide, absolute(v[i]));
    }
    large = select(large > A(0.0), large, A(1.0));
    return select(wide > A(0.0), A(DIFFERENCE) * large / wide, A(0.0));
}

// The derivative of one factor of a monomial, `order` times: e (e - 1) ... x^(e - order).
template <class A>
INLINE A factor_derivative(const A& x, uint32_t exponent, int order) {
    double scale = 1.0;
    for (int k = 0; k < order; ++k) scale *= double(exponent) - k;
    if (scale == 0.0) return A(0.0);
    return A(scale) * power(x, exponent - order);
}

template <class A>
struct DerivativeWorkspace {
    FieldWorkspace<A> field;
    AlignedArray<A> point, arguments, direction, gradient, matrix;
    explicit DerivativeWorkspace(const Field& f)
        : field(f), point(std::max(f.size, f.longest)), arguments(std::max(f.size, f.longest)), direction(f.longest),
          gradient(f.size), matrix(f.nonlinear ? f.size * f.size : 0) {}
};

// Set out = H''(x, t) v.
template <class A, class C>
NOINLINE void hessian_times(const Field& field, const C& constants, const A* x, const A* v, const A& t, A* out,
                            DerivativeWorkspace<A>& workspace) {
    const Terms& terms = field.terms;
    std::fill_n(out, field.size, A(0.0));
    for (int64_t k = 0; k < terms.size; ++k) {
        const uint32_t start = terms.row[k], stop = terms.row[k + 1];
        if (terms.kind[k] == LINEAR) {
            share(stop - start, [&](int64_t first, int64_t last) {
                for (uint32_t row = start + uint32_t(first); row < start + uint32_t(last); ++row) {
                    A total(0.0);
                    for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                        total =
                            fma(constants.template number_at<A>(terms.weight, entry), v[terms.column[entry]], total);
                    out[terms.target[row]] += total;
                }
            });
        } else if (terms.kind[k] == POLYNOMIAL) {
            for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
                const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
                for (uint32_t first = low; first < high; ++first)
                    for (uint32_t second = low; second < high; ++second) {
                        A product = constants.template number_at<A>(terms.coefficient, monomial);
                        for (uint32_t factor = low; factor < high; ++factor) {
                            const int order = (factor == first) + (factor == second);
                            product *= factor_derivative(x[terms.target[terms.factor_row[factor]]],
                                                         terms.exponent[factor], order);
                        }
                        out[terms.target[terms.factor_row[first]]] +=
                            product * v[terms.target[terms.factor_row[second]]];
                    }
            }
        } else {
            const int64_t count = stop - start;
            for (int64_t i = 0; i < count; ++i) {
                workspace.arguments.at[i] = x[terms.target[start + i]];
                workspace.direction.at[i] = v[terms.target[start + i]];
            }
            const A step = difference_step(workspace.arguments.at, workspace.direction.at, count);
            const A whole = select(step > A(0.0), A(0.5) / step, A(0.0));
            for (double side : {1.0, -1.0}) {
                for (int64_t i = 0; i < count; ++i)
                    workspace.point.at[i] = fma(A(side) * step, workspace.direction.at[i], workspace.arguments.at[i]);
                call_function(constants, field.addresses, k, workspace.point.at, count, t, workspace.field.rows.at,
                              count, workspace.field.calls.data());
                for (int64_t i = 0; i < count; ++i)
                    out[terms.target[start + i]] += A(side) * whole * workspace.field.rows.at[i];
            }
        }
    }
}

// Set out = factor * sign * d/dx (J(x) grad H(x, t)) v, with u = grad H(x, t).
template <class A, class C>
NOINLINE void jacobian_times(const Field& field, const C& constants, const A* x, const A* u, const A* v, const A& t,
                             const A& factor, A* out, DerivativeWorkspace<A>& workspace) {
    const int64_t n = field.size;
    A* second_derivative = workspace.gradient.at;
    hessian_times(field, constants, x, v, t, second_derivative, workspace);
    if (!field.nonlinear) {
        share(n, [&](int64_t first, int64_t last) {
            for (int64_t i = first; i < last; ++i) {
                A total(0.0);
                for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q) {
                    const uint32_t j = field.column[q], k = field.state[q];
                    total = fma(constants.template number_at<A>(field.constant, q),
                                fma(v[k], u[j], x[k] * second_derivative[j]), total);
                }
                out[i] = factor * total;
            }
        });
        return;
    }
    product(field, constants, x, second_derivative, factor, out, workspace.field);
    const A step = difference_step(x, v, n), whole = select(step > A(0.0), A(0.5) / step, A(0.0));
    for (double side : {1.0, -1.0}) {
        for (int64_t i = 0; i < n; ++i) workspace.point.at[i] = fma(A(side) * step, v[i], x[i]);
        product(field, constants, workspace.point.at, u, factor * A(side) * whole, workspace.arguments.at,
                workspace.field);
        for (int64_t i = 0; i < n; ++i) out[i] += workspace.arguments.at[i];
    }
}

// `declared` is `extern`, or empty in field.cpp.
#define COMPILED_DERIVATIVES(declared, C)                                                                     \
    declared template void hessian_times(const Field&, const C&, const double*, const double*, const double&, \
                                         double*, DerivativeWorkspace<double>&);                              \
    declared template void jacobian_times(const Field&, const C&, const double*, const double*, const double*, \
                                          const double&, const double&, double*, DerivativeWorkspace<double>&);

#if !defined(COADJOINT_APART)
COMPILED_DERIVATIVES(extern, SharedConstants)
COMPILED_DERIVATIVES(extern, MemberConstants)
#endif

}  // namespace coadjoint
