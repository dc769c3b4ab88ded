// Gradients and values of the terms of a table (the operation `angle`).
#pragma once

#include <algorithm>

#include "field/forms.hpp"
#include "boundary/codes.hpp"
#include "numbers/constants.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

constexpr int64_t WORK_OF_A_CALL = int64_t(1) << 16;  // cost of a function of the user, in multiplications

// Approximate number of multiplications of the terms first to last - 1.
inline int64_t work_of_terms(const Terms& terms, int64_t first, int64_t last) {
    int64_t work = 0;
    if (terms.repeated) {
        for (uint32_t row = terms.row[first]; row < terms.row[last]; ++row)
            work += terms.entry[terms.shape[row] + 1] - terms.entry[terms.shape[row]];
        return work;
    }
    for (int64_t k = first; k < last; ++k) {
        work += terms.entry[terms.row[k + 1]] - terms.entry[terms.row[k]];
        if (terms.kind[k] == POLYNOMIAL)
            for (uint32_t f = terms.factor[terms.monomial[k]]; f < terms.factor[terms.monomial[k + 1]]; ++f)
                work += terms.exponent[f];
        else if (terms.kind[k] != LINEAR)
            work += WORK_OF_A_CALL;
    }
    return work;
}

// A function called in Python.
typedef void (*PythonFunction)(const double* y, double t, double* out);

// Machine code of a function of the user, and the numbers that it has closed over.
struct CompiledFunction {
    void (*code)(const double* y, double t, double* out, const double* constants);
    const double* constants;

    void operator()(const double* y, double t, double* out) const { code(y, t, out, constants); }
};

// The beginning of a table that is read by `code`. A linear function of y has a bound of its norm, others have 0.
struct TableFunction {
    void (*code)(const TableFunction& table, const double* y, double* out);
    double norm;
};

// The table at an address, if there is a `TableFunction`.
inline const TableFunction* table_function(int64_t address) {
    return address < 0 && (-address & 3) == 3 ? reinterpret_cast<const TableFunction*>(-address - 3) : nullptr;
}

// The sum of all shares in their order; the threads of a team compute them side by side.
ONCE void add_shares(const SharedFunction& function, const double* y, double* out);

// Call the function at an address: one in Python, or, for a negative address, by its last bits a table: a
// `TableFunction`, or one of `CompiledFunction`, of `SharedFunction`, or of `Forms`.
inline void call(int64_t address, const double* y, double t, double* out) {
    const int64_t kind = -address & 3;
    if (address >= 0)
        reinterpret_cast<PythonFunction>(address)(y, t, out);
    else if (kind == 3)
        table_function(address)->code(*table_function(address), y, out);
    else if (kind == 2)
        (*reinterpret_cast<const CompiledFunction*>(-address - 2))(y, t, out);
    else if (kind == 1)
        add_shares(*reinterpret_cast<const SharedFunction*>(-address - 1), y, out);
    else
        *out = value_of_forms(*reinterpret_cast<const Forms*>(-address), y);
}

#if defined(COADJOINT_APART) || defined(COMPILES_FIELD)
NOINLINE void add_shares(const SharedFunction& function, const double* y, double* out) {
    const int64_t results = function.results;
    AlignedArray<double> shares(function.shares * results);
    share_blocks(function.shares, [&](int64_t first, int64_t last) {
        for (int64_t k = first; k < last; ++k) call(function.address, y, double(k), shares.at + k * results);
    });
    for (int64_t i = 0; i < results; ++i) out[i] = shares.at[i];
    for (int64_t k = 1; k < function.shares; ++k)
        for (int64_t i = 0; i < results; ++i) out[i] += shares.at[k * results + i];
}
#endif

// Call a compiled function of the user, lane by lane: it reads `count` numbers and fills `results`.
template <class A, class C>
void call_function(const C& constants, const int64_t* addresses, int64_t k, const A* y, int64_t count, const A& t,
                   A* out, int64_t results, double* workspace) {
    const int used = constants.used(Numbers<A>::lanes);
    for (int lane = 0; lane < used; ++lane) {
        double *point = workspace, *result = workspace + count;
        for (int64_t i = 0; i < count; ++i) point[i] = lane_of(y[i], lane);
        call(constants.address(addresses, k, lane), point, lane_of(t, lane), result);
        for (int64_t i = 0; i < results; ++i) set_lane(out[i], lane, result[i]);
    }
    for (int lane = used; lane < Numbers<A>::lanes; ++lane)
        for (int64_t i = 0; i < results; ++i) set_lane(out[i], lane, lane_of(out[i], used - 1));
}

