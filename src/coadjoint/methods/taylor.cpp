// The Taylor series of the motion, and back to the level set of the energy and of the Casimirs; with the group element.
#include "steps/group_series.hpp"
#include "steps/projection.hpp"
#include "steps/series.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

template <int W>
struct Taylor final : StepScheme {
    typedef Lanes<W> Row;
    const int64_t n, square, blocks;
    Series<W> series;
    Projection<W, Own> projection;
    Room<Row> owed;
    const std::unique_ptr<GroupMotion> group;
    Room<Row> gradients;

    Taylor(const StepTables& tables, const Own& constants)
        : n(tables.field.size), square(tables.group.size * tables.group.size), blocks(blocks_of<W>(n)),
          series(tables.field, constants, tables.whole[0]),
          projection(tables.kept, constants, tables.field.size), owed(blocks),
          group(group_motion(tables.group, constants, series)), gradients(group ? known_gradients(series) * blocks : 0) {
        work = series.work() + 8 * tables.field.size + (group ? group->work() : 0);
        remembered = projection.remembered();
    }

    int64_t step(double* x, double* dx, double* g, double* dg, double, double h) override {
        Row* state = series.x.at;
        for (int64_t b = 0; b < blocks; ++b) state[b] = load<Row>(x + b * W), owed.at[b] = load<Row>(dx + b * W);
        if (memory && !(memory[0] == memory[0])) projection.begin(state, memory);
        series.expand(h);
        // Before the state takes the place of the first coefficient.
        if (group) gradients_along(series, reinterpret_cast<double*>(gradients.at));
        for (int64_t b = 0; b < blocks; ++b) add_to(state[b], owed.at[b], series.increment(b));
        const bool restored = !memory || projection.restore(state, owed.at, blocks, memory);
        evaluations = series.order;
        iterations = projection.corrections;
        residual = projection.residual;
        for (int64_t b = 0; b < blocks; ++b) store(x + b * W, state[b]), store(dx + b * W, owed.at[b]);
        if (!restored) return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
        return group ? turn(x, g, dg, h) : DONE;
    }

    int64_t turn(const double* x, double* g, double* dg, double h) {
        const double* const along = reinterpret_cast<const double*>(gradients.at);
        residual = std::numeric_limits<double>::quiet_NaN();
        if (!finite(n, x)) return OVERFLOWED;
        if (!group->turn(along, known_gradients(series), blocks * W, h, g, dg)) return UNDEFINED;
        return finite(square, g) ? DONE : OVERFLOWED;
    }
};

}  // namespace

EXPORT StepScheme* taylor_step(const StepTables& tables, const Own& constants) {
    if (tables.field.size <= 4) return new Taylor<4>(tables, constants);
    return new Taylor<8>(tables, constants);
}

}  // namespace coadjoint
