// The stages of one step of a Runge-Kutta method: explicit, iterated, implicit, and linear in the last iterate.
#pragma once

#include "boundary/codes.hpp"
#include "numbers/linear_solve.hpp"
#include "stages/brackets.hpp"
#include "stages/lagged_functions.hpp"

namespace coadjoint {

// In place of what stays frozen while the rest is evaluated.
constexpr int64_t NOT_FROZEN = -1;
constexpr int64_t REFINED = 3;  // evaluations of a linear system: before the solution, before one refinement, and after

template <class Layout, class C>
struct Stages {
    typedef typename Layout::A A;
    typedef typename Layout::V V;
    typedef typename Layout::Coefficient Coefficient;
    typedef typename Numbers<V>::Mask Mask;
    static constexpr bool alone = Numbers<V>::lanes == 1;
    static constexpr int lanes = Numbers<A>::lanes;

    const RungeKuttaTables& tables;
    const C constants;
    const Field& field;
    const GroupField& group;
    const int64_t n, s, d, blocks;
    const KnownAlgebra algebra;
    AlignedArray<Coefficient> mix, node, scale, forecast;
    Unknowns<Layout> p, g;
    AlignedArray<A> gradients, settled_gradients, frozen, times, lengths, matrices;
    AlignedArray<V> system, pivots, right, untested;
    FieldWorkspace<A> workspace;
    LaggedFunctions<Layout> lagged;
    V iterations{0.0}, residual{0.0};

    Stages(const RungeKuttaTables& tables, const C& constants)
        : tables(tables), constants(constants), field(tables.field), group(tables.group), n(field.size),
          s(tables.stages), d(group.size), blocks(Layout::blocks(s)),
          algebra(blocks == 1 ? known() : KnownAlgebra::NONE), mix(blocks * s), node(blocks), scale(blocks),
          forecast(tables.solver == IMPLICIT ? tables.substeps * blocks * s : 0), p(s, n, mix.at), g(s, d * d, mix.at),
          gradients(blocks * n), settled_gradients(alone ? 0 : blocks * n),
          frozen(tables.solver >= STRUCTURE ? blocks * n : 0), times(blocks), lengths(blocks),
          matrices(tables.direct ? blocks * widest() * widest() : 0), system(edge() * edge()), pivots(edge()),
          right(edge() * std::max<int64_t>(d, 1)), untested(tables.substeps), workspace(field),
          lagged(field, constants, blocks, workspace) {
        p.work += s * work_of(field);
        g.work += s * d * group.entries;
        Layout::lay_out(tables.mix, s, s, mix.at);
        Layout::lay_out(tables.node, s, 1, node.at);
        Layout::lay_out(tables.scale, s, 1, scale.at);
        if (tables.solver == IMPLICIT)
            for (int64_t part = 0; part < tables.substeps; ++part)
                Layout::lay_out(tables.forecast + part * s * s, s, s, forecast.at + part * blocks * s);
    }

    // Many stages do not fit into registers.
    KnownAlgebra known() const {
        if constexpr (Layout::side_by_side && lanes <= 8) return known_algebra(field, constants);
        return KnownAlgebra::NONE;
    }
    int64_t widest() const { return std::max(n, d); }
    int64_t edge() const { return tables.direct ? s * widest() : 0; }

    // Compute the slopes of the momentum and of the group element for a substep that starts at time t; return the lanes
    // that succeeded. Failed members among lanes are computed alone, by `solve_alone`.
    Mask solve(double t, double h, int64_t part, Mask active) {
        begin(t, h);
        if (tables.solver == IMPLICIT) {
            save_slopes();
            p.start_extrapolated(forecast.at + part * blocks * s);
            const V known = untested.at[part];
            Mask found = settle_momentum(active, known, &untested.at[part]);
            if (d == 0) return found;
            g.start_extrapolated(forecast.at + part * blocks * s);
            found = settle_group(found);
            // Members that failed are solved again, alone, and trust as many iterations as if they had always been.
            untested.at[part] = select(found, untested.at[part], known);
            return found;
        }
        p.start_at_base();
        const bool explicitly = !Layout::side_by_side && tables.solver == EXPLICIT;  // see `one_at_a_time`
        Mask found = explicitly ? one_by_one(active) : pass(active);
        if (d == 0) return found;
        g.start_at_base();
        if (explicitly) return group_one_by_one(found);
        return tables.direct ? group_direct(found) : settle_group(found);
    }

    void begin(double t, double h) {
        for (int64_t b = 0; b < blocks; ++b) {
            times.at[b] = fma(A(node.at[b]), A(h), A(t));
            lengths.at[b] = A(h) * A(scale.at[b]);
        }
    }

    void save_slopes() {
        std::swap(p.before.at, p.slopes.at);
        std::swap(g.before.at, g.slopes.at);
    }

