// The Taylor series of the motion, and a projection to the level set of energy and Casimirs; with the group element.
#include "steps/compiled_series.hpp"
#include "steps/projection_lanes.hpp"
#include "steps/series_lanes.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

// Data that the lanes read repeatedly must stay in the cache of a core.
constexpr int64_t LARGEST_WORKING_SET = int64_t(1) << 18;

template <int W>
struct TaylorLanes final : LaneStep {
    const int64_t n;
    SeriesLanes<W, A> series;
    ProjectionLanes<W, A> projection;

    template <class C>
    TaylorLanes(const SeriesRows<W, A>& rows, const StepTables& tables, const C& constants)
        : n(rows.n), series(rows, tables.whole[0]), projection(tables.restored, constants, n) {
        work = series.work() + 8 * NATIVE * n;
    }

    // The step of members with these constants; null if they have other rows, or read more than the cache holds.
    template <class C>
    static std::unique_ptr<LaneStep> of(const StepTables& tables, const C& constants) {
        const SeriesRows<W, A> rows(tables.field, constants, tables.whole[0]);
        if (!rows.alike) return nullptr;
        auto step = std::make_unique<TaylorLanes>(rows, tables, constants);
        return step->series.working_set() > LARGEST_WORKING_SET ? nullptr : std::move(step);
    }

    void read(int lane, const double* memory) override { projection.read(lane, memory); }
    void write(int lane, double* memory) const override { projection.write(lane, memory); }

    void step(A* x, A* dx, const A&, const A& h, const int64_t* active) override {
        A selected(0.0);
        for (int lane = 0; lane < NATIVE; ++lane)
            if (active[lane]) set_lane(selected, lane, 1.0);
        projection.begin(x, selected > A(0.0));
        series.expand(x, h);
        for (int64_t i = 0; i < n; ++i) add_to(x[i], dx[i], series.increment(i));
        const auto restored = projection.restore(x, dx, selected > A(0.0));
        for (int lane = 0; lane < NATIVE; ++lane) {
            evaluations[lane] = series.order;
            iterations[lane] = int64_t(projection.corrections[lane]);
            residual[lane] = projection.residual[lane];
            status[lane] = at(restored, lane) ? DONE : residual[lane] - residual[lane] == 0.0 ? NOT_CONVERGED : OVERFLOWED;
        }
    }
};

template <int W>
struct Taylor final : StepScheme {
    typedef Lanes<W> Row;
    const int64_t n, square, blocks;
    Series<W> series;
    Projection<W, MemberConstants> projection;
    AlignedArray<Row> remainder;
    const std::unique_ptr<GroupMotion> group;
    AlignedArray<Row> gradients;

    Taylor(const StepTables& tables, const MemberConstants& constants)
        : n(tables.field.size), square(tables.group.size * tables.group.size), blocks(blocks_of<W>(n)),
          series(tables.field, constants, tables.whole[0]), projection(tables.restored, constants, tables.field.size),
          remainder(blocks), group(group_motion(tables.group, constants, series)),
          gradients(group ? known_gradients(series) * blocks : 0) {
        work = series.work() + 8 * tables.field.size + (group ? group->work() : 0);
        memory_size = projection.memory_size();
    }

    int64_t step(double* x, double* dx, double* g, double* dg, double, double h) override {
        Row* state = series.x.at;
        for (int64_t b = 0; b < blocks; ++b) state[b] = load<Row>(x + b * W), remainder.at[b] = load<Row>(dx + b * W);
        if (memory && !(memory[0] == memory[0])) projection.begin(state, memory);
        series.expand(h);
        // Before the state overwrites the first coefficient.
        if (group) gradients_along(series, reinterpret_cast<double*>(gradients.at));
        for (int64_t b = 0; b < blocks; ++b) add_to(state[b], remainder.at[b], series.increment(b));
        const bool restored = !memory || projection.restore(state, remainder.at, blocks, memory);
        evaluations = series.order;
        iterations = projection.corrections;
        residual = projection.residual;
        for (int64_t b = 0; b < blocks; ++b) store(x + b * W, state[b]), store(dx + b * W, remainder.at[b]);
        if (!restored) return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
        return group ? rotate(x, g, dg, h) : DONE;
    }

    std::unique_ptr<LaneStep> lane_step(const StepTables& tables, const LaneConstants* own) override {
        // Two lanes are not faster than the rows of one member.
        if (group || NATIVE < 4) return nullptr;
        return own ? TaylorLanes<W>::of(tables, *own) : TaylorLanes<W>::of(tables, MemberConstants{1, 0});
    }

    StepSeries series_of_step() const override {
        return {reinterpret_cast<const double*>(series.x.at), series.stride * W, series.order};
    }

    int64_t rotate(const double* x, double* g, double* dg, double h) {
        const double* const along = reinterpret_cast<const double*>(gradients.at);
        residual = std::numeric_limits<double>::quiet_NaN();
        if (!finite(n, x)) return OVERFLOWED;
        if (!group->rotate(along, known_gradients(series), blocks * W, h, g, dg)) return UNDEFINED;
        return finite(square, g) ? DONE : OVERFLOWED;
    }
};

}  // namespace

EXPORT StepScheme* taylor_step(const StepTables& tables, const MemberConstants& constants) {
    if (tables.field.size <= 4) return new Taylor<4>(tables, constants);
    return new Taylor<8>(tables, constants);
}

}  // namespace coadjoint
