// Events within a step with a known Taylor series: the series of g, and its zeros.
#pragma once

#include <algorithm>
#include <cmath>

#include "boundary/codes.hpp"
#include "boundary/tables.hpp"
#include "numbers/descartes.hpp"

namespace coadjoint {

// The coefficients of a motion over a step, x_k h^k at `at` + k * `stride`, except x_0.
struct StepSeries {
    const double* at = nullptr;
    int64_t stride = 0, order = 0;
};

class EventSeries {
  public:
    EventSeries(const Watch& watch, int64_t order)
        : watch(watch), order(order), isolation(order), sum(order + 1), product(order + 1), other(order + 1),
          polynomial(watch.size, true) {
        for (int64_t e = 0; e < watch.size; ++e)
            for (uint32_t term = watch.first[e]; term < watch.first[e + 1]; ++term)
                if (watch.terms.kind[term] == FUNCTION) polynomial[e] = false;
    }

    // Whether the series determines the zeros of an event.
    bool determines(int64_t e) const { return polynomial[e]; }

    // Call `found(low, high)` for each part of the step from `before` in which event e crosses zero once.
    template <class Found>
    void operator()(int64_t e, const double* before, const StepSeries& motion, Found found) {
        start = before;
        series = motion;
        expand(e);
        double rest = 0.0;
        for (int64_t k = 1; k <= order; ++k) rest += std::fabs(sum[k]);
        if (std::fabs(sum[0]) <= rest) isolation(sum.data(), found);
    }

  private:
    typedef std::vector<double> Row;
    const Watch& watch;
    const int64_t order;
    Isolation isolation;
    Row sum, product, other;
    std::vector<bool> polynomial;
    const double* start = nullptr;
    StepSeries series;

    double coefficient(int64_t i, int64_t k) const { return k ? series.at[k * series.stride + i] : start[i]; }

    void expand(int64_t e) {
        const Terms& terms = watch.terms;
        std::fill(sum.begin(), sum.end(), 0.0);
        sum[0] = watch.constant[e];
        for (uint32_t term = watch.first[e]; term < watch.first[e + 1]; ++term)
            if (terms.kind[term] == LINEAR)
                for (int64_t row = terms.row[term]; row < terms.row[term + 1]; ++row) add_row(row);
            else
                for (uint32_t m = terms.monomial[term]; m < terms.monomial[term + 1]; ++m) add_monomial(m);
    }

    // x_i (offset + weight . x / 2)
    void add_row(int64_t row) {
        const Terms& terms = watch.terms;
        std::fill(product.begin(), product.end(), 0.0);
        for (uint32_t entry = terms.entry[row]; entry < terms.entry[row + 1]; ++entry)
            for (int64_t k = 0; k <= order; ++k)
                product[k] += 0.5 * terms.weight[entry] * coefficient(terms.column[entry], k);
        product[0] += terms.offset[row];
        multiply(terms.target[row], terms.entry[row] == terms.entry[row + 1]);
        for (int64_t k = 0; k <= order; ++k) sum[k] += product[k];
    }

    void add_monomial(uint32_t m) {
        const Terms& terms = watch.terms;
        std::fill(product.begin(), product.end(), 0.0);
        product[0] = terms.coefficient[m];
        bool alone = true;
        for (uint32_t factor = terms.factor[m]; factor < terms.factor[m + 1]; ++factor)
            for (uint32_t power = 0; power < terms.exponent[factor]; ++power, alone = false)
                multiply(terms.target[terms.factor_row[factor]], alone);
        for (int64_t k = 0; k <= order; ++k) sum[k] += product[k];
    }

    // Multiply the product by the series of coordinate i; if it is `alone`, the product is a number so far.
    void multiply(int64_t i, bool alone) {
        for (int64_t k = 0; k <= order; ++k) {
            other[k] = product[0] * coefficient(i, k);
            for (int64_t j = 1; !alone && j <= k; ++j) other[k] += product[j] * coefficient(i, k - j);
        }
        product.swap(other);
    }
};

}  // namespace coadjoint