    INLINE void evaluate(int64_t low, int64_t high, int64_t freeze = NOT_FROZEN) {
        for (int64_t b = low; b < high; ++b) {
            const auto& lane_constants = Layout::constants(constants, b, s);
            A *x = p.points.at + b * n, *u = gradients.at + b * n;
            if (freeze == NOT_FROZEN) {
                slope_at(field, lane_constants, x, times.at[b], lengths.at[b], u, p.slopes.at + b * n, workspace);
                continue;
            }
            if (freeze != GRADIENT) gradient(field, lane_constants, x, times.at[b], u, workspace);
            const A* momentum = freeze == STRUCTURE ? frozen.at + b * n : x;
            product(field, lane_constants, momentum, u, lengths.at[b], p.slopes.at + b * n, workspace);
        }
    }

    NOINLINE void evaluate_all() { evaluate(0, blocks); }
    NOINLINE void evaluate_frozen(int64_t freeze) { evaluate(0, blocks, freeze); }

    // Iterate, the first `trust` iterations without convergence tests, and set `next` of converged lanes to the number
    // of iterations that the next step may trust.
    Mask settle_momentum(Mask active, const V& trust, V* next) {
        if constexpr (Layout::side_by_side && lanes <= 8) switch (algebra) {
                case KnownAlgebra::TRIAD: return settle_bracket<Triad, false>(trust, next);
                case KnownAlgebra::SO3: return settle_bracket<So3, false>(trust, next);
                case KnownAlgebra::SO3_FULL: return settle_bracket<So3, true>(trust, next);
                case KnownAlgebra::E3: return settle_bracket<E3, false>(trust, next);
                case KnownAlgebra::E3_FULL: return settle_bracket<E3, true>(trust, next);
                case KnownAlgebra::SO4: return settle_bracket<So4, false>(trust, next);
                case KnownAlgebra::SO4_FULL: return settle_bracket<So4, true>(trust, next);
                case KnownAlgebra::NONE: break;
            }
        if constexpr (alone)
            if (lagged.exist()) return settle_lagged(trust, next);
        // Up to eight lanes hold all stages, see `single_of`.
        return settle_blocks<Layout::side_by_side && lanes <= 8>(active, trust, next);
    }

    template <bool one>
    NOINLINE Mask settle_blocks(Mask active, const V& trust, V* next) {
        const int64_t count = one ? 1 : blocks;
        // Too large for the compiler to inline by itself.
        auto iterate = [&](auto watched) __attribute__((always_inline)) {
            evaluate(0, count);
            p.template update_points<decltype(watched)::value>(0, count, s);
        };
        const auto outcome = settle_by(p, active, count, n, trust, iterate,
                                       [&](const Mask& over, bool last) { store_gradients(over, last); });
        *next = select(outcome.settled, outcome.untested, *next);
        return taken(outcome);
    }

    NOINLINE Mask settle_lagged(V trust, V* next) {
        double squares = 0.0;
        for (int64_t k = 0; k < s * s; ++k) squares = fma(tables.mix[k], tables.mix[k], squares);
        lagged.begin(field, constants, p.base, square_root(squares) * Layout::largest(absolute(lengths.at[0])));
        Mask found;
        do {
            auto iterate = [&](auto watched) {
                lagged.decide(p.points.at);
                evaluate(0, 1);
                p.rounding = lagged.round_off(field, Layout::constants(constants, 0, s), p.points.at, gradients.at);
                p.template update_points<decltype(watched)::value>(0, 1, s);
            };
            const auto outcome = settle_by(p, true, 1, n, trust, iterate, [](const Mask&, bool) {});
            *next = select(outcome.settled, outcome.untested, *next);
            found = taken(outcome);
            trust = 0.0;
        } while (found && lagged.must_evaluate());
        lagged.end();
        return found;
    }

    template <class Bracket, bool full>
    NOINLINE Mask settle_bracket(const V& trust, V* next) {
        Bracketed<Layout, Bracket, full> body(field, constants, p, gradients.at, lengths.at[0]);
        auto iterate = [&](auto watched) __attribute__((always_inline)) {
            body.template iterate<decltype(watched)::value>(s);
        };
        const auto outcome = settle_by(p, true, 1, Bracket::n, trust, iterate, [](const Mask&, bool) {});
        *next = select(outcome.settled, outcome.untested, *next);
        return taken(outcome);
    }

    NOINLINE Mask settle_frozen(Mask active, int64_t freeze) {
        return taken(settle(
            p, active, [&] { evaluate_frozen(freeze); },
            [&](const Mask& over, bool last) { store_gradients(over, last); }));
    }

    void store_gradients(const Mask& over, bool last) {
        if constexpr (!alone)
            for (int64_t k = 0; k < blocks * n; ++k)
                settled_gradients.at[k] = select(over, gradients.at[k], settled_gradients.at[k]);
        if (last) std::swap(settled_gradients.at, gradients.at);
    }

