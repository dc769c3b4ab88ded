// A step of another loop, and a projection to the level set of the energy and of the Casimirs.
#include "steps/compiled_series.hpp"
#include "steps/inner_step.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

template <int W>
struct Projected final : StepScheme {
    typedef Lanes<W> Row;
    const int64_t blocks;
    InnerStep inner;
    Projection<W, MemberConstants> projection;
    AlignedArray<Row> row, remainder;

    Projected(const StepTables& tables, const MemberConstants& constants)
        : blocks(blocks_of<W>(tables.field.size)), inner(tables.whole, tables.field.size, 0),
          projection(tables.restored, constants, tables.field.size), row(blocks), remainder(blocks) {
        work = 16 * work_of(tables.field);
        memory_size = projection.memory_size();
    }

    int64_t step(double* x, double*, double*, double*, double t, double h) override {
        load_row(x);
        if (memory && !(memory[0] == memory[0])) projection.begin(row.at, memory);
        const int64_t status = inner.take(x, nullptr, t, h);
        evaluations = inner.evaluations;
        iterations = inner.iterations;
        residual = inner.residual;
        if (status != DONE) return status;
        load_row(x);
        const bool restored = !memory || projection.restore(row.at, remainder.at, blocks, memory);
        for (int64_t b = 0; b < blocks; ++b) store(x + b * W, row.at[b]);
        if (restored) return DONE;
        residual = projection.residual;
        return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
    }

    void load_row(const double* x) {
        for (int64_t b = 0; b < blocks; ++b) row.at[b] = load<Row>(x + b * W), remainder.at[b] = Row(0.0);
    }
};

}  // namespace

EXPORT StepScheme* projected_step(const StepTables& tables, const MemberConstants& constants) {
    if (tables.field.size <= 4) return new Projected<4>(tables, constants);
    return new Projected<8>(tables, constants);
}

}  // namespace coadjoint
