// One step of a program inside another step, from a finished state to a finished state, of one member or of members as
// lanes, with the constants of the tables or those of each member.
#pragma once

#include <memory>

#include "flows/compiled_rows.hpp"

namespace coadjoint {

EXPORT int64_t flow_advance_inside(const FlowTables* tables, const Watch* watch, const MemberRange* range,
                                   const Arrays* arrays, const Schedule* schedule, int64_t k0, int64_t k1);

template <class A, class C = SharedConstants>
class FinishedStep {
  public:
    typedef typename Numbers<A>::Mask Mask;
    A status{0.0}, evaluations;

    FinishedStep(const FlowTables& tables, int64_t size, const C& constants)
        : evaluations(double(rows_of_step(tables, 1).size())), tables(tables), constants(constants), size(size), work(lanes * work_of_flows(tables)),
          momentum(2 * size), scratch(3 * size), angles(tables.longest) {
        if (lanes == 1) angles.use_properties(tables);
    }

    // The step of the loop and the tables at these addresses; null if the loop is not that of programs.
    static std::unique_ptr<FinishedStep> of(const int64_t* addresses, int64_t size, const C& constants = C{}) {
        if (addresses[0] != reinterpret_cast<int64_t>(&flow_advance_inside)) return nullptr;
        return std::make_unique<FinishedStep>(*reinterpret_cast<const FlowTables*>(addresses[1]), size, constants);
    }

    // Move the members that are `moving` from the time t for the time h. One whose step is not finite stays, and has a
    // status; if only its finished state is not, that is NaN.
    void take(A* x, double t, double h, const Mask& moving) {
        InterruptCheck::of_this_call().after(work);
        std::fill_n(too_long, lanes, 0);
        std::copy_n(x, size, momentum.at);
        std::fill_n(momentum.at + size, size, A(0.0));
        apply(rows_of_step(tables, 1), t, h, too_long);
        const Mask valid = finite(size, momentum.at);
        apply(finishing_rows(tables), t, h, nullptr);
        const Mask sound = finite(size, momentum.at);
        status = A(double(DONE));
        if (__builtin_expect(all(moving & valid & sound), 1)) return void(std::copy_n(momentum.at, size, x));
        for (int64_t i = 0; i < size; ++i)
            x[i] = select(moving & valid, select(sound, momentum.at[i], A(std::numeric_limits<double>::quiet_NaN())), x[i]);
        for (int lane = 0; lane < lanes; ++lane)
            if (!at(valid, lane)) set_lane(status, lane, double(too_long[lane] ? TOO_LONG : OVERFLOWED));
    }

  private:
    static constexpr int lanes = Numbers<A>::lanes;
    const FlowTables& tables;
    const C constants;
    const int64_t size, work;
    AlignedArray<A> momentum, scratch;
    AngleWorkspace<A> angles;
    int64_t too_long[lanes];

    void apply(RowRange rows, double t, double h, int64_t* long_times) {
        const PartialStep<A> own{A(t), A(h), A(h / tables.step)};
        const PartialStep<A>* const partial = h == tables.step ? nullptr : &own;
        const Vectors<A> moved{momentum.at, momentum.at + size, 1, scratch.at, long_times};
        if constexpr (lanes == 1) {
            angles.partial_step = partial;
            const auto flows = tables.compensated ? sweep<CORRECTED, false, double, GroupRows, C>
                                                  : sweep<PLAIN, false, double, GroupRows, C>;
            flows(tables, constants, rows, moved, Vectors<GroupRows>{}, t, h, angles);
        } else {
            const RowsTarget<A, A, C> target{constants, moved, {}, partial, nullptr};
            const RowsTarget<A, A, C>* const targets = &target;
            const auto flows = tables.compensated ? sweep_groups<CORRECTED, false, A, A, C>
                                                  : sweep_groups<PLAIN, false, A, A, C>;
            flows(tables, &targets, 1, rows, A(t), h, angles);
        }
    }
};

}  // namespace coadjoint