    Mask taken(const Outcome<V>& outcome) {
        iterations = iterations + outcome.iterations;
        residual = outcome.residual;
        return outcome.settled;
    }

    NOINLINE Mask one_by_one(Mask active) {
        for (int64_t j = 0; j < s; ++j) {
            if (j > 0) p.template update_points<false>(j, j + 1, j);
            evaluate(j, j + 1);
        }
        iterations = iterations + double(s);
        return active;
    }

    // A fixed number of function iterations, then the output, or the linear system in the frozen factor.
    NOINLINE Mask pass(Mask active) {
        for (int64_t passed = 0;; ++passed) {
            evaluate_all();
            if (passed == tables.iterations) break;
            p.template update_points<false>(0, blocks, s);
        }
        iterations = iterations + double(tables.iterations + 1);
        if (tables.solver == ITERATED) return active;
        std::copy_n(p.points.at, blocks * n, frozen.at);
        return linear(active, tables.solver);
    }

    NOINLINE Mask linear(Mask active, int64_t freeze) {
        if (!tables.direct) return settle_frozen(active, freeze);
        for (int64_t b = 0; b < blocks; ++b) {
            const auto& lane_constants = Layout::constants(constants, b, s);
            A* block = matrices.at + b * n * n;
            if (freeze == STRUCTURE)
                structure_times_matrix(field, lane_constants, frozen.at + b * n, tables.quadratic, lengths.at[b], block,
                                       workspace);
            else
                coadjoint_matrix(field, lane_constants, gradients.at + b * n, lengths.at[b], block);
        }
        active = active & assemble(n);
        for (int64_t passed = 1; passed < REFINED; ++passed) {
            refine(p, n, 1);
            evaluate_frozen(freeze);
        }
        iterations = iterations + double(REFINED - 1);
        residual = select(active, V(0.0), V(std::numeric_limits<double>::infinity()));
        return active;
    }

    // Factorize I - (mix_ij W_j), W_j the (edge * edge) blocks; return the lanes in which it is not singular.
    Mask assemble(int64_t edge) {
        const int64_t size = s * edge;
        for (int64_t i = 0; i < s; ++i)
            for (int64_t j = 0; j < s; ++j)
                for (int64_t a = 0; a < edge; ++a)
                    for (int64_t b = 0; b < edge; ++b)
                        system.at[(i * edge + a) * size + j * edge + b] =
                            fma(V(-tables.mix[i * s + j]), Layout::at(matrices.at, edge * edge, a * edge + b, j),
                                V(i == j && a == b ? 1.0 : 0.0));
        return factorize(system.at, size, pivots.at);
    }

    // Add to the points the solution of the factorized system for their defect; the first call solves it.
    void refine(Unknowns<Layout>& y, int64_t edge, int64_t count) {
        const int64_t m = y.size;
        y.find_defect();
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < m; ++c) right.at[i * m + c] = Layout::at(y.change.at, m, c, i);
        substitute(system.at, s * edge, pivots.at, right.at, count);
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < m; ++c)
                Layout::put(y.points.at, m, c, i, V(Layout::at(y.points.at, m, c, i)) + right.at[i * m + c]);
        Layout::repeat_last(y.points.at, m, s);
    }

    INLINE void evaluate_group(int64_t low, int64_t high) {
        for (int64_t b = low; b < high; ++b)
            group_slope(group, Layout::constants(constants, b, s), gradients.at + b * n, g.points.at + b * d * d,
                        lengths.at[b], g.slopes.at + b * d * d);
    }

    NOINLINE Mask settle_group(Mask active) {
        if (!any(active)) return active;
        const V before = iterations;
        const Mask found = taken(settle(g, active, [&] { evaluate_group(0, blocks); }, [](const Mask&, bool) {}));
        iterations = before;
        return found;
    }

    NOINLINE Mask group_one_by_one(Mask active) {
        for (int64_t j = 0; j < s; ++j) {
            if (j > 0) g.template update_points<false>(j, j + 1, j);
            evaluate_group(j, j + 1);
        }
        return active;
    }

    NOINLINE Mask group_direct(Mask active) {
        for (int64_t b = 0; b < blocks; ++b)
            group_matrix(group, Layout::constants(constants, b, s), gradients.at + b * n, lengths.at[b],
                         matrices.at + b * d * d);
        active = active & assemble(d);
        evaluate_group(0, blocks);
        for (int64_t passed = 1; passed < REFINED; ++passed) {
            refine(g, d, d);
            evaluate_group(0, blocks);
        }
        return active;
    }

    // The number of evaluations of the field.
    V evaluations() const { return tables.solver == EXPLICIT ? iterations : iterations * double(s); }
};

}  // namespace coadjoint
