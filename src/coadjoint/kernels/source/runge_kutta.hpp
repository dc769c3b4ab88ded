// The stages of one step of a Runge-Kutta method: explicit, iterated, implicit, and linear in the last iterate.
#pragma once

#include <memory>

#include "derivatives.hpp"
#include "newton.hpp"

constexpr int64_t EXPLICIT = 0, ITERATED = 1, IMPLICIT = 2, STRUCTURE = 3, GRADIENT = 4;
constexpr int64_t NOT_FROZEN = -1;
constexpr int64_t REFINED = 3;         // evaluations of a linear system: before the solution, before one refinement, after
constexpr int64_t LARGEST_DENSE = 200; // unknowns: above, Newton corrections are solved without a matrix
constexpr double STEPS_OF_NEWTON = 64; // after which the function iteration is tried again

// What a trajectory remembers from step to step: for how many steps it still begins with Newton, and its slopes.
INLINE int64_t memory_of(const RungeKuttaTables& tables) {
    const int64_t d = tables.group.size;
    return tables.solver == IMPLICIT ? 1 + tables.stages * (tables.field.size + d * d) : 0;
}

// Room for what few trajectories need.
template <class A>
struct LinearRoom {
    DerivativeRoom<A> sloping;
    Krylov krylov;
    Room<A> forth, back;
    std::vector<double> none;
    LinearRoom(const Field& field, int64_t stages, int64_t blocks, int64_t size)
        : sloping(field), krylov(stages * size), forth(blocks * size), back(blocks * size), none(size, 0.0) {}
};

template <class Layout, class C>
struct Stages {
    typedef typename Layout::A A;
    typedef typename Layout::V V;
    typedef typename Layout::Coefficient Coefficient;
    typedef typename Numbers<V>::Mask Mask;
    static constexpr bool alone = Numbers<V>::lanes == 1;

    const RungeKuttaTables& tables;
    const C constants;
    const Field& field;
    const GroupField& group;
    const int64_t n, s, d, blocks;
    Room<Coefficient> mix, node, scale, forecast;
    Unknowns<Layout> p, g;
    Room<A> gradients, kept, frozen, times, lengths, matrices;
    Room<V> system, pivots, right;
    FieldRoom<A> room;
    V iterations{0.0}, residual{0.0};

    Stages(const RungeKuttaTables& tables, const C& constants)
        : tables(tables), constants(constants), field(tables.field), group(tables.group), n(field.size),
          s(tables.stages), d(group.size), blocks(Layout::blocks(s)), mix(blocks * s), node(blocks), scale(blocks),
          forecast(tables.solver == IMPLICIT ? tables.substeps * blocks * s : 0), p(s, n, mix.at), g(s, d * d, mix.at),
          gradients(blocks * n), kept(alone ? 0 : blocks * n), frozen(tables.solver >= STRUCTURE ? blocks * n : 0),
          times(blocks), lengths(blocks), matrices(tables.direct ? blocks * widest() * widest() : 0),
          system(edge() * edge()), pivots(edge()), right(edge() * std::max<int64_t>(d, 1)), room(field) {
        Layout::lay_out(tables.mix, s, s, mix.at);
        Layout::lay_out(tables.node, s, 1, node.at);
        Layout::lay_out(tables.scale, s, 1, scale.at);
        if (tables.solver == IMPLICIT)
            for (int64_t part = 0; part < tables.substeps; ++part)
                Layout::lay_out(tables.forecast + part * s * s, s, s, forecast.at + part * blocks * s);
    }

    int64_t widest() const { return std::max(n, d); }
    int64_t edge() const { return tables.direct ? s * widest() : 0; }

    // Find the slopes of the momentum and of the group element for a substep that starts at time t; returns where they
    // were found. What is not found for a member of a crowd is to be sought for it alone, by `solve_alone`.
    Mask solve(double t, double h, int64_t part, Mask going) {
        begin(t, h);
        if (tables.solver == IMPLICIT) {
            remember();
            p.start_ahead(forecast.at + part * blocks * s);
            Mask found = settle_momentum(going);
            if (d == 0) return found;
            g.start_ahead(forecast.at + part * blocks * s);
            return settle_group(found);
        }
        p.start_at_base();
        Mask found = tables.solver == EXPLICIT ? one_by_one(going) : pass(going);
        if (d == 0) return found;
        g.start_at_base();
        return tables.solver == EXPLICIT ? group_one_by_one(found) : tables.direct ? group_direct(found) : settle_group(found);
    }

