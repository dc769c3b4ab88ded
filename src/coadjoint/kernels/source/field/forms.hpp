// Non-polynomial functions without functions of the user: sums of logarithms, angles, quotients and hyperbolic
// functions of polynomials.
#pragma once

#include <limits>

#include "boundary/codes.hpp"
#include "boundary/tables.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

// The value at y, NaN if the function is undefined; equal to that of `Forms` in Python up to rounding of the elementary
// functions.
ONCE double value_of_forms(const Forms& forms, const double* y);

#if defined(COADJOINT_APART) || defined(COMPILES_FIELD)
double value_of_forms(const Forms& forms, const double* y) {
    double total = 0.0, held = 0.0;
    for (int64_t f = 0; f < forms.size; ++f) {
        double form = 0.0;
        for (int64_t m = forms.first[f]; m < forms.first[f + 1]; ++m) {
            double product = forms.coefficient[m];
            for (int64_t q = forms.begin[m]; q < forms.begin[m + 1]; ++q) product *= y[forms.coordinate[q]];
            form += product;
        }
        const int64_t role = forms.role[f];
        const double weight = forms.weight[f];
        if (form == 0.0 && (role == QUOTIENT || role == LOGARITHM || (role == ANGLE && held == 0.0)))
            return std::numeric_limits<double>::quiet_NaN();
        if (role == HOLD) {
            held = form;
        } else if (role == QUOTIENT) {
            total += weight * (held / form);
        } else if (role == LOGARITHM) {
            total += weight * rounded_logarithm(absolute(form));
        } else if (role == ANGLE) {
            total += weight * rounded_angle(held, form);
        } else if (role == COSH) {
            total += weight * (hyperbolic_rotation(form).cosm1 + 1.0);
        } else {
            const double sine = hyperbolic_sine(form);
            total += role == SINH ? weight * sine / held : weight * ((sine / held) * (sine / held));
        }
    }
    return total;
}
#endif

}  // namespace coadjoint
