// Derivatives of the flow of a damping along coadjoint orbits with its noise: exponentials exp(D_v) x, D_v x = sign J(x) v,
// of which the middle one solves the midpoint rule, v = tau P sign J(m) grad H(m) at m = exp(D_v / 2) x.
#pragma once

#include "forces/force.hpp"
#include "tangents/second_derivatives.hpp"

namespace coadjoint {

// y = exp(D_v) x by a series in substeps, which are kept for the derivatives of y by x and v.
class Exponential {
  public:
    std::vector<double> v, end;

    explicit Exponential(const Field& field) : v(field.size), end(field.size), field(field), n(field.size), sums(n) {}

    // False if it is not defined, or too long.
    bool of(const double* direction, double factor, const double* x) {
        for (int64_t i = 0; i < n; ++i) v[i] = factor * direction[i];
        double norm = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                sum += absolute(field.constant[q] * v[field.column[q]]);
            norm = larger(norm, sum);
        }
        if (!(norm <= double(MOST_SUBSTEPS))) return false;
        substeps = std::max<int64_t>(1, int64_t(std::ceil(norm)));
        const double theta = norm / double(substeps);
        degree = 1;
        for (double term = theta; term > LEAST_TERM; term *= theta / double(degree)) ++degree;
        InterruptCheck::of_this_call().after(substeps * degree * work_of(field));
        terms.resize(substeps * degree * n);
        std::copy_n(x, n, end.data());
        for (int64_t s = 0; s < substeps; ++s) {
            double* const first = term(s, 0);
            std::copy_n(end.data(), n, first);
            for (int64_t k = 1; k < degree; ++k) {
                move(v.data(), term(s, k - 1), 1.0 / double(k * substeps), term(s, k));
                for (int64_t i = 0; i < n; ++i) end[i] += term(s, k)[i];
            }
        }
        return true;
    }

    // Replace the tangent of x by that of y, where v has the tangent dv.
    void push(const double* dv, double* dx) {
        std::vector<double> &change = one, &next = two;
        change.resize(n), next.resize(n);
        for (int64_t s = 0; s < substeps; ++s) {
            std::copy_n(dx, n, change.data());
            for (int64_t k = 1; k < degree; ++k) {
                const double by = 1.0 / double(k * substeps);
                move(v.data(), change.data(), by, next.data());
                add_move(dv, term(s, k - 1), by, next.data());
                change.swap(next);
                for (int64_t i = 0; i < n; ++i) dx[i] += change[i];
            }
        }
    }

    // Replace the cotangent of y by that of x, and set that of v.
    void pull(double* row, double* of_v) {
        std::fill_n(of_v, n, 0.0);
        one.resize(degree * n), two.resize(n);
        for (int64_t s = substeps; s-- > 0;) {
            // The cotangents of the terms, from the last one on.
            std::vector<double>& carried = two;
            std::copy_n(row, n, carried.data());
            for (int64_t k = degree - 1; k > 0; --k) {
                const double by = 1.0 / double(k * substeps);
                sums.assign(n, 0.0);
                const double* before = term(s, k - 1);
                each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
                    sums[state] = fma(constant * v[column], by * carried[i], sums[state]);
                    of_v[column] = fma(constant * before[state], by * carried[i], of_v[column]);
                });
                for (int64_t i = 0; i < n; ++i) carried[i] = row[i] + sums[i];
            }
            std::copy_n(carried.data(), n, row);
        }
    }

    // out += factor D_w x
    void add_move(const double* w, const double* x, double factor, double* out) const {
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[i] = fma(constant * x[state], factor * w[column], out[i]);
        });
    }

    // out += factor D_w^T row
    void add_transposed(const double* w, const double* row, double factor, double* out) const {
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[state] = fma(constant * w[column], factor * row[i], out[state]);
        });
    }

    // out += factor times the cotangent of w for a cotangent of D_w x
    void add_of_direction(const double* x, const double* row, double factor, double* out) const {
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[column] = fma(constant * x[state], factor * row[i], out[column]);
        });
    }

  private:
    static constexpr double LEAST_TERM = 0x1p-60;  // of a term that is left out, relative to x
    const Field& field;
    const int64_t n;
    int64_t substeps = 1, degree = 1;
    std::vector<double> sums, terms, one, two;

    double* term(int64_t s, int64_t k) { return terms.data() + (s * degree + k) * n; }

    void move(const double* w, const double* x, double factor, double* out) const {
        std::fill_n(out, n, 0.0);
        add_move(w, x, factor, out);
    }

    template <class Visit>
    void each_product(const Visit& visit) const {
        for (int64_t i = 0; i < n; ++i)
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                visit(i, field.state[q], field.column[q], field.constant[q]);
    }
};

class OrbitDerivative {
  public:
    OrbitDerivative(const ForceTable& force, const Field& field, const ForceDerivatives& table)
        : force(force), field(field), table(table), n(field.size), fields(field), workspace(field.terms),
          of_added(table.added), half(field), v(n), row(n), other(n), gradients(n), middle(n), deviates(n) {}