    // The same, and where that fails by other means, one after the other: from the base instead of ahead, by Newton's
    // method or linear systems instead of iterating. `newton` counts the steps that are still to begin with these.
    bool solve_alone(double t, double h, int64_t part, double& newton) {
        if (tables.solver != IMPLICIT) {
            if (solve(t, h, part, true)) return true;
            return tables.solver >= STRUCTURE && !tables.direct && linear_by_systems();
        }
        begin(t, h);
        remember();
        bool found = false;
        if (newton >= 1.0) {
            newton -= 1.0;
        } else {
            const bool ahead = all(p.start_ahead(forecast.at + part * blocks * s));
            found = settle_momentum(true);
            if (!found && ahead) {
                p.start_at_base();
                found = settle_momentum(true);
            }
            newton = found ? 0.0 : STEPS_OF_NEWTON;
        }
        if (!found) {
            const double earlier = residual;
            p.start_at_base();
            found = by_newton();
            if (!found && all(p.start_ahead(forecast.at + part * blocks * s))) found = by_newton();
            if (!found && earlier != earlier) residual = earlier;
        }
        if (!found || d == 0) return found;
        g.start_ahead(forecast.at + part * blocks * s);
        return settle_group(true) || group_by_krylov();
    }

    void begin(double t, double h) {
        for (int64_t b = 0; b < blocks; ++b) {
            times.at[b] = fma(A(node.at[b]), A(h), A(t));
            lengths.at[b] = A(h) * A(scale.at[b]);
        }
    }

    void remember() {
        std::swap(p.before.at, p.slopes.at);
        std::swap(g.before.at, g.slopes.at);
    }

    template <int64_t freeze>
    INLINE void evaluate(int64_t low, int64_t high) {
        for (int64_t b = low; b < high; ++b) {
            const auto& own = Layout::constants(constants, b, s);
            A *x = p.points.at + b * n, *u = gradients.at + b * n;
            if constexpr (freeze != GRADIENT) gradient(field, own, x, times.at[b], u, room);
            product(field, own, freeze == STRUCTURE ? frozen.at + b * n : x, u, lengths.at[b], p.slopes.at + b * n, room);
        }
    }

    NOINLINE void evaluate_all() { evaluate<NOT_FROZEN>(0, blocks); }

    NOINLINE Mask settle_momentum(Mask going) {
        return taken(settle(p, going, [&] { evaluate<NOT_FROZEN>(0, blocks); },
                            [&](const Mask& over, bool last) { keep_gradients(over, last); }));
    }

    template <int64_t freeze>
    NOINLINE Mask settle_frozen(Mask going) {
        return taken(settle(p, going, [&] { evaluate<freeze>(0, blocks); },
                            [&](const Mask& over, bool last) { keep_gradients(over, last); }));
    }

    void keep_gradients(const Mask& over, bool last) {
        if constexpr (!alone)
            for (int64_t k = 0; k < blocks * n; ++k) kept.at[k] = select(over, gradients.at[k], kept.at[k]);
        if (last) std::swap(kept.at, gradients.at);
    }

    Mask taken(const Outcome<V>& outcome) {
        iterations = iterations + outcome.iterations;
        residual = outcome.residual;
        return outcome.settled;
    }

    NOINLINE Mask one_by_one(Mask going) {
        for (int64_t j = 0; j < s; ++j) {
            if (j > 0) p.restage(j, j + 1, j);
            evaluate<NOT_FROZEN>(j, j + 1);
        }
        iterations = iterations + double(s);
        return going;
    }

    // A fixed number of function iterations, then the output, or the linear system in what is frozen.
    NOINLINE Mask pass(Mask going) {
        for (int64_t passed = 0;; ++passed) {
            evaluate_all();
            if (passed == tables.iterations) break;
            p.restage(0, blocks, s);
        }
        iterations = iterations + double(tables.iterations + 1);
        if (tables.solver == ITERATED) return going;
        std::copy_n(p.points.at, blocks * n, frozen.at);
        return tables.solver == STRUCTURE ? linear<STRUCTURE>(going) : linear<GRADIENT>(going);
    }

    template <int64_t freeze>
    NOINLINE Mask linear(Mask going) {
        if (!tables.direct) return settle_frozen<freeze>(going);
        for (int64_t b = 0; b < blocks; ++b) {
            const auto& own = Layout::constants(constants, b, s);
            A* block = matrices.at + b * n * n;
            if constexpr (freeze == STRUCTURE)
                structure_times_matrix(field, own, frozen.at + b * n, tables.quadratic, lengths.at[b], block, room);
            else
                coadjoint_matrix(field, own, gradients.at + b * n, lengths.at[b], block);
        }
        going = going & assemble(n);
        for (int64_t passed = 1; passed < REFINED; ++passed) {
            refine(p, n, 1);
            evaluate<freeze>(0, blocks);
        }
        iterations = iterations + double(REFINED - 1);
        residual = select(going, V(0.0), V(std::numeric_limits<double>::infinity()));
        return going;
    }

