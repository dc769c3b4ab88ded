// Derivatives of the flow of a damping along coadjoint orbits with its noise: exponentials exp(D_v) x, D_v x = sign J(x) v,
// of which the middle one solves the midpoint rule, v = tau P sign J(m) grad H(m) at m = exp(D_v / 2) x. Those of spins with
// `extent` have the metric divided by the length of each spin, the noise by its root, and `turning` grad H in v too.
#pragma once

#include <optional>

#include "forces/force.hpp"
#include "tangents/second_derivatives.hpp"

namespace coadjoint {

// y = exp(D_v) x for the derivatives of y by x and v: rotations of spins in closed form, or else a series in substeps, which
// are kept.
class Exponential {
  public:
    std::vector<double> v, end;

    Exponential(const Field& field, const Spins* spins)
        : v(field.size), end(field.size), spins(spins), field(field), n(field.size), sums(n), one(n), two(n) {}

    // False if it is not defined, or too long.
    bool of(const double* direction, double factor, const double* x) {
        for (int64_t i = 0; i < n; ++i) v[i] = factor * direction[i];
        return spins ? rotate(x) : sum_series(x);
    }

  private:
    // The rotation of a spin by w = turn v: y = x + first A x + second A A x with A x = x cross w, and the mean of its part
    // until now, 1 + second A + third A A, by which a change of w turns y.
    struct Turning {
        double w[3], first, second, third, by;  // w is `by` v
    };

    template <class Visit>
    INLINE void each_turning(const Visit& visit) const {
        const auto& at = spins->coordinate;
        for (int64_t s = 0; s < spins->size(); ++s) visit(turnings[s], at[0][s], at[1][s], at[2][s]);
    }

    bool rotate(const double* x) {
        turnings.resize(spins->size());
        std::copy_n(x, n, end.data());
        InterruptCheck::of_this_call().after(64 * n);
        for (int64_t s = 0; s < spins->size(); ++s) {
            Turning& one = turnings[s];
            double from[3], across[3], back[3];
            one.by = spins->turn[s];
            for (int a = 0; a < 3; ++a) {
                one.w[a] = spins->turn[s] * v[spins->coordinate[a][s]];
                from[a] = x[spins->coordinate[a][s]];
            }
            const double square = fma(one.w[0], one.w[0], fma(one.w[1], one.w[1], one.w[2] * one.w[2]));
            if (!(square - square == 0.0)) return false;
            find_turning(square, one);
            cross_of(from, one.w, across);
            cross_of(across, one.w, back);
            for (int a = 0; a < 3; ++a)
                end[spins->coordinate[a][s]] = from[a] + fma(one.first, across[a], one.second * back[a]);
        }
        return true;
    }

    static void find_turning(double square, Turning& one) {
        one.first = one.second = one.third = 0.0;
        if (square <= SMALL_SQUARE) {
            for (int k = 4; k >= 0; --k) {
                one.first = fma(-square, one.first, INVERSE_FACTORIALS[2 * k + 1].high);
                one.second = fma(-square, one.second, INVERSE_FACTORIALS[2 * k + 2].high);
                one.third = fma(-square, one.third, INVERSE_FACTORIALS[2 * k + 3].high);
            }
            return;
        }
        const double angle = std::sqrt(square);
        const Rotation<double> rotation = rotation_by(angle);
        one.first = rotation.sine / angle;
        one.second = -(rotation.cosm1 / square);
        one.third = (1.0 - one.first) / square;
    }

    bool sum_series(const double* x) {
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

  public:
    // Replace the tangent of x by that of y, where v has the tangent dv.
    void push(const double* dv, double* dx) {
        if (spins) return push_state(dx), push_direction(dv, dx);
        std::vector<double> &change = one, &next = two;
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
        if (spins) return pull_direction(row, of_v), pull_state(row);
        std::fill_n(of_v, n, 0.0);
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
        if (spins) return add_crosses(x, w, factor, out);
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[i] = fma(constant * x[state], factor * w[column], out[i]);
        });
    }

