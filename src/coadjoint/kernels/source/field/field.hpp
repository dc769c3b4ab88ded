// The vector field, sign * J(x) u with u = grad H(x, t), and its group equation, -sign * g rho(u).
#pragma once

#include <vector>

#include "field/terms.hpp"
#include "numbers/aligned_array.hpp"

namespace coadjoint {

// Scratch memory for evaluations of a field: rows of a term, arguments of functions, J as a function, calls; and the
// partial components of the last gradient. With `holds` the rows of linear functions of tables are held, and `reused`
// instead of computed.
template <class A>
struct FieldWorkspace {
    AlignedArray<A> rows, arguments, matrix, partial, held{0};
    std::vector<double> calls;
    bool holds = false, reused = false;
    explicit FieldWorkspace(const Field& field)
        : rows(field.longest), arguments(field.longest + 1), matrix(field.nonlinear ? field.size * field.size : 0),
          partial(field.partials), calls(std::max(2 * field.longest + 2, field.nonlinear ? field.size * (field.size + 1) : 0)) {}
};

// Approximate number of multiplications of a field evaluation.
inline int64_t work_of(const Field& field) {
    const int64_t n = field.size;
    return n + work_of_terms(field.terms, 0, field.terms.size) +
           (field.nonlinear ? WORK_OF_A_CALL + n * n : 2 * int64_t(field.first[n]));
}

// A bound of the norm of term k of a gradient as a map of x, if it is a linear function of a table, or 0.
template <class C>
INLINE double norm_of_term(const Field& field, const C& constants, int64_t k) {
    if (field.terms.kind[k] != FUNCTION) return 0.0;
    const TableFunction* function = table_function(constants.address(field.addresses, k, 0));
    return function ? function->norm : 0.0;
}

// Set u = grad H(x, t).
template <class A, class C>
INLINE void gradient(const Field& field, const C& constants, const A* x, const A& t, A* u,
                     FieldWorkspace<A>& workspace) {
    const Terms& terms = field.terms;
    const bool linear = terms.size >= 1 && terms.kind[0] == LINEAR && (terms.size == 1 || field.partials == 0);
    if (!linear || terms.row[1] < field.size)
        for (int64_t i = 0; i < field.size; ++i) u[i] = A(0.0);
    if (__builtin_expect(linear, 1)) {
        share(terms.row[1], [&](int64_t first, int64_t above) __attribute__((always_inline)) {
            const uint32_t *target = terms.target, *high = terms.entry + 1, *column = terms.column;
            const double *offset = terms.offset, *weight = terms.weight;
            const uint32_t stop = uint32_t(above);
            for (uint32_t row = uint32_t(first), entry = terms.entry[first]; row < stop; ++row) {
                A total = constants.template number_at<A>(offset, row);
                for (const uint32_t last = high[row]; entry < last; ++entry)
                    total = fma(constants.template number_at<A>(weight, entry), x[column[entry]], total);
                u[target[row]] = total;
            }
        });
        if (__builtin_expect(terms.size == 1, 1)) return;
    }
    std::fill_n(workspace.partial.at, field.partials, A(0.0));
    for (int64_t k = linear, added = 0, held = 0; k < terms.size; ++k) {
        const int64_t first = terms.row[k], stop = terms.row[k + 1];
        const bool holds = __builtin_expect(workspace.holds, 0) && norm_of_term(field, constants, k) > 0.0;
        A* const rows = holds ? workspace.held.at + held : workspace.rows.at;
        if (holds) held += stop - first;
        if (!holds || !workspace.reused)
            gradient_rows(terms, constants, field.addresses, k, x, t, rows, first, workspace.arguments.at,
                          workspace.calls.data());
        for (int64_t row = first; row < stop; ++row) u[terms.target[row]] += rows[row - first];
        for (; added < field.partial_rows && field.partial_row[added] < stop; ++added)
            workspace.partial.at[field.partial[added]] += rows[field.partial_row[added] - first];
    }
}

// Fill workspace.matrix with J(x) if it is a function of the user.
template <class A, class C>
INLINE void structure(const Field& field, const C& constants, const A* x, FieldWorkspace<A>& workspace) {
    call_function(constants, field.structure, 0, x, field.size, A(0.0), workspace.matrix.at, field.size * field.size,
                  workspace.calls.data());
}

// Set f = factor * sign * J(x) u. The factor comes last, so that cancelling products are rounded once.
template <class A, class C>
INLINE void product(const Field& field, const C& constants, const A* x, const A* u, const A& factor, A* f,
                    FieldWorkspace<A>& workspace) {
    const int64_t n = field.size;
    if (__builtin_expect(field.nonlinear, 0)) {
        structure(field, constants, x, workspace);
        for (int64_t i = 0; i < n; ++i) {
            A total(0.0);
            for (int64_t j = 0; j < n; ++j) total = fma(workspace.matrix.at[i * n + j], u[j], total);
            f[i] = factor * (A(field.sign) * total);
        }
        return;
    }
    share(n, [&](int64_t first, int64_t above) __attribute__((always_inline)) {
        const uint32_t *high = field.first + 1, *state = field.state, *column = field.column;
        const double* constant = field.constant;
        const uint32_t stop = uint32_t(above);
        for (uint32_t i = uint32_t(first), q = field.first[first]; i < stop; ++i) {
            A total(0.0);
            for (const uint32_t last = high[i]; q < last; ++q)
                total = fma(constants.template number_at<A>(constant, q) * x[state[q]], u[column[q]], total);
            f[i] = factor * total;
        }
    });
}

// Set f = factor * sign * J(x) u for the last gradient u, at x, by the products of a separated field.
template <class A, class C>
NOINLINE void separated_product(const Field& field, const C& constants, const A* x, const A* u, const A& factor, A* f,
                                const FieldWorkspace<A>& workspace) {
    for (int64_t i = 0; i < field.size; ++i) {
        A total(0.0);
        for (uint32_t q = field.own_first[i]; q < field.own_first[i + 1]; ++q) {
            const int64_t column = field.own_column[q];
            const A& component = column < field.size ? u[column] : workspace.partial.at[column - field.size];
            total = fma(constants.template number_at<A>(field.own_constant, q) * x[field.own_state[q]], component, total);
        }
        f[i] = factor * total;
    }
}

// Set u = grad H(x, t) and f = factor * sign * J(x) u, without the products that cancel.
template <class A, class C>
INLINE void slope_at(const Field& field, const C& constants, const A* x, const A& t, const A& factor, A* u, A* f,
                     FieldWorkspace<A>& workspace) {
    gradient(field, constants, x, t, u, workspace);
    if (__builtin_expect(field.separated, 0))
        separated_product(field, constants, x, u, factor, f, workspace);
    else
        product(field, constants, x, u, factor, f, workspace);
}

// Set out = factor * sign * J(x) M, for the dense n x n matrix M.
template <class A, class C>
NOINLINE void structure_times_matrix(const Field& field, const C& constants, const A* x, const double* matrix,
                                     const A& factor, A* out, FieldWorkspace<A>& workspace) {
    const int64_t n = field.size;
    std::fill_n(out, n * n, A(0.0));
    if (field.nonlinear) structure(field, constants, x, workspace);
    for (int64_t i = 0; i < n; ++i) {
        auto add_row = [&](int64_t j, const A& entry) {
            for (int64_t k = 0; k < n; ++k)
                out[i * n + k] = fma(entry, constants.template number_at<A>(matrix, j * n + k), out[i * n + k]);
        };
        if (field.nonlinear)
            for (int64_t j = 0; j < n; ++j) add_row(j, factor * A(field.sign) * workspace.matrix.at[i * n + j]);
        else
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                add_row(field.column[q],
                        factor * constants.template number_at<A>(field.constant, q) * x[field.state[q]]);
    }
}

// Set out = factor * sign * D_u, dense: J(x) u = D_u x.
template <class A, class C>
NOINLINE void coadjoint_matrix(const Field& field, const C& constants, const A* u, const A& factor, A* out) {
    const int64_t n = field.size;
    std::fill_n(out, n * n, A(0.0));
    for (int64_t i = 0; i < n; ++i)
        for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q) {
            A& entry = out[i * n + field.state[q]];
            entry = fma(factor * constants.template number_at<A>(field.constant, q), u[field.column[q]], entry);
        }
}

