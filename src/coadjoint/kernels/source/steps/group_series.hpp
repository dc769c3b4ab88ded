// The Taylor series of the group element along a motion: g' = g A(u), where u is the gradient of H.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <vector>

#include "boundary/codes.hpp"
#include "boundary/interrupts.hpp"
#include "steps/series.hpp"

namespace coadjoint {

// Truncation error of a series that begins with one; largest norm of its matrices; how many more terms than the
// gradient it may take for that, and the interval of tests.
constexpr double TRUNCATION_ERROR = 0x1p-56, REACH = 2.0;
constexpr int64_t MORE_TERMS = 40, TRUNCATION_TEST_INTERVAL = 4;

// The gradient is a polynomial in time. For that polynomial the group equation is solved up to rounding: a step moves g
// to g P, where P(0) is the unit element and P_(k+1) = h / (k + 1) sum_j P_j A_(k-j), with as many terms as needed. So
// P is an element of the group in every representation, and its error is that of the gradient.
struct GroupMotion {
    virtual ~GroupMotion() = default;
    // Move g, which is transposed, with its compensation, by `count` coefficients u_0, u_1 h, u_2 h^2, ... of the
    // gradient, `stride` numbers each; false if it rotates too far.
    virtual bool rotate(const double* gradients, int64_t count, int64_t stride, double h, double* g, double* dg) = 0;
    // Approximate number of multiplications of `rotate`.
    virtual int64_t work() const = 0;
};

// The number of coefficients of the gradient in a series: products behind the coordinates stop one order earlier.
template <int W>
int64_t known_gradients(const Series<W>& series) {
    return series.order + (series.field.extended == series.field.blocks);
}

template <int W>
void gradients_along(const Series<W>& series, double* to) {
    const SeriesField<W>& field = series.field;
    constexpr int V = SeriesField<W>::V;
    const Sums<V>& sums = field.gradient;
    for (int64_t k = 0; k < known_gradients(series); ++k) {
        const Newest<0, V> now(reinterpret_cast<const double*>(series.x.at + k * series.stride));
        for (int64_t b = 0; b < field.blocks; ++b) {
            Lanes<V> sum = k ? Lanes<V>(0.0) : load<Lanes<V>>(field.offsets.data() + b * V);
            for (int64_t e = sums.first[b]; e < sums.first[b + 1]; ++e)
                sum = fma(sums.at.at[e].weight, now(sums.at.at[e].left), sum);
            store(to + (k * field.blocks + b) * V, sum);
        }
    }
}

// The rows of P are lanes, since each obeys the same equation; matrices are stored column after column.
template <int V>
struct GroupSeries final : GroupMotion {
    typedef Lanes<V> Row;
    const int64_t size, blocks, most, longest;  // most: coefficients of the gradient; longest: terms of P
    std::vector<int64_t> begin, row;            // nonzero entries of A, column by column
    std::vector<int64_t> first, element;        // of each entry: its terms, and the component of u of each
    std::vector<double> weight, entries;        // of each term; the entries of A, order by order
    AlignedArray<Row> A, terms, change, from, to, remainder;  // A_k, P_(k+1), P - 1; g before and after
    std::vector<double> tails, sizes, moved;    // sums of norms of A; norms of P; the gradient of a part of a step

    template <class C>
    NOINLINE GroupSeries(const GroupField& group, const C& constants, int64_t most)
        : size(group.size), blocks(blocks_of<V>(size)), most(most), longest(most + MORE_TERMS), begin{0}, first{0},
          A(most * size * blocks), terms(longest * size * blocks), change(size * blocks), from(size * blocks),
          to(size * blocks), remainder(size * blocks), tails(most + 1), sizes(longest + 1) {
        std::map<std::pair<int64_t, int64_t>, std::map<int64_t, double>> cells;
        for (int64_t q = 0; q < group.entries; ++q)
            cells[{group.column[q], group.row[q]}][group.element[q]] += constants.template number_at<double>(group.value, q);
        for (const auto& [position, sum] : cells) {
            begin.resize(position.first + 1, int64_t(row.size()));
            row.push_back(position.second);
            for (const auto& [i, value] : sum) element.push_back(i), weight.push_back(value);
            first.push_back(int64_t(element.size()));
        }
        begin.resize(size + 1, int64_t(row.size()));
        entries.resize(most * row.size());
    }

    int64_t work() const override {
        return most * (most * int64_t(row.size()) * blocks * V + int64_t(element.size())) + 2 * size * size * size;
    }