    // out += factor D_w^T row
    void add_transposed(const double* w, const double* row, double factor, double* out) const {
        if (spins) return add_crosses(w, row, factor, out);
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[state] = fma(constant * w[column], factor * row[i], out[state]);
        });
    }

    // out += factor times the cotangent of w for a cotangent of D_w x
    void add_of_direction(const double* x, const double* row, double factor, double* out) const {
        if (spins) return add_crosses(row, x, factor, out);
        each_product([&](int64_t i, uint32_t state, uint32_t column, double constant) {
            out[column] = fma(constant * x[state], factor * row[i], out[column]);
        });
    }

    // Of spins: `push` with no change of v, then what is added by it; the cotangent of v, then that of x alone.
    void push_state(double* dx) const {
        each_turning([&](const Turning& one, int64_t i, int64_t j, int64_t k) {
            double change[] = {dx[i], dx[j], dx[k]};
            turn(one.w, 1.0, one.first, one.second, change);
            dx[i] = change[0], dx[j] = change[1], dx[k] = change[2];
        });
    }

    void push_direction(const double* dv, double* dx) const {
        each_turning([&](const Turning& one, int64_t i, int64_t j, int64_t k) {
            double about[] = {one.by * dv[i], one.by * dv[j], one.by * dv[k]}, across[3];
            const double y[] = {end[i], end[j], end[k]};
            turn(one.w, 1.0, one.second, one.third, about);
            cross_of(y, about, across);
            dx[i] += across[0], dx[j] += across[1], dx[k] += across[2];
        });
    }

    void pull_direction(const double* row, double* of_v) const {
        each_turning([&](const Turning& one, int64_t i, int64_t j, int64_t k) {
            const double of_end[] = {row[i], row[j], row[k]}, y[] = {end[i], end[j], end[k]};
            double about[3];
            cross_of(of_end, y, about);
            turn(one.w, -1.0, one.second, one.third, about);
            of_v[i] = one.by * about[0], of_v[j] = one.by * about[1], of_v[k] = one.by * about[2];
        });
    }

    void pull_state(double* row) const {
        each_turning([&](const Turning& one, int64_t i, int64_t j, int64_t k) {
            double of_end[] = {row[i], row[j], row[k]};
            turn(one.w, -1.0, one.first, one.second, of_end);
            row[i] = of_end[0], row[j] = of_end[1], row[k] = of_end[2];
        });
    }

  private:
    static constexpr double LEAST_TERM = 0x1p-60;  // of a term that is left out, relative to x
    static constexpr double SMALL_SQUARE = 0x1p-6;  // squares of angles up to this one have a series
    const Spins* const spins;
    const Field& field;
    const int64_t n;
    int64_t substeps = 1, degree = 1;
    std::vector<double> sums, terms, one, two;
    std::vector<Turning> turnings;

    // out += factor turn a cross b, of which the products with D_w and its transpose are cases.
    void add_crosses(const double* a, const double* b, double factor, double* out) const {
        for (int64_t s = 0; s < spins->size(); ++s) {
            const int64_t i = spins->coordinate[0][s], j = spins->coordinate[1][s], k = spins->coordinate[2][s];
            const double by = factor * spins->turn[s];
            out[i] = fma(by, fma(a[j], b[k], -(a[k] * b[j])), out[i]);
            out[j] = fma(by, fma(a[k], b[i], -(a[i] * b[k])), out[j]);
            out[k] = fma(by, fma(a[i], b[j], -(a[j] * b[i])), out[k]);
        }
    }

    // u + first A u + second A A u for A u = u cross w, with minus w of the transpose.
    INLINE static void turn(const double* w, double sign, double first, double second, double* u) {
        double across[3], back[3];
        cross_of(u, w, across);
        cross_of(across, w, back);
        for (int a = 0; a < 3; ++a) u[a] += fma(sign * first, across[a], second * back[a]);
    }

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

constexpr double SETTLED = 0x1p-50;  // relative change that is round-off

