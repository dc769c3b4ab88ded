// Derivatives of the midpoint rule of a selective decay, m = x + (rate tau/2) [u, [u, m]] with u = grad H(m), and then
// 2 m - x, by the state, the rate, and the terms of the derivative of H by coordinates.
#pragma once

#include "forces/selective_decay.hpp"
#include "tangents/second_derivatives.hpp"

namespace coadjoint {

// Nodes 1, -1, 2, ..., -4 of differences of order eight, and their weights.
constexpr int64_t NODES = 8;
constexpr double difference_weight(int64_t node) {
    constexpr double WEIGHTS[] = {4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0};
    return node % 2 ? -WEIGHTS[node / 2] : WEIGHTS[node / 2];
}

class DecayDerivative {
  public:
    DecayDerivative(const ForceTable& force, const Field& field, const ForceDerivatives& table)
        : force(force), field(field), table(table), decay(selective_decay(force, field, MemberConstants{1, 0})), n(decay->n),
          krylov(n), seconds(field.terms), of_added(table.added), m(n), u(n), k(n), rest(n), change(n), slope(n), a(n), b(n),
          image(n) {
        for (int64_t j = 0; j < NODES * table.moved && force.extent; ++j)
            nearby.push_back(selective_decay(*reinterpret_cast<const ForceTable*>(table.nearby[j]), field, MemberConstants{1, 0}));
    }

    // Replace vectors at a state, which the flow moves to `end`, by their tangents after it, along directions of the
    // coefficients: the rate, then the terms; false if the equation is not solved.
    bool push(const double* x, const double* end, double t, double tau, double* vectors, int64_t count,
              const double* directions, int64_t stride) {
        if (!find(x, end, t, tau)) return false;
        for (int64_t v = 0; v < count; ++v) {
            double* const dx = vectors + v * field.size + force.position;
            const double* const along = directions + v * stride;
            std::fill(slope.begin(), slope.end(), 0.0);
            each_added([&](int64_t index, int64_t i, double factor) { slope[i] = fma(factor, along[1 + index], slope[i]); });
            const bool whole = each_moved([&](int64_t k, int64_t i, double by) {
                slope[i] = fma(by, along[table.own + k], slope[i]);
            });
            if (!whole) return false;
            of_slope(slope.data(), change.data());
            const double by_rate = table.own ? 0.5 * tau * along[0] : 0.0;
            for (int64_t i = 0; i < n; ++i) change[i] = fma(by_rate, rest[i], fma(c, change[i], dx[i]));
            if (!solve(false)) return false;
            for (int64_t i = 0; i < n; ++i) dx[i] = fma(2.0, change[i], -dx[i]);
        }
        return true;
    }

    // Replace the cotangent of the `end` by that of the state, and add those of the coefficients.
    bool pull(const double* x, const double* end, double t, double tau, double* cotangent, double* by_coefficients) {
        if (!find(x, end, t, tau)) return false;
        double* const row = cotangent + force.position;
        decay->project(row);
        for (int64_t i = 0; i < n; ++i) change[i] = 2.0 * row[i];
        if (!solve(true)) return false;
        for (int64_t i = 0; i < n; ++i) row[i] = change[i] - row[i];
        if (!table.own) return true;
        for (int64_t i = 0; i < n; ++i) by_coefficients[0] = fma(0.5 * tau * change[i], rest[i], by_coefficients[0]);
        of_slope_transposed(change.data(), slope.data());
        each_added([&](int64_t index, int64_t i, double factor) {
            by_coefficients[1 + index] = fma(c * factor, slope[i], by_coefficients[1 + index]);
        });
        return each_moved([&](int64_t k, int64_t i, double by) {
            by_coefficients[table.own + k] = fma(c * by, slope[i], by_coefficients[table.own + k]);
        });
    }

  private:
    const ForceTable& force;
    const Field& field;
    const ForceDerivatives& table;
    const std::unique_ptr<SelectiveDecay> decay;
    const int64_t n;
    Krylov krylov;
    HessianWorkspace<double> seconds, of_added;
    std::vector<std::unique_ptr<SelectiveDecay>> nearby;  // with moved parameters of the stream of matrices
    double c = 0.0, middle = 0.0;
    std::vector<double> m, u, k, rest, change, slope, a, b, image;  // `k` is [u, m], and `rest` [u, k]

