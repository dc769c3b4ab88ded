// The field of a system at one point, for steps written in Python and compiled by Numba.
#include <memory>

#include "field/points.hpp"

namespace coadjoint {

namespace {

// Scratch memory by its size, cached by each thread for the next call.
DerivativeWorkspace<double>& workspace_of(const Field& field) {
    struct Cached {
        int64_t size = -1, longest = -1, nonlinear = -1, partials = -1;
        std::unique_ptr<DerivativeWorkspace<double>> workspace;
    };
    static thread_local Cached cached;
    if (cached.size != field.size || cached.longest != field.longest || cached.nonlinear != field.nonlinear ||
        cached.partials != field.partials) {
        cached.workspace = std::make_unique<DerivativeWorkspace<double>>(field);
        cached.size = field.size;
        cached.longest = field.longest;
        cached.nonlinear = field.nonlinear;
        cached.partials = field.partials;
    }
    return *cached.workspace;
}

}  // namespace

// Set out = sign J(x) grad H(x, t).
EXPORT void field_at(const SystemView* view, const double* x, double t, double* out) {
    const Field& field = *view->field;
    DerivativeWorkspace<double>& workspace = workspace_of(field);
    slope_at(field, view->constants, x, t, 1.0, workspace.gradient.at, out, workspace.field);
}

// Set out = grad H(x, t).
EXPORT void gradient_at(const SystemView* view, const double* x, double t, double* out) {
    gradient(*view->field, view->constants, x, t, out, workspace_of(*view->field).field);
}

// Return H(x, t).
EXPORT double energy_at(const SystemView* view, const double* x, double t) {
    return view->constant + energy(*view->field, view->values, view->constants, x, t, workspace_of(*view->field).field);
}

// Set out = J(x), n x n.
EXPORT void structure_at(const SystemView* view, const double* x, double* out) {
    const Field& field = *view->field;
    const int64_t n = field.size;
    if (field.nonlinear) {
        DerivativeWorkspace<double>& workspace = workspace_of(field);
        structure(field, view->constants, x, workspace.field);
        std::copy_n(workspace.field.matrix.at, n * n, out);
        return;
    }
    std::fill_n(out, n * n, 0.0);
    for (int64_t i = 0; i < n; ++i)
        for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
            out[i * n + field.column[q]] +=
                field.sign * view->constants.number_at<double>(field.constant, q) * x[field.state[q]];
}

// Set out = H''(x, t), n x n: exact for terms without functions of the user.
EXPORT void hessian_at(const SystemView* view, const double* x, double t, double* out) {
    const int64_t n = view->field->size;
    DerivativeWorkspace<double>& workspace = workspace_of(*view->field);
    std::vector<double> unit(n, 0.0);
    for (int64_t j = 0; j < n; ++j) {
        unit[j] = 1.0;
        hessian_times(*view->field, view->constants, x, unit.data(), t, out + j * n, workspace);
        unit[j] = 0.0;
    }
}

// Set out to the derivative of the field, n x n: exact if J(x) and H have no functions of the user.
EXPORT void jacobian_at(const SystemView* view, const double* x, double t, double* out) {
    const Field& field = *view->field;
    const int64_t n = field.size;
    DerivativeWorkspace<double>& workspace = workspace_of(field);
    std::vector<double> unit(n, 0.0), u(n), column(n);
    gradient(field, view->constants, x, t, u.data(), workspace.field);
    for (int64_t j = 0; j < n; ++j) {
        unit[j] = 1.0;
        jacobian_times(field, view->constants, x, u.data(), unit.data(), t, 1.0, column.data(), workspace);
        for (int64_t i = 0; i < n; ++i) out[i * n + j] = column[i];
        unit[j] = 0.0;
    }
}

}  // namespace coadjoint