// Improve numbers by a fixed-point iteration until the next change, which falls as the last ones did, is round-off, or changes
// near round-off no longer fall. Return the last change relative to their size, that of the
// numbers and `least`, or nothing if a step is false or there is no end.
template <class Improve>
std::optional<double> iterate(double* now, int64_t count, std::vector<double>& before, const Improve& improve, double least = 0.0) {
    constexpr int64_t MOST_ITERATIONS = 192;
    constexpr double NEAR_ROUND_OFF = 0x1p-40, FAST = 0x1p-3;
    double last = std::numeric_limits<double>::infinity(), fall_before = 1.0;
    for (int64_t k = 0; k < MOST_ITERATIONS; ++k) {
        before.assign(now, now + count);
        if (!improve()) return {};
        double change = 0.0, size = least;
        for (int64_t i = 0; i < count; ++i) {
            change += absolute(now[i] - before[i]);
            size += absolute(now[i]);
        }
        // The slower of the last two falls, so that a part that falls fast does not hide another one.
        const double fall = k > 0 ? change / last : 1.0, falls = std::max(fall, fall_before);
        if (!(change > SETTLED * size) || (falls <= FAST && change * falls <= SETTLED * size) ||
            (change >= 0.5 * last && change <= NEAR_ROUND_OFF * size)) return change > 0.0 ? change / size : 0.0;
        last = change, fall_before = fall;
    }
    return {};
}

template <class Improve>
std::optional<double> iterate(std::vector<double>& now, std::vector<double>& before, const Improve& improve) {
    return iterate(now.data(), int64_t(now.size()), before, improve);
}

class OrbitDerivative {
  public:
    OrbitDerivative(const ForceTable& force, const Field& field, const ForceDerivatives& table)
        : force(force), field(field), table(table), n(field.size), of_spins(spins.find(field, MemberConstants{1, 0})),
          adds(force.extent == 1), first_added((adds ? 3 : 2) * n), fields(field), workspace(field.terms),
          of_added(table.added), half(field, of_spins ? &spins : nullptr), v(n), row(n), other(n), gradients(n), middle(n),
          deviates(n), driven(n), of_v(n), first(n), before(n), through(n), of_gradient(n), dv(n), dm(n), dg(n), now(n),
          inverse(n, 1.0), of_length(n) {}

    // The coefficients are logarithms of the noise, and of the damping, by coordinate, with `adds` the rates and the
    // `turning` themselves, and those of the terms of the derivative of H.

    // Replace vectors at a state by their tangents after the flow, whose midpoint may be `known`, along directions of the
    // coefficients; false if a series is too long, or an iteration does not converge.
    bool push(const double* x, const double* end, const double* known, double t, double tau, int64_t member, double* vectors,
              int64_t vectors_count, const double* directions, int64_t stride) {
        if (!find(x, end, known, t, tau, member)) return false;
        for (int64_t r = 0; r < vectors_count; ++r) {
            double* const dx = vectors + r * n;
            const double* const along = directions + r * stride;
            if (adds) find_change_of_length(x, dx);
            for (size_t e = 0; e < exponentials.size(); ++e) {
                Exponential& one = *exponentials[e];
                if (int64_t(e) != damping) {
                    for (int64_t i = 0; i < n; ++i) dv[i] = (along[i] + 0.5 * of_length[i]) * one.v[i];
                    one.push(dv.data(), dx);
                    continue;
                }
                // What does not depend on the change of the midpoint.
                std::fill(dg.begin(), dg.end(), 0.0);
                each_added(t + 0.5 * tau, [&](int64_t index, int64_t coordinate, double factor) {
                    dg[coordinate] = fma(factor, along[first_added + index], dg[coordinate]);
                });
                std::fill(other.begin(), other.end(), 0.0);
                half.add_move(dg.data(), middle.data(), tau, other.data());
                direction_of(other.data(), dg.data(), tau, first.data());
                for (int64_t i = 0; i < n; ++i) {
                    first[i] += along[n + i] * (adds ? driven[i] : one.v[i]);
                    if (adds) first[i] += rate(i) * driven[i] * of_length[i] + tau * along[2 * n + i] * gradients[i];
                }
                std::fill(dv.begin(), dv.end(), 0.0);
                std::copy_n(dx, n, row.data());
                if (of_spins) half.push_state(row.data());
                const auto change = iterate(dv, before, [&] {
                    dm = row;
                    for (double& entry : dv) entry *= 0.5;
                    of_spins ? half.push_direction(dv.data(), dm.data()) : half.push(dv.data(), dm.data());
                    hessian(t + 0.5 * tau, dm.data(), dg.data());
                    std::fill(other.begin(), other.end(), 0.0);
                    half.add_move(gradients.data(), dm.data(), tau, other.data());
                    half.add_move(dg.data(), middle.data(), tau, other.data());
                    direction_of(other.data(), dg.data(), tau, dv.data());
                    for (int64_t i = 0; i < n; ++i) dv[i] += first[i];
                    return true;
                });
                if (!change) return false;
                one.push(dv.data(), dx);
            }
        }
        return true;
    }

