// Derivatives of the attitudes A = A0 E G of shifted runs, with the factor E of the shift at the time since the start and
// the elements G of the loop, for Python.
#include "boundary/loop.hpp"
#include "tangents/shift_factor.hpp"

namespace coadjoint {

namespace {

// The attitudes of a run at some points. Those of members are (points, members, d, d); all have the same factors of the
// Casimirs unless there is a stride.
struct ShiftedAttitudes {
    int64_t n, d, casimirs, points, members;
    const double *turning, *factors;
    int64_t stride;
    const double *momenta, *initial, *elapsed, *elements;
};

// Set out to A B.
void set_product(int64_t d, const double* A, const double* B, double* out) {
    std::fill_n(out, d * d, 0.0);
    add_matrix_product(d, 1.0, A, B, out);
}

template <class Visit>
int64_t each_attitude(const ShiftedAttitudes& run, const int64_t* stop, const Visit& visit) {
    InterruptCheck interrupts(stop);
    return outcome_of([&]() -> int64_t {
        const int64_t square = run.d * run.d;
        for (int64_t m = 0; m < run.members; ++m) {
            ShiftFactor shift(run.n, run.d, run.casimirs, run.factors + m * run.stride, run.turning);
            for (int64_t k = 0; k < run.points; ++k) {
                const int64_t at = k * run.members + m;
                visit(shift, shift.at(run.momenta + m * run.n, run.elapsed[k]), m, at, run.initial + m * square,
                      run.elements + at * square);
            }
        }
        return 0;
    });
}

}  // namespace

// Set out (points, members, carried, d, d) to the tangents along changes of momenta (members, carried, n), of initial
// attitudes, of the factors, (members, carried, casimirs) or with a stride of zero (carried, casimirs), and of the elements.
EXPORT int64_t attitude_tangents(const ShiftedAttitudes* run, int64_t carried, const double* of_momenta,
                                 const double* of_initial, const double* of_factors, int64_t stride,
                                 const double* of_elements, double* out, const int64_t* stop) {
    const int64_t d = run->d, square = d * d;
    std::vector<double> changes(carried * square), moved(square), by(square);
    return each_attitude(*run, stop, [&](ShiftFactor& shift, const double* factor, int64_t m, int64_t at, const double* A0,
                                         const double* G) {
        const double *dx = of_momenta + m * carried * run->n, *dA = of_initial + m * carried * square;
        shift.along(carried, dx, of_factors + m * stride, run->casimirs, changes.data());
        for (int64_t v = 0; v < carried; ++v) {
            double* const to = out + (at * carried + v) * square;
            // (dA0 E + A0 dE) G + A0 E dG
            set_product(d, dA + v * square, factor, moved.data());
            add_matrix_product(d, 1.0, A0, changes.data() + v * square, moved.data());
            set_product(d, moved.data(), G, to);
            set_product(d, A0, factor, by.data());
            add_matrix_product(d, 1.0, by.data(), of_elements + (at * carried + v) * square, to);
        }
    });
}

// Add to the cotangents of the momenta, the initial attitudes and the factors (members, casimirs), and set those of the
// elements, for those of the attitudes.
EXPORT int64_t attitude_cotangents(const ShiftedAttitudes* run, const double* of_attitudes, double* of_momenta,
                                   double* of_initial, double* of_factors, double* of_elements, const int64_t* stop) {
    const int64_t d = run->d, square = d * d;
    std::vector<double> one(square), other(square), moved(square);
    return each_attitude(*run, stop, [&](ShiftFactor& shift, const double* factor, int64_t m, int64_t at, const double* A0,
                                         const double* G) {
        const double* const W = of_attitudes + at * square;
        // of G: (A0 E)^T W; of A0: W (E G)^T; of E: A0^T W G^T
        set_product(d, A0, factor, one.data());
        transpose_matrix(d, one.data(), other.data());
        set_product(d, other.data(), W, of_elements + at * square);
        set_product(d, factor, G, one.data());
        transpose_matrix(d, one.data(), other.data());
        add_matrix_product(d, 1.0, W, other.data(), of_initial + m * square);
        transpose_matrix(d, G, other.data());
        set_product(d, W, other.data(), one.data());
        transpose_matrix(d, A0, other.data());
        set_product(d, other.data(), one.data(), moved.data());
        shift.pull(moved.data(), of_momenta + m * run->n, of_factors + m * run->casimirs);
    });
}

}  // namespace coadjoint