// x to an integer power by repeated multiplication, in an order that depends on the exponent alone.
template <class A>
INLINE A power(const A& x, uint32_t exponent) {
    A result(1.0);
    for (uint32_t k = 0; k < exponent; ++k) result = result * x;
    return result;
}

// One row of a LINEAR term: offset + weight . x.
template <class A, class C>
INLINE A linear_row(const Terms& terms, const C& constants, int64_t row, const A* x) {
    A total = constants.template number_at<A>(terms.offset, row);
    for (uint32_t entry = terms.entry[row], stop = terms.entry[row + 1]; entry < stop; ++entry)
        total = fma(constants.template number_at<A>(terms.weight, entry), x[terms.column[entry]], total);
    return total;
}

constexpr int64_t ROW_BLOCK = 256;  // rows whose sums stay in the first-level cache

// The offset of a row of a table with `repeated`.
INLINE double repeated_offset(const Terms& terms, int64_t row) {
    return terms.offset[terms.repeated == 2 ? int64_t(terms.shape[row]) : row];
}

// The rows row, row + stride, ... of one shape.
template <bool whole, int stride, class A>
INLINE void rows_of_shape(const Terms& terms, int64_t row, int64_t count, const A* __restrict x, A* __restrict out) {
    const uint32_t shape = terms.shape[row], *target = terms.target + row;
    bool of_spins = true;  // one component of spins in a row: their columns are read without their numbers
    for (int64_t i = 0; i < count; ++i) of_spins &= target[stride * i] == target[0] + 3 * uint32_t(i);
    for (int64_t i = 0; i < count; ++i)
        out[stride * i] = whole ? A(repeated_offset(terms, row + stride * i)) : A(0.0);
    for (uint32_t entry = terms.entry[shape]; entry < terms.entry[shape + 1]; ++entry) {
        const A weight(terms.weight[entry]);
        const uint32_t column = terms.column[entry];
        const A* from = x + uint32_t(target[0] + column);
        if (of_spins)
            for (int64_t i = 0; i < count; ++i) out[stride * i] = fma(weight, from[3 * i], out[stride * i]);
        else
            for (int64_t i = 0; i < count; ++i)
                out[stride * i] = fma(weight, x[uint32_t(target[stride * i] + column)], out[stride * i]);
    }
}

// The rows start to stop - 1 of a table with `repeated`, bitwise as by `linear_row`; without offsets if not `whole`.
// Shapes repeat from row to row, as in a flow, or every three rows, as in the energy of spins.
template <bool whole, class A>
NOINLINE void repeated_rows(const Terms& terms, int64_t start, int64_t stop, const A* __restrict x,
                            A* __restrict out) {
    const uint32_t* shape = terms.shape;
    for (int64_t row = start, next; row < stop; out += next - row, row = next) {
        const int64_t limit = std::min(stop, row + ROW_BLOCK);
        const int64_t stride = row + 3 < limit && shape[row + 1] != shape[row] && shape[row + 3] == shape[row] ? 3 : 1;
        for (next = std::min(limit, row + stride); next < limit && shape[next] == shape[next - stride];) ++next;
        if (stride == 1)
            rows_of_shape<whole, 1>(terms, row, next - row, x, out);
        else
            for (int64_t first = 0; first < 3; ++first)
                rows_of_shape<whole, 3>(terms, row + first, (next - row - first + 2) / 3, x, out + first);
    }
}

template <class A, class C>
INLINE A monomial_without(const Terms& terms, const C& constants, uint32_t monomial, uint32_t chosen, const A* x) {
    A product = constants.template number_at<A>(terms.coefficient, monomial);
    for (uint32_t factor = terms.factor[monomial], high = terms.factor[monomial + 1]; factor < high; ++factor) {
        const A& coordinate = x[terms.target[terms.factor_row[factor]]];
        uint32_t exponent = terms.exponent[factor];
        product = product * (factor == chosen ? double(exponent) * power(coordinate, exponent - 1)
                                              : power(coordinate, exponent));
    }
    return product;
}