    // Replace the cotangent of the state after the flow by that before, and add those of the coefficients.
    bool pull(const double* x, const double* end, const double* known, double t, double tau, int64_t member,
              double* cotangent, double* by_coefficients) {
        if (!find(x, end, known, t, tau, member)) return false;
        std::fill(of_length.begin(), of_length.end(), 0.0);
        for (size_t e = exponentials.size(); e-- > 0;) {
            Exponential& one = *exponentials[e];
            one.pull(cotangent, of_v.data());
            if (int64_t(e) != damping) {
                for (int64_t i = 0; i < n; ++i) {
                    const double scaled = of_v[i] * one.v[i];
                    by_coefficients[i] += scaled;
                    of_length[i] = fma(0.5, scaled, of_length[i]);
                }
                continue;
            }
            first = of_v;
            const auto change = iterate(of_v, before, [&] {
                of_middle(t + 0.5 * tau, tau, of_v.data(), of_gradient.data(), through.data());
                of_spins ? half.pull_direction(through.data(), row.data()) : half.pull(through.data(), row.data());
                for (int64_t i = 0; i < n; ++i) of_v[i] = fma(0.5, row[i], first[i]);
                return true;
            });
            if (!change) return false;
            if (of_spins) half.pull_state(through.data());
            // The last `through` is as accurate as `of_v`, which follows from it.
            for (int64_t i = 0; i < n; ++i) cotangent[i] += through[i];
            each_added(t + 0.5 * tau, [&](int64_t index, int64_t coordinate, double factor) {
                double& to = by_coefficients[first_added + index];
                to = fma(factor, of_gradient[coordinate], to);
            });
            for (int64_t i = 0; i < n; ++i) {
                double& by_damping = by_coefficients[n + i];
                by_damping = fma(of_v[i], adds ? driven[i] : one.v[i], by_damping);
                if (!adds) continue;
                of_length[i] += of_v[i] * rate(i) * driven[i];
                by_coefficients[2 * n + i] += tau * of_v[i] * gradients[i];
            }
        }
        if (adds) add_of_lengths(x, cotangent);
        return true;
    }

  private:
    const ForceTable& force;
    const Field& field;
    const ForceDerivatives& table;
    const int64_t n;
    Spins spins;
    const bool of_spins, adds;
    const int64_t first_added;
    FieldWorkspace<double> fields;
    HessianWorkspace<double> workspace, of_added;
    std::vector<std::unique_ptr<Exponential>> pool;
    std::vector<Exponential*> exponentials;  // in their order, of which `damping` is the midpoint rule
    int64_t damping = 0;
    Exponential half;  // from x to the midpoint
    // `driven` is J(m) grad H(m), with the time and the `inverse` lengths of spins.
    std::vector<double> v, row, other, gradients, middle, deviates, driven, of_v, first, before, through, of_gradient, dv, dm,
        dg, now, inverse, of_length;

    Exponential& next() {
        if (exponentials.size() == pool.size()) pool.emplace_back(new Exponential(field, of_spins ? &spins : nullptr));
        exponentials.push_back(pool[exponentials.size()].get());
        return *exponentials.back();
    }

