// A step of another loop, and back to the level set of the energy and of the Casimirs.
#include <new>

#include "boundary/crew.hpp"
#include "steps/projection.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

template <int W>
struct Projected final : StepScheme {
    typedef Lanes<W> Row;
    const int64_t n, blocks, carried;
    const InnerLoop loop;
    const void* tables;
    const Watch& watch;
    Projection<W, Own> projection;
    Room<Row> row, owed;
    Extent extent;
    std::vector<double> saved, state;
    const int64_t member = 0;

    Projected(const StepTables& given, const Own& constants)
        : n(given.field.size), blocks(blocks_of<W>(n)), carried(given.whole[3]),
          loop(reinterpret_cast<InnerLoop>(given.whole[0])), tables(reinterpret_cast<const void*>(given.whole[1])),
          watch(*reinterpret_cast<const Watch*>(given.whole[2])), projection(given.kept, constants, n), row(blocks),
          owed(blocks) {
        // The steps 0 and 1 are saved: a loop that leaves a step unfinished finishes what it saves.
        extent.members = 1, extent.points = 3, extent.size = n;
        extent.square = extent.invariants = 0, extent.remembered = carried;
        double* const none = reinterpret_cast<double*>(sizeof(double));  // only distances from it are read
        const Arrays last(extent, none, none);
        saved.resize(last.values - none + 1);
        state.resize(reinterpret_cast<double*>(last.iterations) - none + 1);
        work = 16 * work_of(given.field);
        remembered = projection.remembered();
    }

    int64_t step(double* x, double*, double*, double*, double t, double h) override {
        load_row(x);
        if (memory && !(memory[0] == memory[0])) projection.begin(row.at, memory);
        const Arrays arrays(extent, saved.data(), state.data());
        std::copy_n(x, n, arrays.momenta);
        const Schedule two{t, h, 2, 1, 0, 0, 0, nullptr};
        const Crew alone{&member, 0, 1, 0};
        const int64_t wrong = loop(tables, &watch, &alone, &arrays, &two, 0, 1);
        if (wrong == NO_MEMORY) throw std::bad_alloc();
        if (wrong < 0) throw Interrupted{};
        evaluations = arrays.evaluations[0];
        iterations = arrays.iterations[0];
        residual = arrays.residual[0];
        if (wrong) return arrays.status[0];
        std::copy_n(arrays.x + n, n, x);
        load_row(x);
        const bool restored = !memory || projection.restore(row.at, owed.at, blocks, memory);
        for (int64_t b = 0; b < blocks; ++b) store(x + b * W, row.at[b]);
        if (restored) return DONE;
        residual = projection.residual;
        return residual - residual == 0.0 ? NOT_CONVERGED : OVERFLOWED;
    }

    void load_row(const double* x) {
        for (int64_t b = 0; b < blocks; ++b) row.at[b] = load<Row>(x + b * W), owed.at[b] = Row(0.0);
    }
};

}  // namespace

EXPORT StepScheme* projected_step(const StepTables& tables, const Own& constants) {
    if (tables.field.size <= 4) return new Projected<4>(tables, constants);
    return new Projected<8>(tables, constants);
}

}  // namespace coadjoint
