// Fallbacks for the stages of one trajectory if the function iteration fails: Newton's method, and linear systems.
#pragma once

#include "field/derivatives.hpp"
#include "stages/newton.hpp"
#include "stages/runge_kutta.hpp"

namespace coadjoint {

constexpr double STEPS_OF_NEWTON = 64;  // after these the function iteration is tried again
constexpr int64_t LARGEST_FACTORED = 1024;  // unknowns of a column of the group element: half a second

// Scratch memory that few trajectories need.
template <class A>
struct LinearWorkspace {
    DerivativeWorkspace<A> derivatives;
    Krylov krylov;
    AlignedArray<A> input, output;
    std::vector<double> none;
    LinearWorkspace(const Field& field, int64_t stages, int64_t blocks, int64_t size)
        : derivatives(field), krylov(stages * size), input(blocks * size), output(blocks * size), none(size, 0.0) {}
};

template <class Layout>
struct SingleStages : Stages<Layout, SharedConstants> {
    typedef Stages<Layout, SharedConstants> Base;
    typedef typename Layout::A A;
    typedef Called<void()> Evaluate;
    typedef Called<void(LinearWorkspace<A>&, const A*, A*)> Multiply;
    using Base::matrices, Base::system, Base::pivots, Base::right, Base::group_direct;
    using Base::p, Base::g, Base::mix, Base::forecast, Base::gradients, Base::frozen, Base::times, Base::lengths;
    using Base::tables, Base::constants, Base::field, Base::group, Base::n, Base::s, Base::d, Base::blocks;
    using Base::taken, Base::evaluate_all, Base::settle_momentum, Base::settle_group, Base::evaluate_group;
    using Base::workspace, Base::trusted, Base::iterations, Base::residual, Base::solve, Base::begin, Base::save_slopes;

    SingleStages(const RungeKuttaTables& tables, const SharedConstants& constants) : Base(tables, constants) {}

    // Compute the slopes of a substep by one fallback after the other: starting at the base instead of an
    // extrapolation, by Newton's method or linear systems instead of function iteration. `newton` counts the further
    // steps that begin with these.
    bool solve_alone(double t, double h, int64_t part, double& newton) {
        if (tables.solver != IMPLICIT) {
            if (solve(t, h, part, true)) return true;
            return tables.solver >= STRUCTURE && !tables.direct && linear_by_systems();
        }
        begin(t, h);
        save_slopes();
        bool found = false;
        if (newton >= 1.0) {
            newton -= 1.0;
        } else {
            const bool ahead = all(p.start_extrapolated(forecast.at + part * blocks * s));
            found = settle_momentum(true, trusted.at[part], &trusted.at[part]);
            if (!found && ahead) {
                p.start_at_base();
                found = settle_momentum(true, 0.0, &trusted.at[part]);
            }
            newton = found ? 0.0 : STEPS_OF_NEWTON;
        }
        if (!found) {
            trusted.at[part] = 0.0;
            const double earlier = residual;
            p.start_at_base();
            found = by_newton();
            if (!found && all(p.start_extrapolated(forecast.at + part * blocks * s))) found = by_newton();
            if (!found && earlier != earlier) residual = earlier;
        }
        if (!found || d == 0) return found;
        g.start_extrapolated(forecast.at + part * blocks * s);
        return settle_group(true) || group_by_krylov() || group_by_factors();
    }

