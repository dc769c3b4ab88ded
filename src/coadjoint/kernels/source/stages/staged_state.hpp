// One state, or several as lanes, with the stages of its steps.
#pragma once

#include "stages/single.hpp"
#include "stages/single_stages.hpp"

namespace coadjoint {

// Numbers for the untested iterations and the slopes of a step.
inline int64_t slope_memory_size(const RungeKuttaTables& tables) {
    return tables.substeps + tables.stages * (tables.field.size + tables.group.size * tables.group.size);
}

// The memory per member: its remaining steps with Newton's method, and these numbers.
inline int64_t memory_size(const RungeKuttaTables& tables) {
    return tables.solver == IMPLICIT ? 1 + slope_memory_size(tables) : 0;
}

template <class Layout, class AllStages>
struct StagedState {
    typedef typename Layout::A A;
    typedef typename Layout::V V;
    const RungeKuttaTables& tables;
    const int64_t n, square, s;
    AllStages stages;
    AlignedArray<V> momentum, element;
    V *x, *dx, *g, *dg;

    template <class C>
    StagedState(const RungeKuttaTables& tables, const C& constants)
        : tables(tables), n(tables.field.size), square(tables.group.size * tables.group.size), s(tables.stages),
          stages(tables, constants), momentum(2 * n), element(2 * square), x(momentum.at), dx(x + n), g(element.at),
          dg(g + square) {
        stages.p.base = x, stages.p.error = dx, stages.g.base = g, stages.g.error = dg;
    }

    void add() {
        add_slopes<Layout>(tables.out, s, stages.p.slopes.at, n, x, dx);
        if (square > 0) add_slopes<Layout>(tables.out, s, stages.g.slopes.at, square, g, dg);
    }

    // Store the memory of one lane: the untested iterations of each substep, and the slopes, stage after stage, of the
    // previous step or of this one.
    void write_slopes(bool before, double* to, int lane) {
        for (int64_t part = 0; part < tables.substeps; ++part) *to++ = lane_of(stages.untested.at[part], lane);
        each_slope(before ? stages.p.before.at : stages.p.slopes.at, before ? stages.g.before.at : stages.g.slopes.at,
                   [&](A* y, int64_t size, int64_t c, int64_t j) {
                       *to++ = lane_of(V(Layout::at(y, size, c, j)), lane);
                   });
    }
    void read_slopes(const double* from, int lane) {
        for (int64_t part = 0; part < tables.substeps; ++part) {
            const double known = *from++;
            set_lane(stages.untested.at[part], lane, known >= 0.0 ? known : 0.0);
        }
        each_slope(stages.p.slopes.at, stages.g.slopes.at, [&](A* y, int64_t size, int64_t c, int64_t j) {
            V value = Layout::at(y, size, c, j);
            set_lane(value, lane, *from++);
            Layout::put(y, size, c, j, value);
        });
        Layout::repeat_last(stages.p.slopes.at, n, s);
        Layout::repeat_last(stages.g.slopes.at, square, s);
    }

  private:
    template <class Visit>
    void each_slope(A* slopes, A* group_slopes, Visit visit) {
        for (int64_t j = 0; j < s; ++j)
            for (int64_t c = 0; c < n; ++c) visit(slopes, n, c, j);
        for (int64_t j = 0; j < s; ++j)
            for (int64_t c = 0; c < square; ++c) visit(group_slopes, square, c, j);
    }
};

template <class Layout>
struct SingleOf final : Single {
    StagedState<Layout, SingleStages<Layout>> state;

    SingleOf(const RungeKuttaTables& tables, const SharedConstants& constants) : state(tables, constants) {
        x = state.x, dx = state.dx, g = state.g, dg = state.dg;
    }
    bool solve(double t, double h, int64_t part) override {
        state.stages.iterations = 0.0;
        const bool found = state.stages.solve_alone(t, h, part, newton);
        iterations += int64_t(state.stages.iterations);
        evaluations += int64_t(state.stages.evaluations());
        residual = state.stages.residual;
        return found;
    }
    void add() override { state.add(); }
    void read_slopes(const double* from) override { state.read_slopes(from, 0); }
    void write_slopes(double* to) override { state.write_slopes(false, to, 0); }
};

// Stages are lanes if a step has many at once; explicit schemes and the midpoint rule have one at a time.
INLINE bool one_at_a_time(const RungeKuttaTables& tables) { return tables.solver == EXPLICIT || tables.stages == 1; }

}  // namespace coadjoint
