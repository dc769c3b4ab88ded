// The field of a system at one point, for steps written in Python and compiled by Numba.
#include <memory>

#include "field/points.hpp"

namespace coadjoint {

namespace {

// Scratch memory by its size, cached by each thread for the next call.
DerivativeRoom<double>& room_of(const Field& field) {
    struct Kept {
        int64_t size = -1, longest = -1, nonlinear = -1;
        std::unique_ptr<DerivativeRoom<double>> room;
    };
    static thread_local Kept kept;
    if (kept.size != field.size || kept.longest != field.longest || kept.nonlinear != field.nonlinear) {
        kept.room = std::make_unique<DerivativeRoom<double>>(field);
        kept.size = field.size;
        kept.longest = field.longest;
        kept.nonlinear = field.nonlinear;
    }
    return *kept.room;
}

}  // namespace

// Set out = sign J(x) grad H(x, t).
EXPORT void field_at(const Seen* seen, const double* x, double t, double* out) {
    const Field& field = *seen->field;
    DerivativeRoom<double>& room = room_of(field);
    gradient(field, seen->constants, x, t, room.gradient.at, room.field);
    product(field, seen->constants, x, room.gradient.at, 1.0, out, room.field);
}

// Set out = grad H(x, t).
EXPORT void gradient_at(const Seen* seen, const double* x, double t, double* out) {
    gradient(*seen->field, seen->constants, x, t, out, room_of(*seen->field).field);
}

// Return H(x, t).
EXPORT double energy_at(const Seen* seen, const double* x, double t) {
    return seen->constant + energy(*seen->field, seen->values, seen->constants, x, t, room_of(*seen->field).field);
}

// Set out = J(x), n x n.
EXPORT void structure_at(const Seen* seen, const double* x, double* out) {
    const Field& field = *seen->field;
    const int64_t n = field.size;
    if (field.nonlinear) {
        DerivativeRoom<double>& room = room_of(field);
        structure(field, seen->constants, x, room.field);
        std::copy_n(room.field.matrix.at, n * n, out);
        return;
    }
    std::fill_n(out, n * n, 0.0);
    for (int64_t i = 0; i < n; ++i)
        for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
            out[i * n + field.column[q]] +=
                field.sign * seen->constants.number_at<double>(field.constant, q) * x[field.state[q]];
}

// Set out = H''(x, t), n x n: exact for terms without functions of the user.
EXPORT void hessian_at(const Seen* seen, const double* x, double t, double* out) {
    const int64_t n = seen->field->size;
    DerivativeRoom<double>& room = room_of(*seen->field);
    std::vector<double> unit(n, 0.0);
    for (int64_t j = 0; j < n; ++j) {
        unit[j] = 1.0;
        hessian_times(*seen->field, seen->constants, x, unit.data(), t, out + j * n, room);
        unit[j] = 0.0;
    }
}

// Set out to the derivative of the field, n x n: exact if J(x) and H have no functions of the user.
EXPORT void jacobian_at(const Seen* seen, const double* x, double t, double* out) {
    const Field& field = *seen->field;
    const int64_t n = field.size;
    DerivativeRoom<double>& room = room_of(field);
    std::vector<double> unit(n, 0.0), u(n), column(n);
    gradient(field, seen->constants, x, t, u.data(), room.field);
    for (int64_t j = 0; j < n; ++j) {
        unit[j] = 1.0;
        jacobian_times(field, seen->constants, x, u.data(), unit.data(), t, 1.0, column.data(), room);
        for (int64_t i = 0; i < n; ++i) out[i * n + j] = column[i];
        unit[j] = 0.0;
    }
}

}  // namespace coadjoint
