// Entry points of Runge-Kutta methods with tangent vectors for Python: derivatives of their stages.
#include "tangents/bundle.hpp"
#include "tangents/stage_derivatives.hpp"

namespace coadjoint {

typedef Loop<RungeKuttaTangents> RungeKuttaTangentLoop;

// The tangent vectors of a trajectory. The equations of their stages are solved by factors, with the same bits in every
// step; vectors without a derivative end the run.
class TangentsAlong {
  public:
    explicit TangentsAlong(const RungeKuttaTangents& tables)
        : substeps(tables.base.substeps),
          derivatives{tables.base, tables.tangents.hessians, tables.tangents.derivative, Terms{}, nullptr},
          bundle(tables.tangents), points(derivatives), stages(points, bundle.rows, true),
          slopes(slope_memory_size(tables.base)) {}

    int64_t work_of_step(int64_t of_trajectory) const { return (1 + 4 * bundle.rows) * of_trajectory; }
    void begin(double* memory, bool starting) { bundle.begin(memory, starting); }

    bool substep(Single& one, double t, double h) {
        one.write_slopes(slopes.data());
        points.begin(one.x, one.g, t, h, slopes.data() + substeps);
        try {
            stages.move(bundle.held(), nullptr, nullptr);
        } catch (const NotSolved&) {
            return false;
        }
        return true;
    }

    bool after(int64_t k) { return bundle.after(k); }
    void end(double* memory) {
        bundle.end(1, [&](int) { return memory; }, [](TangentLanes*) {});
    }

  private:
    const int64_t substeps;
    const RungeKuttaCotangents derivatives;
    TangentBundle<double, TangentLanes> bundle;
    StagePoints points;
    StageTangents<TangentLanes> stages;
    std::vector<double> slopes;
};

static void advance(const RungeKuttaTangentLoop& loop, const MemberRange& range) {
    typedef Lanes<MEMBER_LANES> LaneNumbers;
    const RungeKuttaTables& tables = loop.tables.base;
    const RungeKuttaLoop plain{tables, loop.watch, loop.schedule, loop.arrays, loop.interrupts, loop.k0, loop.k1};
    TangentsAlong tangents(loop.tables);
    const auto one = single_of(tables, SharedConstants{});
    for (int64_t position = range.first; position < range.last; ++position) {
        const int64_t member = range.members[position];
        if (loop.arrays.status[member] != DONE) continue;
        if (tables.field.size <= WIDEST)
            advance_alone<LaneNumbers>(plain, *one, member, SharedConstants{}, tangents);
        else
            advance_alone<double>(plain, *one, member, SharedConstants{}, tangents);
    }
}

static int64_t memory_size(const RungeKuttaTangents& tables) {
    return memory_size(tables.base) + memory_size(tables.tangents);
}

EXPORT_LOOP(runge_kutta_tangents_advance, RungeKuttaTangents, advance, memory_size)

}  // namespace coadjoint