// Set out = factor * (-sign rho(u))^T, dense d x d: it acts on the stored, transposed, group element.
template <class A, class C>
NOINLINE void group_matrix(const GroupField& group, const C& constants, const A* u, const A& factor, A* out) {
    const int64_t d = group.size;
    std::fill_n(out, d * d, A(0.0));
    for (int64_t q = 0; q < group.entries; ++q) {
        A& entry = out[int64_t(group.column[q]) * d + group.row[q]];
        entry = fma(factor * constants.template number_at<A>(group.value, q), u[group.element[q]], entry);
    }
}

// Set f = factor * -sign * g rho(u); component c of row r of a matrix is at c * d + r.
template <class A, class C>
INLINE void group_slope(const GroupField& group, const C& constants, const A* u, const A* g, const A& factor, A* f) {
    const int64_t d = group.size;
    for (int64_t i = 0; i < d * d; ++i) f[i] = A(0.0);
    for (int64_t q = 0; q < group.entries; ++q) {
        const A entry = constants.template number_at<A>(group.value, q) * u[group.element[q]];
        const A* source = g + int64_t(group.row[q]) * d;
        A* goal = f + int64_t(group.column[q]) * d;
        for (int64_t r = 0; r < d; ++r) goal[r] = fma(source[r], entry, goal[r]);
    }
    for (int64_t i = 0; i < d * d; ++i) f[i] = factor * f[i];
}

// Return H(x, t) without its constant; `values` holds the compiled values of FUNCTION terms.
template <class A, class C>
NOINLINE A energy(const Field& field, const int64_t* values, const C& constants, const A* x, const A& t,
                  FieldWorkspace<A>& workspace) {
    A total(0.0);
    for (int64_t k = 0; k < field.terms.size; ++k)
        total = total +
                value_of_term(field.terms, constants, values, k, x, t, workspace.arguments.at, workspace.calls.data());
    return total;
}

}  // namespace coadjoint
