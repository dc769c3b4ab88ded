// The step of Taylor schemes without a group element: the operations of the library, by its template for one member, which
// compiles in seconds and takes a tenth of the memory of the unrolled one.
#include "steps/projection_lanes.hpp"
#include "steps/series_lanes.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

template <int W>
struct TaylorOfOne final : StepScheme {
    const int64_t n;
    const SeriesField<W> field;
    SeriesLanes<W, double> series;
    Projection<W, MemberConstants> one;
    ProjectionLanes<W, double> projection;

    TaylorOfOne(const StepTables& tables, const MemberConstants& constants)
        : n(tables.field.size), field(tables.field, constants, tables.whole[0]), series(field, tables.whole[0]),
          one(tables.restored, constants, n), projection(one, n) {
        work = series.work() + 8 * n;
        memory_size = one.memory_size();
    }

    int64_t step(double* x, double* dx, double*, double*, double, double h) override {
        if (memory) projection.read(0, memory), projection.begin(0, x);
        series.expand(x, h);
        for (int64_t i = 0; i < n; ++i) add_to(x[i], dx[i], series.increment(i));
        const bool restored = projection.restore(x, dx, true);
        if (memory) projection.write(0, memory);
        evaluations = series.order;
        iterations = int64_t(projection.corrections);
        residual = projection.residual;
        return restored ? DONE : residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
    }
};

static StepScheme* taylor_step(const StepTables& tables, const MemberConstants& constants) {
    if (tables.field.size <= 4) return new TaylorOfOne<4>(tables, constants);
    return new TaylorOfOne<8>(tables, constants);
}

// The address that the tables of a Taylor scheme contain.
EXPORT void* taylor_address() { return reinterpret_cast<void*>(&taylor_step); }

}  // namespace coadjoint