    // The coefficients of the noise and of the damping, by coordinate, and of the terms of the derivative of H.
    static int64_t count(const ForceDerivatives& table, int64_t n) {
        return 2 * n + coefficients_of(table.added);
    }

    // Replace vectors at a state by their tangents after the flow, along directions of the coefficients; false if a series
    // is too long, or an iteration does not converge.
    bool push(const double* x, double t, double tau, int64_t member, double* vectors, int64_t vectors_count,
              const double* directions, int64_t stride) {
        if (!find(x, t, tau, member)) return false;
        std::vector<double> dv(n), dm(n), dg(n), explicit_part(n), before(n);
        for (int64_t r = 0; r < vectors_count; ++r) {
            double* const dx = vectors + r * n;
            const double* const along = directions + r * stride;
            for (size_t e = 0; e < exponentials.size(); ++e) {
                Exponential& one = *exponentials[e];
                if (int64_t(e) != damping) {
                    for (int64_t i = 0; i < n; ++i) dv[i] = along[i] * one.v[i];
                    one.push(dv.data(), dx);
                    continue;
                }
                // What does not depend on the change of the midpoint.
                std::fill(dg.begin(), dg.end(), 0.0);
                each_added(t + 0.5 * tau, [&](int64_t index, int64_t coordinate, double factor) {
                    dg[coordinate] = fma(factor, along[2 * n + index], dg[coordinate]);
                });
                std::fill(other.begin(), other.end(), 0.0);
                half.add_move(dg.data(), middle.data(), tau, other.data());
                metric(other.data(), explicit_part.data());
                for (int64_t i = 0; i < n; ++i) explicit_part[i] += along[n + i] * one.v[i];
                std::fill(dv.begin(), dv.end(), 0.0);
                double last = std::numeric_limits<double>::infinity();
                for (int64_t k = 0; k < MOST_ITERATIONS; ++k) {
                    before = dv;
                    std::copy_n(dx, n, dm.data());
                    for (double& entry : dv) entry *= 0.5;
                    half.push(dv.data(), dm.data());
                    hessian(t + 0.5 * tau, dm.data(), dg.data());
                    std::fill(other.begin(), other.end(), 0.0);
                    half.add_move(gradients.data(), dm.data(), tau, other.data());
                    half.add_move(dg.data(), middle.data(), tau, other.data());
                    metric(other.data(), dv.data());
                    for (int64_t i = 0; i < n; ++i) dv[i] += explicit_part[i];
                    if (settled(dv, before, last)) break;
                }
                one.push(dv.data(), dx);
            }
        }
        return true;
    }

    // Replace the cotangent of the state after the flow by that before, and add those of the coefficients.
    bool pull(const double* x, double t, double tau, int64_t member, double* cotangent, double* by_coefficients) {
        if (!find(x, t, tau, member)) return false;
        std::vector<double> of_v(n), first(n), before(n), through(n), of_gradient(n);
        for (size_t e = exponentials.size(); e-- > 0;) {
            Exponential& one = *exponentials[e];
            one.pull(cotangent, of_v.data());
            double* const scales = by_coefficients + (int64_t(e) == damping ? n : 0);
            if (int64_t(e) == damping) {
                first = of_v;
                double last = std::numeric_limits<double>::infinity();
                for (int64_t k = 0; k < MOST_ITERATIONS; ++k) {
                    before = of_v;
                    of_middle(t + 0.5 * tau, tau, of_v.data(), of_gradient.data(), through.data());
                    half.pull(through.data(), row.data());
                    for (int64_t i = 0; i < n; ++i) of_v[i] = fma(0.5, row[i], first[i]);
                    if (settled(of_v, before, last)) break;
                }
                of_middle(t + 0.5 * tau, tau, of_v.data(), of_gradient.data(), through.data());
                half.pull(through.data(), row.data());
                for (int64_t i = 0; i < n; ++i) cotangent[i] += through[i];
                each_added(t + 0.5 * tau, [&](int64_t index, int64_t coordinate, double factor) {
                    by_coefficients[2 * n + index] = fma(factor, of_gradient[coordinate], by_coefficients[2 * n + index]);
                });
            }
            for (int64_t i = 0; i < n; ++i) scales[i] = fma(of_v[i], one.v[i], scales[i]);
        }
        return true;
    }

  private:
    static constexpr int64_t MOST_ITERATIONS = 192;
    static constexpr double SETTLED = 0x1p-50, NEAR_ROUND_OFF = 0x1p-40;
    const ForceTable& force;
    const Field& field;
    const ForceDerivatives& table;
    const int64_t n;
    FieldWorkspace<double> fields;
    HessianWorkspace<double> workspace, of_added;
    std::vector<std::unique_ptr<Exponential>> pool;
    std::vector<Exponential*> exponentials;  // in their order, of which `damping` is the midpoint rule
    int64_t damping = 0;
    Exponential half;  // from x to the midpoint
    std::vector<double> v, row, other, gradients, middle, deviates;

    static int64_t coefficients_of(const Terms& terms) {
        const int64_t rows = terms.row[terms.size];
        return rows + terms.entry[rows] + terms.monomial[terms.size];
    }

