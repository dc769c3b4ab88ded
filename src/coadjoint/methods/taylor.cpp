// The Taylor series of the motion, and back to the level set of the energy and of the Casimirs.
#include "steps/projection.hpp"
#include "steps/series.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

template <int W>
struct Taylor final : StepScheme {
    typedef Lanes<W> Row;
    const int64_t blocks;
    Series<W> series;
    Projection<W, Own> projection;
    Room<Row> owed;

    Taylor(const StepTables& tables, const Own& constants)
        : blocks(blocks_of<W>(tables.field.size)), series(tables.field, constants, tables.whole[0]),
          projection(tables.kept, constants, tables.field.size), owed(blocks) {
        work = series.work() + 8 * tables.field.size;
        remembered = projection.remembered();
    }

    int64_t step(double* x, double* dx, double*, double*, double, double h) override {
        Row* state = series.x.at;
        for (int64_t b = 0; b < blocks; ++b) state[b] = load<Row>(x + b * W), owed.at[b] = load<Row>(dx + b * W);
        if (memory && !(memory[0] == memory[0])) projection.begin(state, memory);
        series.expand(h);
        for (int64_t b = 0; b < blocks; ++b) add_to(state[b], owed.at[b], series.increment(b));
        const bool restored = !memory || projection.restore(state, owed.at, blocks, memory);
        evaluations = series.order;
        iterations = projection.corrections;
        residual = projection.residual;
        for (int64_t b = 0; b < blocks; ++b) store(x + b * W, state[b]), store(dx + b * W, owed.at[b]);
        if (restored) return DONE;
        return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
    }
};

}  // namespace

EXPORT StepScheme* taylor_step(const StepTables& tables, const Own& constants) {
    if (tables.field.size <= 4) return new Taylor<4>(tables, constants);
    return new Taylor<8>(tables, constants);
}

}  // namespace coadjoint
