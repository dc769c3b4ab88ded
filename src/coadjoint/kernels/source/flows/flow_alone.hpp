// The loop over steps of programs, for one trajectory.
#pragma once

#include <optional>

#include "flows/elementary_flows.hpp"

namespace coadjoint {

// The rows of the group element are lanes, and finished states are lanes of steps.
constexpr int ROWS = 4;
typedef Lanes<ROWS> GroupRows;

// `sweep` with some sums, with the group element or without.
template <class A, class G>
using Sweep = void (*)(const FlowTables&, const SharedConstants&, RowRange, const Vectors<A>&,
                       const Vectors<G>&, const A&, double, AngleWorkspace<A>&);

template <class A>
struct Finisher {
    typedef std::conditional_t<Numbers<A>::lanes == 1, GroupRows, A> Rows;
    static constexpr bool nothing = false;
    const bool with_errors;
    const FlowTables& tables;
    const Schedule& schedule;
    const Sweep<A, Rows> sweep;
    AlignedArray<A> scratch;
    AngleWorkspace<A> angles;
    PartialStep<A> partial_step;

    Finisher(const FlowLoop& loop, int64_t member, Sweep<A, Rows> sweep, bool with_errors)
        : with_errors(with_errors), tables(loop.tables), schedule(loop.schedule), sweep(sweep),
          scratch(3 * loop.arrays.size), angles(tables.longest) {
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane) partial_step.set(tables, schedule, member, lane);
        if (partial_step.needed) angles.partial_step = &partial_step;
    }

    void operator()(A* x, A* dx, const A& t) {
        sweep(tables, SharedConstants{}, finishing_rows(tables), Vectors<A>{x, dx, 1, scratch.at},
              Vectors<Rows>{}, t, schedule.h, angles);
    }
};

// The recorder of one member, whose finished states are of the type `Side`.
template <class Side>
struct FinishingRecorder {
    Finisher<Side> finisher;
    MemberRecorder<Side, SharedConstants, Finisher<Side>> recorder;

    FinishingRecorder(const FlowLoop& loop, int64_t member, Sweep<Side, typename Finisher<Side>::Rows> sweep,
                      bool with_errors)
        : finisher(loop, member, sweep, with_errors),
          recorder(loop.watch, loop.arrays, loop.schedule, SharedConstants{}, finisher) {
        recorder.begin(member, SharedConstants{}, loop.k0);
    }

    template <class Group>
    INLINE int64_t after(int64_t k, const double* x, const double* dx, const Group& group) {
        return recorder.after(k, x, dx, group);
    }
    int64_t flush() { return recorder.flush(); }
    void use_properties(const AngleWorkspace<double>& of_steps) {
        finisher.angles.even = of_steps.even, finisher.angles.following = of_steps.following;
    }
};

// With lanes, unless the state is too large for them; then a step is long, and recorded by a call. So loops over steps
// are compiled once.
template <class Side>
class RecorderBySize {
  public:
    RecorderBySize(const FlowLoop& loop, int64_t member, Sweep<Side, Side> sweep, Sweep<double, GroupRows> wide_sweep,
                   bool with_errors) {
        if (loop.arrays.size <= WIDEST)
            narrow.emplace(loop, member, sweep, with_errors);
        else
            wide.emplace(loop, member, wide_sweep, with_errors);
    }

    template <class Group>
    INLINE int64_t after(int64_t k, const double* x, const double* dx, const Group& group) {
        return narrow ? narrow->after(k, x, dx, group) : after_wide(k, x, dx, group);
    }
    int64_t flush() { return narrow ? narrow->flush() : wide->flush(); }
    void use_properties(const AngleWorkspace<double>& of_steps) {
        narrow ? narrow->use_properties(of_steps) : wide->use_properties(of_steps);
    }

  private:
    std::optional<FinishingRecorder<Side>> narrow;
    std::optional<FinishingRecorder<double>> wide;

    NOINLINE int64_t after_wide(int64_t k, const double* x, const double* dx,
                                const Called<bool(int64_t, double*)>& group) {
        return wide->after(k, x, dx, group);
    }
};

// The state of one trajectory, and all but the flows of its steps.
class LoneMember {
  public:
    const FlowLoop& loop;
    const FlowTables& tables;
    const Schedule& schedule;
    const int64_t member, size, d, rows, square;
    AlignedArray<double> momenta;
    AlignedArray<GroupRows> elements;
    AngleWorkspace<double> angles;
    SharedSteps shared_steps;
    PartialStep<double> partial_step;
    std::vector<ElementaryFlow<double>> opening, repeated;