    // Factorize 1 - mix h scale times the Jacobian: at the base for all stages, or for every stage at its point.
    NOINLINE bool linearize(bool at_base, AlignedArray<double>& matrix, AlignedArray<double>& exchanged) {
        DerivativeWorkspace<double> derivatives(field);
        AlignedArray<double> point(n), u(n), unit(n), image(n), whole(n * n);
        const int64_t size = s * n;
        for (int64_t j = 0; j < s; ++j) {
            if (j == 0 || !at_base) {
                const double t = Layout::at(times.at, 1, 0, j);
                for (int64_t c = 0; c < n; ++c) point.at[c] = at_base ? p.base[c] : Layout::at(p.points.at, n, c, j);
                gradient(field, constants, point.at, t, u.at, derivatives.field);
                for (int64_t k = 0; k < n; ++k) {
                    unit.at[k] = 1.0;
                    jacobian_times(field, constants, point.at, u.at, unit.at, t, 1.0, image.at, derivatives);
                    unit.at[k] = 0.0;
                    for (int64_t i = 0; i < n; ++i) whole.at[i * n + k] = image.at[i];
                }
            }
            for (int64_t i = 0; i < s; ++i) {
                const double factor = -tables.mix[i * s + j] * Layout::at(lengths.at, 1, 0, j);
                for (int64_t a = 0; a < n; ++a)
                    for (int64_t b = 0; b < n; ++b)
                        matrix.at[(i * n + a) * size + j * n + b] =
                            fma(factor, whole.at[a * n + b], i == j && a == b ? 1.0 : 0.0);
            }
        }
        return factorize(matrix.at, size, exchanged.at);
    }

    NOINLINE bool by_newton() {
        const int64_t size = s * n;
        if (size > LARGEST_DENSE)
            return by_systems([&] { evaluate_all(); },
                              [&](LinearWorkspace<A>& linear, const A* v, A* out) {
                                  for (int64_t b = 0; b < blocks; ++b)
                                      jacobian_times(field, Layout::constants(constants, b, s), p.points.at + b * n,
                                                     gradients.at + b * n, v + b * n, times.at[b], lengths.at[b],
                                                     out + b * n, linear.derivatives);
                              });
        AlignedArray<double> matrix(size * size), exchanged(size);
        if (!linearize(true, matrix, exchanged)) return false;
        return taken(correct(p, [&] { evaluate_all(); },
                             [&](double* r) { return substitute(matrix.at, size, exchanged.at, r, 1), true; },
                             [&] { return linearize(false, matrix, exchanged); }));
    }

    // Large linear systems for the momentum: `multiply` applies the derivative of the slopes to changes of the points.
    bool by_systems(const Evaluate& evaluate, const Multiply& multiply) {
        return tables.band >= 0 ? by_band(evaluate, multiply) : by_krylov(p, evaluate, multiply);
    }

