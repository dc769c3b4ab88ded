// The loop over steps of programs, for one trajectory.
#pragma once

#include <memory>

#include "flows/elementary_flows.hpp"

namespace coadjoint {

// The rows of the group element are lanes, and finished states are lanes of steps.
constexpr int ROWS = 4;
typedef Lanes<ROWS> GroupRows;

template <Summation summation, class A>
struct Finisher {
    static constexpr bool nothing = false, with_errors = summation != PLAIN;
    typedef std::conditional_t<Numbers<A>::lanes == 1, GroupRows, A> Rows;
    const FlowTables& tables;
    const Schedule& schedule;
    AlignedArray<A> scratch;
    AngleWorkspace<A> angles;
    PartialStep<A> partial_step;

    Finisher(const FlowTables& tables, const Schedule& schedule, int64_t size, int64_t member)
        : tables(tables), schedule(schedule), scratch(3 * size), angles(tables.longest) {
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane) partial_step.set(tables, schedule, member, lane);
        if (partial_step.needed) angles.partial_step = &partial_step;
    }

    void operator()(A* x, A* dx, const A& t) {
        sweep<summation, false>(tables, SharedConstants{}, tables.section[2], tables.section[3],
                                Vectors<A>{x, dx, 1, scratch.at}, Vectors<Rows>{}, t, schedule.h, angles);
    }
};