    // `carried` numbers of the momentum and its errors.
    LoneMember(const FlowLoop& loop, int64_t member, int64_t carried, Sweep<double, GroupRows> sweep)
        : loop(loop), tables(loop.tables), schedule(loop.schedule), member(member), size(loop.arrays.size),
          d(loop.arrays.square > 0 ? tables.group.size : 0), rows((d + ROWS - 1) / ROWS), square(d * rows),
          momenta(2 * size), elements(2 * square), angles(tables.longest), shared_steps(schedule.threads, size),
          carried(carried), sweep(sweep), scratch(3 * size), copies(2 * size), checkpoint_momenta(2 * size),
          finished(2 * square), group_scratch(3 * square), checkpoint_elements(2 * square), checkpoint(loop.k0) {
        angles.use_properties(tables);
        partial_step.set(tables, schedule, member, 0);
        if (partial_step.needed) angles.partial_step = &partial_step;
        shared_steps.begin_as_measured();
        shared_copy(loop.arrays.momenta + member * size, size, momenta.at);
        shared_steps.end_as_measured();
        if (carried > size) std::copy_n(loop.arrays.errors + member * size, size, momenta.at + size);
        double *g = reinterpret_cast<double*>(elements.at), *dg = reinterpret_cast<double*>(elements.at + square);
        each_entry([&](int64_t from, int64_t to) {
            g[to] = loop.arrays.groups[member * d * d + from];
            dg[to] = loop.arrays.group_errors[member * d * d + from];
        });
        std::copy_n(elements.at, 2 * square, checkpoint_elements.at);
        if (partial_step.needed) return;  // flows contain the angles of the tables
        FlowsOfRows<double, SharedConstants> flows_of(tables, SharedConstants{}, loop.arrays.square > 0);
        if (loop.k0 == 0) opening = flows_of(rows_of_step(tables, 1));
        if (loop.k1 > 1) repeated = flows_of(rows_of_step(tables, 2));
    }

    Vectors<double> momentum() { return {momenta.at, momenta.at + size, 1, scratch.at, &too_long}; }
    Vectors<GroupRows> group() { return {elements.at, elements.at + square, rows, group_scratch.at, &too_long}; }

    NOINLINE void store_checkpoint(int64_t k) {
        checkpoint = k;
        shared_copy(momenta.at, carried, checkpoint_momenta.at);
        std::copy_n(elements.at, 2 * square, checkpoint_elements.at);
    }

    // The step in which a number of step k became infinite: if already the finish of the previous step overflows, it
    // was that one.
    NOINLINE int64_t step_that_failed(int64_t k) {
        if (k == 1) return k;
        if (checkpoint == loop.k0) {
            std::copy_n(loop.arrays.momenta + member * size, size, momenta.at);
            if (carried > size) std::copy_n(loop.arrays.errors + member * size, size, momenta.at + size);
        } else {
            std::copy_n(checkpoint_momenta.at, carried, momenta.at);
        }
        std::copy_n(checkpoint_elements.at, 2 * square, elements.at);
        for (int64_t again = checkpoint + 1; again < k; ++again)
            sweep(tables, SharedConstants{}, rows_of_step(tables, again), momentum(), group(),
                  start_of(schedule, member, again), schedule.h, angles);
        finish_copies(k - 1);
        if (finite(size, copies.at) && all(finite(square, finished.at))) return k;
        too_long = 0;
        return k - 1;
    }

    // Fill in the finished group element of step k; return whether it is finite.
    NOINLINE bool finished_group(int64_t k, double* to) {
        finish_copies(k);
        const double* element = reinterpret_cast<double*>(finished.at);
        bool valid = true;
        each_entry([&](int64_t, int64_t from) { valid &= 0.0 * element[from] == 0.0; });
        if (valid) each_entry([&](int64_t position, int64_t from) { to[position] = element[from]; });
        return valid;
    }

    void end(int64_t failed, int64_t status = OVERFLOWED) {
        const Arrays& arrays = loop.arrays;
        arrays.evaluations[member] += rows_applied(tables, loop.k0, failed ? failed : loop.k1);
        if (failed && status == OVERFLOWED) loop.overflow(member, failed, too_long);
        if (failed && status != OVERFLOWED) loop.fail(member, failed, status, std::numeric_limits<double>::quiet_NaN());
        shared_steps.begin_as_measured();
        shared_copy(momenta.at, size, arrays.momenta + member * size);
        shared_steps.end_as_measured();
        if (carried > size) std::copy_n(momenta.at + size, size, arrays.errors + member * size);
        const double *g = reinterpret_cast<double*>(elements.at), *dg = reinterpret_cast<double*>(elements.at + square);
        each_entry([&](int64_t to, int64_t from) {
            arrays.groups[member * d * d + to] = g[from];
            arrays.group_errors[member * d * d + to] = dg[from];
        });
    }