    // By factors, if coupled coordinates are close to each other in the order `position`. Columns without common rows
    // are computed by one multiplication.
    NOINLINE bool by_band(const Evaluate& evaluate, const Multiply& multiply) {
        const int64_t band = tables.band, groups = std::min(n, 2 * band + 1);
        LinearWorkspace<A> linear(field, 0, blocks, n);
        Banded matrix(s * n, s * (band + 1) - 1);
        std::vector<int64_t> coordinate(n);
        std::vector<double> sides(s * n);
        for (int64_t c = 0; c < n; ++c) coordinate[tables.position[c]] = c;
        bool stale = true;
        auto factors = [&] {
            std::fill(matrix.entries.begin(), matrix.entries.end(), 0.0);
            for (int64_t k = 0; k < s * n; ++k) matrix.at(k, k) = 1.0;
            for (int64_t start = 0; start < groups; ++start) {
                std::fill_n(linear.input.at, blocks * n, A(0.0));
                for (int64_t position = start; position < n; position += groups)
                    for (int64_t b = 0; b < blocks; ++b) linear.input.at[b * n + coordinate[position]] = A(1.0);
                multiply(linear, linear.input.at, linear.output.at);
                for (int64_t position = start; position < n; position += groups)
                    for (int64_t row = std::max<int64_t>(0, position - band); row < std::min(n, position + band + 1);
                         ++row)
                        for (int64_t j = 0; j < s; ++j) {
                            const double entry = Layout::at(linear.output.at, n, coordinate[row], j);
                            for (int64_t i = 0; i < s; ++i) {
                                double& here = matrix.at(row * s + i, position * s + j);
                                here = fma(-tables.mix[i * s + j], entry, here);
                            }
                        }
            }
            stale = false;
            return matrix.factorize();
        };
        auto solve = [&](double* r) {
            if (stale && !factors()) return false;
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < n; ++c) sides[tables.position[c] * s + i] = r[i * n + c];
            matrix.solve(sides.data());
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < n; ++c) r[i * n + c] = sides[tables.position[c] * s + i];
            return true;
        };
        const int64_t enough = tables.solver >= STRUCTURE ? REFINED - 1 : 0;
        return taken(correct(p, evaluate, solve, [&] { return stale = true; }, enough));
    }

    // Matrix-free: `multiply` applies the derivative of the slopes to changes of the points.
    NOINLINE bool by_krylov(Unknowns<Layout>& y, const Evaluate& evaluate, const Multiply& multiply) {
        const int64_t m = y.size;
        LinearWorkspace<A> linear(field, s, blocks, m);
        auto operate = [&](const double* v, double* image) {
            share(m, [&](int64_t first, int64_t last) {
                for (int64_t i = 0; i < s; ++i)
                    for (int64_t c = first; c < last; ++c) Layout::put(linear.input.at, m, c, i, v[i * m + c]);
            });
            Layout::repeat_last(linear.input.at, m, s);
            multiply(linear, linear.input.at, linear.output.at);
            for (int64_t b = 0; b < blocks; ++b)
                mix_each<Layout>(mix.at + b * s, s, linear.output.at, m, linear.none.data(),
                                 [&](int64_t c, const A& sum) { linear.input.at[b * m + c] -= sum; });
            share(m, [&](int64_t first, int64_t last) {
                for (int64_t i = 0; i < s; ++i)
                    for (int64_t c = first; c < last; ++c) image[i * m + c] = Layout::at(linear.input.at, m, c, i);
            });
        };
        auto solve = [&](double* r) { return linear.krylov.solve(r, operate); };
        return taken(correct(y, evaluate, solve, [] { return true; }));
    }

    NOINLINE bool linear_by_systems() {
        std::copy_n(frozen.at, blocks * n, p.points.at);
        const bool found = tables.solver == STRUCTURE ? linear_in_gradient() : linear_in_structure();
        if (!found || d == 0) return found;
        g.start_at_base();
        return settle_group(true) || group_by_krylov() || group_by_factors();
    }

    // The structure is frozen: linear in the gradient.
    bool linear_in_gradient() {
        return by_systems([&] { this->evaluate_frozen(STRUCTURE); },
                          [&](LinearWorkspace<A>& linear, const A* v, A* out) {
                              for (int64_t b = 0; b < blocks; ++b) {
                                  const auto& here = Layout::constants(constants, b, s);
                                  hessian_times(field, here, frozen.at + b * n, v + b * n, times.at[b],
                                                linear.derivatives.gradient.at, linear.derivatives);
                                  product(field, here, frozen.at + b * n, linear.derivatives.gradient.at, lengths.at[b],
                                          out + b * n, workspace);
                              }
                          });
    }

    // The gradient is frozen: linear in the structure.
    bool linear_in_structure() {
        return by_systems([&] { this->evaluate_frozen(GRADIENT); },
                          [&](LinearWorkspace<A>&, const A* v, A* out) {
                              for (int64_t b = 0; b < blocks; ++b)
                                  product(field, Layout::constants(constants, b, s), v + b * n, gradients.at + b * n,
                                          lengths.at[b], out + b * n, workspace);
                          });
    }

    NOINLINE bool group_by_krylov() {
        g.start_at_base();
        const double before = iterations;
        const bool found = by_krylov(
            g, [&] { evaluate_group(0, blocks); },
            [&](LinearWorkspace<A>&, const A* v, A* out) {
                for (int64_t b = 0; b < blocks; ++b)
                    group_slope(group, Layout::constants(constants, b, s), gradients.at + b * n, v + b * d * d,
                                lengths.at[b], out + b * d * d);
            });
        iterations = before;
        return found;
    }

    // Many stages of a large rotation have more distinct eigenvalues than a restarted Krylov space resolves.
    NOINLINE bool group_by_factors() {
        const int64_t size = s * d;
        if (size > LARGEST_FACTORED) return false;
        InterruptCheck::of_this_call().after(size * size * size / 3);
        matrices.clear(blocks * d * d);
        system.clear(size * size);
        pivots.clear(size);
        right.clear(size * d);
        g.start_at_base();
        return group_direct(true);
    }
};

}  // namespace coadjoint