template <Summation summation, bool with_group, class Side>
void advance_alone(const FlowLoop& loop, int64_t member) {
    const FlowTables& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t size = arrays.size, d = tables.group.size, rows = (d + ROWS - 1) / ROWS;
    // Plain sums have no errors to be copied.
    const int64_t carried = summation == PLAIN ? size : 2 * size;
    AlignedArray<double> scratch(3 * size), copies(2 * size), momenta(2 * size), checkpoint_momenta(2 * size);
    AlignedArray<GroupRows> elements(2 * d * rows), finished(2 * d * rows), group_scratch(3 * d * rows);
    AlignedArray<GroupRows> checkpoint_elements(with_group ? 2 * d * rows : 0);
    AngleWorkspace<double> angles(tables.longest);
    angles.use_properties(tables);
    SharedSteps shared_steps(schedule.threads, size);
    PartialStep<double> partial_step;
    partial_step.set(tables, schedule, member, 0);
    if (partial_step.needed) angles.partial_step = &partial_step;
    Finisher<summation, Side> finisher(tables, schedule, size, member);
    finisher.angles.even = angles.even, finisher.angles.following = angles.following;
    MemberRecorder<Side, SharedConstants, Finisher<summation, Side>> recorder(loop.watch, arrays, schedule,
                                                                              SharedConstants{}, finisher);
    recorder.begin(member, SharedConstants{}, loop.k0);
    double *x = momenta.at, *dx = momenta.at + size;
    shared_steps.begin_as_measured();
    shared_copy(arrays.momenta + member * size, size, x);
    shared_steps.end_as_measured();
    if (carried > size) std::copy_n(arrays.errors + member * size, size, dx);
    const Vectors<GroupRows> group{elements.at, elements.at + d * rows, rows, group_scratch.at};
    auto each_entry = [&](auto&& visit) {
        for (int64_t i = 0; i < d; ++i)
            for (int64_t r = 0; r < d; ++r) visit(i * d + r, (i * rows + r / ROWS) * ROWS + r % ROWS);
    };
    double *g = reinterpret_cast<double*>(group.at), *dg = reinterpret_cast<double*>(group.errors);
    if constexpr (with_group)
        each_entry([&](int64_t from, int64_t to) {
            g[to] = arrays.groups[member * d * d + from];
            dg[to] = arrays.group_errors[member * d * d + from];
        });
    const Vectors<double> momentum{x, dx, 1, scratch.at};
    // The group element is finished on a copy, and rotated by angles of a copy of the momentum.
    auto finish_copies = [&](int64_t k) {
        shared_copy(x, carried, copies.at);
        if (with_group) std::copy_n(elements.at, 2 * d * rows, finished.at);
        const double t = start_of(schedule, member, k);
        const Vectors<GroupRows> copy{finished.at, finished.at + d * rows, rows, group_scratch.at};
        sweep<summation, with_group>(tables, SharedConstants{}, tables.section[2], tables.section[3],
                                     Vectors<double>{copies.at, copies.at + size, 1, scratch.at}, copy, t, schedule.h,
                                     angles);
    };
    auto finished_group = [&](int64_t k, double* to) {
        if constexpr (with_group) {
            finish_copies(k);
            const double* element = reinterpret_cast<double*>(finished.at);
            bool valid = true;
            each_entry([&](int64_t, int64_t from) { valid &= 0.0 * element[from] == 0.0; });
            if (valid) each_entry([&](int64_t position, int64_t from) { to[position] = element[from]; });
            return valid;
        } else {
            return true;
        }
    };
    FlowsOfRows flows_of(tables, with_group);
    std::vector<ElementaryFlow> opening, repeated;
    if (!partial_step.needed) {  // they contain the angles of the tables
        opening = flows_of(tables.section[0], tables.section[loop.k0 == 0]);
        repeated = flows_of(tables.section[1], tables.section[loop.k1 > 1 ? 2 : 1]);
    }
    int64_t checkpoint = loop.k0;  // of which the arrays of the run have the momenta
    if (with_group) std::copy_n(elements.at, 2 * d * rows, checkpoint_elements.at);
    const auto store_checkpoint = [&](int64_t k) {
        checkpoint = k;
        shared_copy(x, carried, checkpoint_momenta.at);
        if (with_group) std::copy_n(elements.at, 2 * d * rows, checkpoint_elements.at);
    };
    const auto is_finite = [&](const double* at, const GroupRows* element) {
        return finite(size, at) && (!with_group || all(finite(d * rows, element)));
    };
    // The step in which a number of step k became infinite: if already the finish of the previous step overflows, it
    // was that one.
    const auto step_that_failed = [&](int64_t k) {
        if (k == 1) return k;
        if (checkpoint == loop.k0) {
            std::copy_n(arrays.momenta + member * size, size, x);
            if (carried > size) std::copy_n(arrays.errors + member * size, size, dx);
        } else {
            std::copy_n(checkpoint_momenta.at, carried, x);
        }
        if (with_group) std::copy_n(checkpoint_elements.at, 2 * d * rows, elements.at);
        for (int64_t again = checkpoint + 1; again < k; ++again)
            sweep<summation, with_group>(tables, SharedConstants{}, tables.section[again == 1 ? 0 : 1],
                                         tables.section[again == 1 ? 1 : 2], momentum, group,
                                         start_of(schedule, member, again), schedule.h, angles);
        finish_copies(k - 1);
        return is_finite(copies.at, finished.at) ? k : k - 1;
    };
    int64_t failed = 0;
    const int64_t work = work_of_step(loop);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        shared_steps.begin();
        const double t = start_of(schedule, member, k);
        const std::vector<ElementaryFlow>& flows = k == 1 ? opening : repeated;
        for (const ElementaryFlow& flow : flows)
            if (__builtin_expect(flow.kind != WHOLE_ROW, 1))
                apply_flow<summation, with_group>(flow, momentum, group);
            else
                sweep<summation, with_group>(tables, SharedConstants{}, flow.row, flow.row + 1, momentum, group, t,
                                             schedule.h, angles);
        if (flows.empty())
            sweep<summation, with_group>(tables, SharedConstants{}, tables.section[k == 1 ? 0 : 1],
                                         tables.section[k == 1 ? 1 : 2], momentum, group, t, schedule.h, angles);
        if (__builtin_expect(!is_finite(x, elements.at), 0)) {
            failed = step_that_failed(k);
            break;
        }
        if (k % CHECKPOINT_INTERVAL == 0) store_checkpoint(k);
        if ((failed = recorder.after(k, x, dx, finished_group))) break;
        shared_steps.end();
    }
    // Momenta are finished several at a time; a pending one may have failed earlier.
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    loop.arrays.evaluations[member] += rows_applied(tables, loop.k0, failed ? failed : loop.k1);
    if (failed) loop.overflow(member, failed);
    shared_steps.begin_as_measured();
    shared_copy(x, size, arrays.momenta + member * size);
    shared_steps.end_as_measured();
    if (carried > size) std::copy_n(dx, size, arrays.errors + member * size);
    if constexpr (with_group)
        each_entry([&](int64_t to, int64_t from) {
            arrays.groups[member * d * d + to] = g[from];
            arrays.group_errors[member * d * d + to] = dg[from];
        });
}

}  // namespace coadjoint