  private:
    const int64_t carried;
    int64_t too_long = 0;
    const Sweep<double, GroupRows> sweep;
    AlignedArray<double> scratch, copies, checkpoint_momenta;
    AlignedArray<GroupRows> finished, group_scratch, checkpoint_elements;
    int64_t checkpoint;  // of which the arrays of the run have the momenta

    // Of an entry, the positions in the group element of a run and in these lanes.
    template <class Visit>
    void each_entry(const Visit& visit) const {
        for (int64_t i = 0; i < d; ++i)
            for (int64_t r = 0; r < d; ++r) visit(i * d + r, (i * rows + r / ROWS) * ROWS + r % ROWS);
    }

    // The group element is finished on a copy, and rotated by angles of a copy of the momentum.
    void finish_copies(int64_t k) {
        shared_copy(momenta.at, carried, copies.at);
        std::copy_n(elements.at, 2 * square, finished.at);
        sweep(tables, SharedConstants{}, finishing_rows(tables),
              Vectors<double>{copies.at, copies.at + size, 1, scratch.at},
              Vectors<GroupRows>{finished.at, finished.at + square, rows, group_scratch.at},
              start_of(schedule, member, k), schedule.h, angles);
    }
};

template <Summation summation, bool with_group, class Recorder>
NOINLINE void take_steps_alone(LoneMember& alone, Recorder& recorder) {
    const FlowLoop& loop = alone.loop;
    const FlowTables& tables = alone.tables;
    const Schedule& schedule = alone.schedule;
    const int64_t work = work_of_step(loop), member = alone.member, size = alone.size, square = alone.square;
    SharedSteps& shared_steps = alone.shared_steps;
    int64_t failed = 0;
    const Vectors<double> momentum = alone.momentum();
    const Vectors<GroupRows> group = alone.group();
    const auto finished_group = [&](int64_t k, double* to) { return !with_group || alone.finished_group(k, to); };
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        shared_steps.begin();
        const double t = start_of(schedule, member, k);
        const std::vector<ElementaryFlow<double>>& flows = k == 1 ? alone.opening : alone.repeated;
        for (const ElementaryFlow<double>& flow : flows)
            if (__builtin_expect(flow.kind != WHOLE_ROW, 1))
                apply_flow<summation, with_group>(flow, SharedConstants{}, momentum, group);
            else
                sweep<summation, with_group>(tables, SharedConstants{}, {flow.row, flow.row + 1}, momentum, group, t,
                                             schedule.h, alone.angles);
        if (flows.empty())
            sweep<summation, with_group>(tables, SharedConstants{}, rows_of_step(tables, k), momentum, group, t,
                                         schedule.h, alone.angles);
        if (__builtin_expect(!finite(size, momentum.at) ||
                                 (with_group && !all(finite(square, group.at))), 0)) {
            failed = alone.step_that_failed(k);
            break;
        }
        if (k % CHECKPOINT_INTERVAL == 0) alone.store_checkpoint(k);
        if ((failed = recorder.after(k, momentum.at, momentum.errors, finished_group))) break;
        shared_steps.end();
    }
    // Momenta are finished several at a time; a pending one may have failed earlier.
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    alone.end(failed);
}

// Finished states are numbers of the type `Side`, unless it has lanes and the state is too large for them.
template <Summation summation, bool with_group, class Side>
void advance_alone(const FlowLoop& loop, int64_t member) {
    constexpr auto sweep_all = sweep<summation, with_group, double, GroupRows, SharedConstants>;
    constexpr auto sweep_momentum = sweep<summation, false, double, GroupRows, SharedConstants>;
    // Plain sums have no errors to be copied.
    constexpr bool with_errors = summation != PLAIN;
    LoneMember alone(loop, member, (with_errors ? 2 : 1) * loop.arrays.size, sweep_all);
    const auto take_steps = [&](auto&& recorder) {
        recorder.use_properties(alone.angles);
        take_steps_alone<summation, with_group>(alone, recorder);
    };
    if constexpr (Numbers<Side>::lanes == 1)
        take_steps(FinishingRecorder<double>(loop, member, sweep_momentum, with_errors));
    else
        take_steps(RecorderBySize<Side>(loop, member, sweep<summation, false, Side, Side, SharedConstants>,
                                        sweep_momentum, with_errors));
}

}  // namespace coadjoint