    bool rotate(const double* gradients, int64_t count, int64_t stride, double h, double* g, double* dg) override {
        read(gradients, count, stride, h);
        // Parts of a step are the step divided by powers of two, and so are exact.
        int64_t parts = 1;
        while (parts <= MOST_SUBSTEPS && !(tails[0] <= REACH * double(parts))) parts *= 2;
        for (bool again = parts > 1; parts <= MOST_SUBSTEPS; parts *= 2, again = true) {
            load_columns(g, from), load_columns(dg, remainder);
            if (again) InterruptCheck::of_this_call().after(parts * work());
            if (again ? advance_parts(gradients, count, stride, h, parts) : advance_whole(count, h)) {
                store_columns(from, g), store_columns(remainder, dg);
                return true;
            }
        }
        return false;
    }

  private:
    // The whole step with the matrices as read.
    bool advance_whole(int64_t count, double h) {
        if (!expand(count, h)) return false;
        move();
        return true;
    }

    bool advance_parts(const double* gradients, int64_t count, int64_t stride, double h, int64_t parts) {
        const double part = 1.0 / double(parts);
        double power = 1.0;
        moved.resize(count * stride);
        for (int64_t k = 0; k < count; ++k, power *= part)
            for (int64_t i = 0; i < stride; ++i) moved[k * stride + i] = power * gradients[k * stride + i];
        for (int64_t passed = 0; passed < parts; ++passed) {
            // The same polynomial, expanded at the end of the previous part.
            for (int64_t last = 1; passed > 0 && last < count; ++last)
                for (int64_t k = count - 1; k >= last; --k)
                    for (int64_t i = 0; i < stride; ++i) moved[(k - 1) * stride + i] += moved[k * stride + i];
            read(moved.data(), count, stride, part * h);
            if (!advance_whole(count, part * h)) return false;
        }
        return true;
    }

    // Set the matrices A_k, and the sums of their norms times h from each on.
    void read(const double* gradients, int64_t count, int64_t stride, double h) {
        for (int64_t k = 0; k < count; ++k, gradients += stride) {
            Row* const now = A.at + k * size * blocks;
            for (int64_t b = 0; b < size; ++b)
                for (int64_t c = begin[b]; c < begin[b + 1]; ++c) {
                    double sum = weight[first[c]] * gradients[element[first[c]]];
                    for (int64_t e = first[c] + 1; e < first[c + 1]; ++e)
                        sum = coadjoint::fma(weight[e], gradients[element[e]], sum);
                    entries[k * int64_t(row.size()) + c] = sum;
                    entry(now, row[c], b) = sum;
                }
        }
        tails[count] = 0.0;
        for (int64_t k = count; k-- > 0;) tails[k] = fma(std::fabs(h), norm(A.at + k * size * blocks), tails[k + 1]);
    }

    INLINE double& entry(Row* matrix, int64_t r, int64_t column) const {
        return reinterpret_cast<double*>(matrix + column * blocks)[r];
    }

    // The largest row sum.
    INLINE double norm(const Row* matrix) const {
        double most = 0.0;
        for (int64_t s = 0; s < blocks; ++s) {
            Row sum(0.0);
            for (int64_t b = 0; b < size; ++b) sum = sum + absolute(matrix[b * blocks + s]);
            most = larger(most, largest_lane(sum));
        }
        return most;
    }

    void load_columns(const double* g, AlignedArray<Row>& columns) {
        for (int64_t b = 0; b < size; ++b)
            for (int64_t r = 0; r < size; ++r) entry(columns.at, r, b) = g[b * size + r];
    }
    void store_columns(AlignedArray<Row>& columns, double* g) {
        for (int64_t b = 0; b < size; ++b)
            for (int64_t r = 0; r < size; ++r) g[b * size + r] = entry(columns.at, r, b);
    }

    // Dense matrices of some sizes are in registers.
    bool expand(int64_t count, double h) {
        if constexpr (V == 4) {
            if (size == 2) return expand_in<2>(count, h);
            if (size == 3) return expand_in<3>(count, h);
            if (size == 4) return expand_in<4>(count, h);
        } else if (2 * int64_t(row.size()) >= size * size) {
            if (size == 6) return expand_in<6>(count, h);
            if (size == 8) return expand_in<8>(count, h);
        }
        return expand_in<0>(count, h);
    }