    // Factorize I - (mix_ij W_j), W_j the (edge * edge) blocks; returns where it is not singular.
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

    // Add to the points the solution of the factorized system for their defect: the first time solves it.
    void refine(Unknowns<Layout>& y, int64_t edge, int64_t count) {
        const int64_t m = y.size;
        for (int64_t b = 0; b < blocks; ++b)
            mix_each<Layout>(mix.at + b * s, s, y.slopes.at, m, y.error, [&](int64_t c, const A& sum) {
                y.change.at[b * m + c] = (Layout::spread(y.base[c]) - y.points.at[b * m + c]) + sum;
            });
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

    NOINLINE Mask settle_group(Mask going) {
        const V before = iterations;
        const Mask found = taken(settle(g, going, [&] { evaluate_group(0, blocks); }, [](const Mask&, bool) {}));
        iterations = before;
        return found;
    }

    NOINLINE Mask group_one_by_one(Mask going) {
        for (int64_t j = 0; j < s; ++j) {
            if (j > 0) g.restage(j, j + 1, j);
            evaluate_group(j, j + 1);
        }
        return going;
    }

    NOINLINE Mask group_direct(Mask going) {
        for (int64_t b = 0; b < blocks; ++b)
            group_matrix(group, Layout::constants(constants, b, s), gradients.at + b * n, lengths.at[b],
                         matrices.at + b * d * d);
        going = going & assemble(d);
        evaluate_group(0, blocks);
        for (int64_t passed = 1; passed < REFINED; ++passed) {
            refine(g, d, d);
            evaluate_group(0, blocks);
        }
        return going;
    }

    // How many evaluations of the field all that was.
    V evaluations() const { return tables.solver == EXPLICIT ? iterations : iterations * double(s); }

    // The rest is for one trajectory at a time.

    // Factorize 1 - mix h scale times the Jacobian: at the base for all stages, or for every stage at its point.
    NOINLINE bool linearize(bool at_base, Room<double>& matrix, Room<double>& exchanged) {
        if constexpr (alone) {
            DerivativeRoom<double> sloping(field);
            Room<double> point(n), u(n), unit(n), image(n), whole(n * n);
            const int64_t size = s * n;
            for (int64_t j = 0; j < s; ++j) {
                if (j == 0 || !at_base) {
                    const double t = Layout::at(times.at, 1, 0, j);
                    for (int64_t c = 0; c < n; ++c) point.at[c] = at_base ? p.base[c] : Layout::at(p.points.at, n, c, j);
                    gradient(field, constants, point.at, t, u.at, sloping.field);
                    for (int64_t k = 0; k < n; ++k) {
                        unit.at[k] = 1.0;
                        jacobian_times(field, constants, point.at, u.at, unit.at, t, 1.0, image.at, sloping);
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
        return false;
    }

    NOINLINE bool by_newton() {
        if constexpr (alone) {
            const int64_t size = s * n;
            if (size > LARGEST_DENSE)
                return by_systems([&] { evaluate_all(); }, [&](LinearRoom<A>& own, const A* v, A* out) {
                    for (int64_t b = 0; b < blocks; ++b)
                        jacobian_times(field, Layout::constants(constants, b, s), p.points.at + b * n,
                                       gradients.at + b * n, v + b * n, times.at[b], lengths.at[b], out + b * n,
                                       own.sloping);
                });
            Room<double> matrix(size * size), exchanged(size);
            if (!linearize(true, matrix, exchanged)) return false;
            return taken(correct(p, [&] { evaluate_all(); },
                                 [&](double* r) { return substitute(matrix.at, size, exchanged.at, r, 1), true; },
                                 [&] { return linearize(false, matrix, exchanged); }));
        }
        return false;
    }

    // Large linear systems for the momentum: `multiply` applies the derivative of the slopes to changes of the points.
    template <class Evaluate, class Multiply>
    bool by_systems(Evaluate evaluate, Multiply multiply) {
        return tables.band >= 0 ? by_band(evaluate, multiply) : by_krylov(p, evaluate, multiply);
    }

    // By factors, where coordinates that are coupled are near to each other in the order `position`. Columns that no row
    // shares are found by one multiplication.
    template <class Evaluate, class Multiply>
    bool by_band(Evaluate evaluate, Multiply multiply) {
        const int64_t band = tables.band, groups = std::min(n, 2 * band + 1);
        LinearRoom<A> own(field, 0, blocks, n);
        Banded matrix(s * n, s * (band + 1) - 1);
        std::vector<int64_t> coordinate(n);
        std::vector<double> sides(s * n);
        for (int64_t c = 0; c < n; ++c) coordinate[tables.position[c]] = c;
        bool stale = true;
        auto factors = [&] {
            std::fill(matrix.entries.begin(), matrix.entries.end(), 0.0);
            for (int64_t k = 0; k < s * n; ++k) matrix.at(k, k) = 1.0;
            for (int64_t start = 0; start < groups; ++start) {
                std::fill_n(own.forth.at, blocks * n, A(0.0));
                for (int64_t place = start; place < n; place += groups)
                    for (int64_t b = 0; b < blocks; ++b) own.forth.at[b * n + coordinate[place]] = A(1.0);
                multiply(own, own.forth.at, own.back.at);
                for (int64_t place = start; place < n; place += groups)
                    for (int64_t row = std::max<int64_t>(0, place - band); row < std::min(n, place + band + 1); ++row)
                        for (int64_t j = 0; j < s; ++j) {
                            const double entry = Layout::at(own.back.at, n, coordinate[row], j);
                            for (int64_t i = 0; i < s; ++i) {
                                double& here = matrix.at(row * s + i, place * s + j);
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
        return taken(correct(p, evaluate, solve, [&] { return stale = true; }, tables.solver >= STRUCTURE ? REFINED - 1 : 0));
    }

    // Without a matrix: `multiply` applies the derivative of the slopes to changes of the points.
    template <class Evaluate, class Multiply>
    bool by_krylov(Unknowns<Layout>& y, Evaluate evaluate, Multiply multiply) {
        const int64_t m = y.size;
        LinearRoom<A> own(field, s, blocks, m);
        auto operate = [&](const double* v, double* image) {
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < m; ++c) Layout::put(own.forth.at, m, c, i, v[i * m + c]);
            Layout::repeat_last(own.forth.at, m, s);
            multiply(own, own.forth.at, own.back.at);
            for (int64_t b = 0; b < blocks; ++b)
                mix_each<Layout>(mix.at + b * s, s, own.back.at, m, own.none.data(),
                                 [&](int64_t c, const A& sum) { own.forth.at[b * m + c] -= sum; });
            for (int64_t i = 0; i < s; ++i)
                for (int64_t c = 0; c < m; ++c) image[i * m + c] = Layout::at(own.forth.at, m, c, i);
        };
        return taken(correct(y, evaluate, [&](double* r) { return own.krylov.solve(r, operate); }, [] { return true; }));
    }

    NOINLINE bool linear_by_systems() {
        if constexpr (alone) {
            std::copy_n(frozen.at, blocks * n, p.points.at);
            bool found;
            if (tables.solver == STRUCTURE)
                found = by_systems([&] { evaluate<STRUCTURE>(0, blocks); }, [&](LinearRoom<A>& own, const A* v, A* out) {
                    for (int64_t b = 0; b < blocks; ++b) {
                        const auto& here = Layout::constants(constants, b, s);
                        hessian_times(field, here, frozen.at + b * n, v + b * n, times.at[b], own.sloping.gradient.at,
                                      own.sloping);
                        product(field, here, frozen.at + b * n, own.sloping.gradient.at, lengths.at[b], out + b * n, room);
                    }
                });
            else
                found = by_systems([&] { evaluate<GRADIENT>(0, blocks); }, [&](LinearRoom<A>&, const A* v, A* out) {
                    for (int64_t b = 0; b < blocks; ++b)
                        product(field, Layout::constants(constants, b, s), v + b * n, gradients.at + b * n, lengths.at[b],
                                out + b * n, room);
                });
            if (!found || d == 0) return found;
            g.start_at_base();
            return settle_group(true) || group_by_krylov();
        }
        return false;
    }

    NOINLINE bool group_by_krylov() {
        if constexpr (alone) {
            g.start_at_base();
            const double before = iterations;
            const bool found =
                by_krylov(g, [&] { evaluate_group(0, blocks); }, [&](LinearRoom<A>&, const A* v, A* out) {
                    for (int64_t b = 0; b < blocks; ++b)
                        group_slope(group, Layout::constants(constants, b, s), gradients.at + b * n, v + b * d * d,
                                    lengths.at[b], out + b * d * d);
                });
            iterations = before;
            return found;
        }
        return false;
    }
};