    bool find(const double* x, const double* end, const double* known, double t, double tau, int64_t member) {
        exponentials.clear();
        const bool random = force.amplitude[0] > 0.0;
        if (adds) find_lengths(x);
        std::copy_n(x, n, now.data());
        if (random && !shake(now, t, tau, 0, member)) return false;
        damping = int64_t(exponentials.size());
        for (int64_t i = 0; i < n; ++i) middle[i] = known ? known[i] : random ? now[i] : 0.5 * (x[i] + end[i]);
        if (!settle(now, t, tau)) return false;
        return !random || shake(now, t, tau, 1, member);
    }

    // The inverse lengths of spins, by coordinate; zero for those that are zero, and for other coordinates.
    void find_lengths(const double* x) {
        std::fill(inverse.begin(), inverse.end(), 0.0);
        each_spin([&](int64_t i, int64_t j, int64_t k) {
            const double square = fma(x[i], x[i], fma(x[j], x[j], x[k] * x[k]));
            inverse[i] = inverse[j] = inverse[k] = square > 0.0 ? 1.0 / std::sqrt(square) : 0.0;
        });
    }

    // The logarithmic change of the inverse lengths along dx, and the cotangent of x by those of them.
    void find_change_of_length(const double* x, const double* dx) {
        each_spin([&](int64_t i, int64_t j, int64_t k) {
            const double product = fma(x[i], dx[i], fma(x[j], dx[j], x[k] * dx[k]));
            of_length[i] = of_length[j] = of_length[k] = -(inverse[i] * inverse[i] * product);
        });
    }

    void add_of_lengths(const double* x, double* cotangent) const {
        each_spin([&](int64_t i, int64_t j, int64_t k) {
            const double sum = -(inverse[i] * inverse[i] * (of_length[i] + of_length[j] + of_length[k]));
            for (const int64_t at : {i, j, k}) cotangent[at] = fma(sum, x[at], cotangent[at]);
        });
    }

    template <class Visit>
    void each_spin(const Visit& visit) const {
        for (int64_t s = 0; s < spins.size(); ++s)
            visit(spins.coordinate[0][s], spins.coordinate[1][s], spins.coordinate[2][s]);
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
            for (int64_t i = 0; adds && i < n; ++i) v[i] *= std::sqrt(inverse[i]);
            Exponential& one = next();
            if (!one.of(v.data(), 1.0, x.data())) return false;
            x = one.end;
        }
        return true;
    }

    // As `Force::settle`, from a first midpoint on, with the midpoint and the gradient there.
    bool settle(std::vector<double>& x, double t, double tau) {
        const auto change = iterate(middle, before, [&] {
            slope_at(field, SharedConstants{}, middle.data(), t + 0.5 * tau, tau, gradients.data(), other.data(), fields);
            direction_of(other.data(), gradients.data(), tau, v.data());
            if (!half.of(v.data(), 0.5, x.data())) return false;
            middle = half.end;
            return true;
        });
        if (!change) return false;
        if (!(*change <= SETTLED)) slope_at(field, SharedConstants{}, middle.data(), t + 0.5 * tau, tau, gradients.data(), other.data(), fields);
        for (int64_t i = 0; i < n; ++i) driven[i] = inverse[i] * other[i];
        Exponential& whole = next();
        if (!whole.of(v.data(), 1.0, x.data())) return false;
        x = whole.end;
        return true;
    }

    double rate(int64_t i) const { return force.rate[force.shape == DIAGONAL ? i : 0]; }

    // Set out to P y, with the gradient that is added.
    void direction_of(const double* y, const double* gradient, double tau, double* out) const {
        metric(y, out);
        for (int64_t i = 0; adds && i < n; ++i) out[i] = fma(tau * force.turning[i], gradient[i], out[i]);
    }

    void metric(const double* y, double* out) const {
        for (int64_t i = 0; i < n; ++i) {
            if (force.shape != FULL) {
                out[i] = rate(i) * inverse[i] * y[i];
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
        for (int64_t i = 0; adds && i < n; ++i) of_gradient[i] = fma(tau * force.turning[i], of_v[i], of_gradient[i]);
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