    bool find(const double* x, const double* end, double t, double tau) {
        c = 0.5 * force.rate[0] * tau, middle = t + 0.5 * tau;
        for (int64_t i = 0; i < n; ++i) m[i] = 0.5 * (x[force.position + i] + end[force.position + i]);
        if (!decay->gradient(m.data(), middle, u.data())) return false;
        decay->bracket(u.data(), m.data(), k.data());
        decay->bracket(u.data(), k.data(), rest.data());
        return true;
    }

    // Solve (1 - c A) y = `change`, or with the transpose, for the derivative A of the field. One correction removes what is
    // left.
    bool solve(bool transposed) {
        const auto operate = [&](const double* d, double* out) {
            transposed ? pull_field(d, out) : push_field(d, out);
            for (int64_t i = 0; i < n; ++i) out[i] = fma(-c, out[i], d[i]);
        };
        const std::vector<double> right = change;
        if (!krylov.solve(change.data(), Krylov::Operate(operate))) return false;
        operate(change.data(), image.data());
        std::vector<double> left(n);
        for (int64_t i = 0; i < n; ++i) left[i] = right[i] - image[i];
        if (!krylov.solve(left.data(), Krylov::Operate(operate))) return false;
        for (int64_t i = 0; i < n; ++i) change[i] += left[i];
        return finite(n, change.data());
    }

    // out = [u, [u, d]] + [u, [s, m]] + [s, [u, m]] with s = H''(m) d.
    void push_field(const double* d, double* out) {
        hessian(d, slope.data());
        of_slope(slope.data(), out);
        decay->bracket(u.data(), d, a.data());
        decay->bracket(u.data(), a.data(), b.data());
        for (int64_t i = 0; i < n; ++i) out[i] += b[i];
    }

    // Brackets are antisymmetric, and H'' is symmetric.
    void pull_field(const double* d, double* out) {
        of_slope_transposed(d, slope.data());
        hessian(slope.data(), out);
        decay->bracket(u.data(), d, a.data());
        decay->bracket(u.data(), a.data(), b.data());
        for (int64_t i = 0; i < n; ++i) out[i] += b[i];
    }

    // out = [u, [s, m]] + [s, k]
    void of_slope(const double* s, double* out) {
        decay->bracket(s, m.data(), a.data());
        decay->bracket(u.data(), a.data(), out);
        decay->bracket(s, k.data(), a.data());
        for (int64_t i = 0; i < n; ++i) out[i] += a[i];
    }

    // out = [k, d] - [m, [u, d]]
    void of_slope_transposed(const double* d, double* out) {
        decay->bracket(u.data(), d, a.data());
        decay->bracket(m.data(), a.data(), b.data());
        decay->bracket(k.data(), d, out);
        for (int64_t i = 0; i < n; ++i) out[i] -= b[i];
    }

    // out = H''(m) d, of functions by their own second derivatives.
    void hessian(const double* d, double* out) {
        if (force.extent) return decay->hessian(m.data(), d, middle, out);
        std::fill_n(out, n, 0.0);
        for (int64_t term = 0; term < field.terms.size; ++term)
            each_second_derivative(field.terms, SharedConstants{}, table.hessians, term, m.data(), middle, seconds, false,
                                   [&](int64_t place, uint32_t coordinate, double number, const auto& product) {
                                       double& to = out[field.terms.target[place]];
                                       to = fma(product(number), d[coordinate], to);
                                   });
    }

    // Visit what the gradient at the midpoint changes by moved parameters, in each number; false if it is not defined.
    template <class Visit>
    bool each_moved(const Visit& visit) {
        for (size_t j = 0; j < nearby.size(); ++j) {
            if (!nearby[j]->gradient(m.data(), middle, image.data())) return false;
            const int64_t k = int64_t(j) / NODES;
            const double weight = difference_weight(int64_t(j) % NODES) / table.distance[k];
            for (int64_t i = 0; i < n; ++i) visit(k, i, weight * image[i]);
        }
        return true;
    }

    template <class Visit>
    void each_added(const Visit& visit) {
        for (int64_t term = 0; term < table.added.size; ++term)
            each_coefficient(table.added, SharedConstants{}, table.functions, term, m.data(), middle, of_added,
                             [&](int64_t index, int64_t place, double factor) {
                                 visit(index, int64_t(table.added.target[place]), factor);
                             });
    }
};

}  // namespace coadjoint