// Fill out[row - first] with every row of term k: the angles of a share, or components of a gradient. `y` is scratch
// memory for the arguments of a user function, `workspace` for one lane of them and of its results.
template <class A, class C>
NOINLINE void gradient_rows(const Terms& terms, const C& constants, const int64_t* addresses, int64_t k, const A* x,
                            const A& t, A* out, int64_t first, A* y, double* workspace) {
    int64_t start = terms.row[k], stop = terms.row[k + 1];
    if (terms.kind[k] == LINEAR) {
        share(stop - start, [&](int64_t low, int64_t above) {
            if (terms.repeated)
                return repeated_rows<true>(terms, start + low, start + above, x, out + (start + low - first));
            const uint32_t *high = terms.entry + 1, *column = terms.column;
            const double *offset = terms.offset, *weight = terms.weight;
            uint32_t entry = terms.entry[start + low];
            for (int64_t row = start + low; row < start + above; ++row) {
                A total = constants.template number_at<A>(offset, row);
                for (const uint32_t last = high[row]; entry < last; ++entry)
                    total = fma(constants.template number_at<A>(weight, entry), x[column[entry]], total);
                out[row - first] = total;
            }
        });
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (int64_t row = start; row < stop; ++row) out[row - first] = A(0.0);
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial)
            for (uint32_t chosen = terms.factor[monomial]; chosen < terms.factor[monomial + 1]; ++chosen)
                out[terms.factor_row[chosen] - first] += monomial_without(terms, constants, monomial, chosen, x);
    } else {
        for (int64_t row = start; row < stop; ++row) y[row - start] = x[terms.target[row]];
        call_function(constants, addresses, k, y, stop - start, t, out + (start - first), stop - start, workspace);
    }
}

// The value of term k.
template <class A, class C>
INLINE A value_of_term(const Terms& terms, const C& constants, const int64_t* addresses, int64_t k, const A* x,
                       const A& t, A* y, double* workspace) {
    int64_t start = terms.row[k], stop = terms.row[k + 1];
    A total(0.0);
    if (terms.kind[k] == LINEAR) {
        total = shared_sum<A>(stop - start, [&](int64_t low, int64_t above) {
            A sum(0.0);
            if (terms.repeated) {
                A weighted[ROW_BLOCK];
                for (int64_t row = start + low, end; row < start + above; row = end) {
                    end = std::min(start + above, row + ROW_BLOCK);
                    repeated_rows<false>(terms, row, end, x, weighted);
                    for (int64_t i = 0; i < end - row; ++i)
                        sum = fma(x[terms.target[row + i]],
                                  fma(A(0.5), weighted[i], A(repeated_offset(terms, row + i))), sum);
                }
                return sum;
            }
            for (int64_t row = start + low; row < start + above; ++row) {
                A weighted(0.0);
                for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
                    weighted =
                        fma(constants.template number_at<A>(terms.weight, entry), x[terms.column[entry]], weighted);
                A offset = constants.template number_at<A>(terms.offset, row);
                sum = fma(x[terms.target[row]], fma(A(0.5), weighted, offset), sum);
            }
            return sum;
        });
    } else if (terms.kind[k] == POLYNOMIAL) {
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            A product = constants.template number_at<A>(terms.coefficient, monomial);
            for (uint32_t factor = terms.factor[monomial]; factor < terms.factor[monomial + 1]; ++factor)
                product = product * power(x[terms.target[terms.factor_row[factor]]], terms.exponent[factor]);
            total = total + product;
        }
    } else {
        for (int64_t row = start; row < stop; ++row) y[row - start] = x[terms.target[row]];
        call_function(constants, addresses, k, y, stop - start, t, &total, 1, workspace);
    }
    return total;
}

// `declared` is `extern`, or empty in field.cpp.
#define COMPILED_ROWS_OF_TERMS(declared, A)                                                        \
    declared template void repeated_rows<true>(const Terms&, int64_t, int64_t, const A*, A*);      \
    declared template void repeated_rows<false>(const Terms&, int64_t, int64_t, const A*, A*);     \
    declared template A sum_of_blocks(int64_t, int64_t, const Called<A(int64_t, int64_t)>&);

#define COMPILED_TERMS_OF(declared, A, C)                                                          \
    declared template void call_function(const C&, const int64_t*, int64_t, const A*, int64_t,     \
                                         const A&, A*, int64_t, double*);                          \
    declared template void gradient_rows(const Terms&, const C&, const int64_t*, int64_t,          \
                                         const A*, const A&, A*, int64_t, A*, double*);

#define COMPILED_TERMS(declared)                                          \
    COMPILED_ROWS_OF_TERMS(declared, double)                              \
    COMPILED_ROWS_OF_TERMS(declared, Lanes<MEMBER_LANES>)                 \
    COMPILED_TERMS_OF(declared, double, SharedConstants)                  \
    COMPILED_TERMS_OF(declared, double, MemberConstants)                  \
    COMPILED_TERMS_OF(declared, Lanes<MEMBER_LANES>, SharedConstants)     \
    COMPILED_TERMS_OF(declared, Lanes<MEMBER_LANES>, LaneConstants)

#if !defined(COADJOINT_APART)
COMPILED_TERMS(extern)
#endif

}  // namespace coadjoint
