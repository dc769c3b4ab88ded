// Fallbacks for the stages of one trajectory if the function iteration fails: Newton's method, and linear systems.
#pragma once

#include "field/derivatives.hpp"
#include "stages/newton.hpp"
#include "stages/runge_kutta.hpp"

namespace coadjoint {

constexpr double STEPS_OF_NEWTON = 64;  // after these the function iteration is tried again
constexpr int64_t LARGEST_FACTORED = 1024;  // unknowns of a column of the group element: half a second

template <class Layout>
struct SingleStages : Stages<Layout, SharedConstants> {
    typedef Stages<Layout, SharedConstants> Base;
    typedef typename Layout::A A;
    typedef Called<void()> Evaluate;
    typedef Corrected::Multiply Multiply;
    using Base::matrices, Base::system, Base::pivots, Base::right, Base::group_direct;
    using Base::p, Base::g, Base::mix, Base::forecast, Base::gradients, Base::frozen, Base::times, Base::lengths;
    using Base::tables, Base::constants, Base::field, Base::group, Base::n, Base::s, Base::d, Base::blocks;
    using Base::taken, Base::evaluate_all, Base::settle_momentum, Base::settle_group, Base::evaluate_group;
    using Base::workspace, Base::untested, Base::iterations, Base::residual, Base::solve, Base::begin, Base::save_slopes;

    SingleStages(const RungeKuttaTables& tables, const SharedConstants& constants) : Base(tables, constants) {}

    // Compute the slopes of a substep by one fallback after the other: starting at the base instead of an
    // extrapolation, corrections that are round-off although they are large, and Newton's method or linear systems
    // instead of function iteration. `newton` counts the further
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
            found = settle_momentum(true, untested.at[part], &untested.at[part]);
            if (!found && ahead) {
                p.start_at_base();
                found = settle_momentum(true, 0.0, &untested.at[part]);
            }
            if (!found && at_round_off(p, [&] { evaluate_all(); })) found = true, untested.at[part] = 0.0;
            newton = found ? 0.0 : STEPS_OF_NEWTON;
        }
        if (!found) {
            untested.at[part] = 0.0;
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

    NOINLINE bool by_newton() {
        if (s * n <= LARGEST_DENSE)
            return corrected(p, [&] { evaluate_all(); }, [&](const Corrected& stages) {
                return stages.by_factors(p.base, stage_numbers(times.at, 1), stage_numbers(lengths.at, 1), residual);
            });
        DerivativeWorkspace<A> derivatives(field);
        return by_systems([&] { evaluate_all(); },
                          [&](const double* v, double* out) {
                              for (int64_t b = 0; b < blocks; ++b)
                                  jacobian_times(field, Layout::constants(constants, b, s), p.points.at + b * n,
                                                 gradients.at + b * n, in_layout(v) + b * n, times.at[b], lengths.at[b],
                                                 in_layout(out) + b * n, derivatives);
                          });
    }

    static A* in_layout(double* numbers) { return reinterpret_cast<A*>(numbers); }
    static const A* in_layout(const double* numbers) { return reinterpret_cast<const A*>(numbers); }

    // Correct the stages that solve for y.
    bool corrected(Unknowns<Layout>& y, const Evaluate& evaluate, const Called<Outcome<double>(const Corrected&)>& by) {
        const auto find_defect = [&] { y.find_defect(); };
        const Corrected stages{tables, stage_numbers(y.points.at, y.size), stage_numbers(y.change.at, y.size), y.work,
                               evaluate, find_defect};
        return taken(by(stages));
    }

    // Large linear systems for the momentum: `multiply` applies the derivative of the slopes to changes of the points.
    bool by_systems(const Evaluate& evaluate, const Multiply& multiply) {
        if (tables.band < 0) return by_krylov(p, evaluate, multiply);
        return corrected(p, evaluate, [&](const Corrected& stages) { return stages.by_band(multiply); });
    }

    NOINLINE bool by_krylov(Unknowns<Layout>& y, const Evaluate& evaluate, const Multiply& multiply) {
        const std::vector<double> none(y.size, 0.0);
        const auto subtract = [&](const double* from, double* to) {
            for (int64_t b = 0; b < blocks; ++b)
                mix_each<Layout>(mix.at + b * s, s, in_layout(from), y.size, none.data(),
                                 [&](int64_t c, const A& sum) { in_layout(to)[b * y.size + c] -= sum; });
        };
        return corrected(y, evaluate,
                         [&](const Corrected& stages) { return stages.by_krylov(multiply, subtract); });
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
        DerivativeWorkspace<A> derivatives(field);
        return by_systems([&] { this->evaluate_frozen(STRUCTURE); },
                          [&](const double* v, double* out) {
                              for (int64_t b = 0; b < blocks; ++b) {
                                  const auto& here = Layout::constants(constants, b, s);
                                  hessian_times(field, here, frozen.at + b * n, in_layout(v) + b * n, times.at[b],
                                                derivatives.gradient.at, derivatives);
                                  product(field, here, frozen.at + b * n, derivatives.gradient.at, lengths.at[b],
                                          in_layout(out) + b * n, workspace);
                              }
                          });
    }

    // The gradient is frozen: linear in the structure.
    bool linear_in_structure() {
        return by_systems([&] { this->evaluate_frozen(GRADIENT); },
                          [&](const double* v, double* out) {
                              for (int64_t b = 0; b < blocks; ++b)
                                  product(field, Layout::constants(constants, b, s), in_layout(v) + b * n,
                                          gradients.at + b * n, lengths.at[b], in_layout(out) + b * n, workspace);
                          });
    }

    NOINLINE bool group_by_krylov() {
        g.start_at_base();
        const double before = iterations;
        const bool found = by_krylov(
            g, [&] { evaluate_group(0, blocks); },
            [&](const double* v, double* out) {
                for (int64_t b = 0; b < blocks; ++b)
                    group_slope(group, Layout::constants(constants, b, s), gradients.at + b * n,
                                in_layout(v) + b * d * d, lengths.at[b], in_layout(out) + b * d * d);
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