    Exponential& next() {
        if (exponentials.size() == pool.size()) pool.emplace_back(new Exponential(field));
        exponentials.push_back(pool[exponentials.size()].get());
        return *exponentials.back();
    }

    bool find(const double* x, double t, double tau, int64_t member) {
        exponentials.clear();
        const bool random = force.amplitude[0] > 0.0;
        std::vector<double> now(x, x + n);
        if (random && !shake(now, t, tau, 0, member)) return false;
        damping = int64_t(exponentials.size());
        if (!settle(now, t, tau)) return false;
        return !random || shake(now, t, tau, 1, member);
    }

    // As `Force::shake`.
    bool shake(std::vector<double>& x, double t, double tau, int half_of_noise, int64_t member) {
        const double size = force.amplitude[0] * std::sqrt(0.5 * tau);
        DeviateStream(uint64_t(force.seed), uint64_t(force.stream + member), t, uint64_t(half_of_noise))
            .fill(n, deviates.data());
        for (int64_t k = 0; k < force.sets; ++k) {
            const int64_t set = half_of_noise ? force.sets - 1 - k : k;
            std::fill(v.begin(), v.end(), 0.0);
            for (int64_t e = force.begin[set]; e < force.begin[set + 1]; ++e) {
                const int64_t a = force.direction[e];
                const double length = size * deviates[a];
                if (force.shape == FULL)
                    for (int64_t i = a; i < n; ++i) v[i] = fma(force.aim[i * n + a], length, v[i]);
                else
                    v[a] = force.aim[force.shape == DIAGONAL ? a : 0] * length;
            }
            Exponential& one = next();
            if (!one.of(v.data(), 1.0, x.data())) return false;
            x = one.end;
        }
        return true;
    }

    // As `Force::settle`, with the midpoint and the gradient there.
    bool settle(std::vector<double>& x, double t, double tau) {
        std::copy_n(x.data(), n, middle.data());
        std::vector<double> before(n);
        double last = std::numeric_limits<double>::infinity();
        for (int64_t k = 0; k < MOST_ITERATIONS; ++k) {
            slope_at(field, SharedConstants{}, middle.data(), t + 0.5 * tau, tau, gradients.data(), other.data(), fields);
            metric(other.data(), v.data());
            before = middle;
            if (!half.of(v.data(), 0.5, x.data())) return false;
            middle = half.end;
            if (settled(middle, before, last)) break;
        }
        gradient(field, SharedConstants{}, middle.data(), t + 0.5 * tau, gradients.data(), fields);
        Exponential& whole = next();
        if (!whole.of(v.data(), 1.0, x.data())) return false;
        x = whole.end;
        return true;
    }

    // Whether an iteration ends: its changes are round-off, and no longer fall.
    bool settled(const std::vector<double>& now, const std::vector<double>& before, double& last) const {
        double change = 0.0, size = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            change += absolute(now[i] - before[i]);
            size += absolute(now[i]);
        }
        const bool ends = !(change > SETTLED * size) || (change >= 0.5 * last && change <= NEAR_ROUND_OFF * size);
        last = change;
        return ends;
    }

    // Set out to P y.
    void metric(const double* y, double* out) const {
        for (int64_t i = 0; i < n; ++i) {
            if (force.shape != FULL) {
                out[i] = force.rate[force.shape == DIAGONAL ? i : 0] * y[i];
                continue;
            }
            double sum = 0.0;
            for (int64_t j = 0; j < n; ++j) sum = fma(force.rate[i * n + j], y[j], sum);
            out[i] = sum;
        }
    }

    // The cotangents of the gradient and of the midpoint for that of v.
    void of_middle(double t, double tau, const double* of_v, double* of_gradient, double* of_midpoint) {
        metric(of_v, other.data());  // P is symmetric
        std::fill_n(of_gradient, n, 0.0);
        half.add_of_direction(middle.data(), other.data(), tau, of_gradient);
        hessian(t, of_gradient, of_midpoint);
        half.add_transposed(gradients.data(), other.data(), tau, of_midpoint);
    }

    // Set out to the second derivative of H at the midpoint times y; it is symmetric.
    void hessian(double t, const double* y, double* out) {
        std::fill_n(out, n, 0.0);
        for (int64_t k = 0; k < field.terms.size; ++k)
            each_second_derivative(field.terms, SharedConstants{}, table.hessians, k, middle.data(), t, workspace, false,
                                   [&](int64_t place, uint32_t coordinate, double number, const auto& product) {
                                       double& to = out[field.terms.target[place]];
                                       to = fma(product(number), y[coordinate], to);
                                   });
    }

    // Visit the derivatives of the gradient at the midpoint by the coefficients of the derivative of H.
    template <class Visit>
    void each_added(double t, const Visit& visit) {
        for (int64_t k = 0; k < table.added.size; ++k)
            each_coefficient(table.added, SharedConstants{}, table.functions, k, middle.data(), t, of_added,
                             [&](int64_t index, int64_t place, double factor) {
                                 visit(index, int64_t(table.added.target[place]), factor);
                             });
    }
};

}  // namespace coadjoint