    // D: the number of rows and columns, or 0 if dynamic.
    template <int D>
    NOINLINE bool expand_in(int64_t count, double h) {
        sizes[0] = 1.0;
        for (int64_t k = 0; k < longest; ++k) {
            const Row length(h / double(k + 1));
            Row* const now = terms.at + k * size * blocks;
            if constexpr (D > 0) {
                Row even[D], odd[D];
                products<D>(k, count, even, odd);
                for (int b = 0; b < D; ++b) now[b] = length * (even[b] + odd[b]);
            } else {
                for (int64_t b = 0; b < size; ++b)
                    for (int64_t s = 0; s < blocks; ++s) now[b * blocks + s] = length * coefficient(k, count, b, s);
            }
            sizes[k + 1] = norm(now);
            if ((k + 1) % TRUNCATION_TEST_INTERVAL == 0 && nothing_left(k + 1, count)) return add(k + 1), true;
        }
        return false;
    }

    // Whether all terms after the k-th together are within rounding. They are formed from the previous ones and from
    // themselves.
    bool nothing_left(int64_t k, int64_t count) const {
        double sum = 0.0;
        for (int64_t j = std::max<int64_t>(0, k - count + 1); j <= k; ++j)
            sum = coadjoint::fma(sizes[j], tails[k - j], sum);
        return sum <= TRUNCATION_ERROR * (double(k + 1) - tails[0]);
    }

    void add(int64_t count) {
        for (int64_t i = 0; i < size * blocks; ++i) {
            Row sum(0.0);
            for (int64_t k = count; k-- > 0;) sum = sum + terms.at[k * size * blocks + i];
            change.at[i] = sum;
        }
    }

    // sum_j P_j A_(k-j), the newest last, so that the others need not wait for it.
    template <int D>
    INLINE void products(int64_t k, int64_t count, Row* even, Row* odd) const {
        for (int b = 0; b < D; ++b) even[b] = k < count ? A.at[k * D + b] : Row(0.0), odd[b] = Row(0.0);
        int64_t j = std::max<int64_t>(1, k - count + 1);
        for (; j < k; j += 2) {
            add_product<D>(j, k, even);
            add_product<D>(j + 1, k, odd);
        }
        if (j == k) add_product<D>(k, k, even);
    }

    template <int D>
    INLINE void add_product(int64_t j, int64_t k, Row* sums) const {
        const Row* const left = terms.at + (j - 1) * D;
        const double* const right = reinterpret_cast<const double*>(A.at + (k - j) * D);
#pragma GCC unroll 8
        for (int a = 0; a < D; ++a)
#pragma GCC unroll 8
            for (int b = 0; b < D; ++b) sums[b] = fma(left[a], Row(right[b * V + a]), sums[b]);
    }

    // The same for any size, in a column.
    INLINE Row coefficient(int64_t k, int64_t count, int64_t column, int64_t s) const {
        Row sums[4] = {k < count ? A.at[(k * size + column) * blocks + s] : Row(0.0), 0.0, 0.0, 0.0};
        int64_t j = std::max<int64_t>(1, k - count + 1);
        for (; j < k; j += 2) {
            add_column(j, k, column, s, sums[0], sums[1]);
            add_column(j + 1, k, column, s, sums[2], sums[3]);
        }
        if (j == k) add_column(k, k, column, s, sums[0], sums[1]);
        return (sums[0] + sums[1]) + (sums[2] + sums[3]);
    }

    INLINE void add_column(int64_t j, int64_t k, int64_t column, int64_t s, Row& even, Row& odd) const {
        const Row* left = terms.at + (j - 1) * size * blocks + s;
        const double* now = entries.data() + (k - j) * int64_t(row.size());
        int64_t c = begin[column];
        for (; c + 1 < begin[column + 1]; c += 2) {
            even = fma(left[row[c] * blocks], Row(now[c]), even);
            odd = fma(left[row[c + 1] * blocks], Row(now[c + 1]), odd);
        }
        if (c < begin[column + 1]) even = fma(left[row[c] * blocks], Row(now[c]), even);
    }

    // g to g P.
    void move() {
        for (int64_t b = 0; b < size; ++b)
            for (int64_t s = 0; s < blocks; ++s) {
                const int64_t position = b * blocks + s;
                Row more = remainder.at[position];
                for (int64_t a = 0; a < size; ++a)
                    more = fma(from.at[a * blocks + s], Row(entry(change.at, a, b)), more);
                two_sum(from.at[position], more, to.at[position], remainder.at[position]);
            }
        std::swap(from.at, to.at);
    }
};

// The motion of the group element along a series, or null without a group element.
template <int W, class C>
std::unique_ptr<GroupMotion> group_motion(const GroupField& group, const C& constants, const Series<W>& series) {
    if (group.size == 0) return nullptr;
    const int64_t count = known_gradients(series);
    if (group.size <= 4) return std::make_unique<GroupSeries<4>>(group, constants, count);
    return std::make_unique<GroupSeries<8>>(group, constants, count);
}

}  // namespace coadjoint
