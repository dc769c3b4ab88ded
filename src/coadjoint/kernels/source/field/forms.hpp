// Functions that are no polynomials but need no function of the user: sums of logarithms, angles and quotients.
#pragma once

#include <cmath>
#include <limits>

#include "boundary/codes.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

// The value at y, NaN where the function is undefined; operation by operation that of `algebra/logarithmic.py`.
inline double value_of_forms(const Forms& forms, const double* y) {
    double total = 0.0, held = 0.0;
    for (int64_t f = 0; f < forms.size; ++f) {
        double form = 0.0;
        for (int64_t m = forms.first[f]; m < forms.first[f + 1]; ++m) {
            double product = forms.coefficient[m];
            for (int64_t q = forms.begin[m]; q < forms.begin[m + 1]; ++q) product *= y[forms.coordinate[q]];
            form += product;
        }
        const int64_t role = forms.role[f];
        if (role == HOLD)
            held = form;
        else if (form == 0.0 && (role == QUOTIENT || role == LOGARITHM || held == 0.0))
            return std::numeric_limits<double>::quiet_NaN();
        else if (role == QUOTIENT)
            total += forms.weight[f] * (held / form);
        else if (role == LOGARITHM)
            total += forms.weight[f] * std::log(std::fabs(form));
        else
            total += forms.weight[f] * std::atan2(held, form);
    }
    return total;
}

}  // namespace coadjoint
