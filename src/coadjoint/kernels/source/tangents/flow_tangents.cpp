// Entry points of flow methods with tangent vectors for Python.
#include "flows/compiled_rows.hpp"
#include "flows/flow_lanes.hpp"
#include "tangents/flow_tangents.hpp"

namespace coadjoint {

COMPILED_TANGENT_STATE()

typedef Loop<FlowTangents> FlowTangentLoop;

// Members are lanes if the vectors of each have at most this many numbers; lanes of vectors then stay in the cache.
constexpr int64_t LARGEST_IN_LANES = 512;

static FlowLoop without_tangents(const FlowTangentLoop& loop) {
    return {loop.tables.base, loop.watch, loop.schedule, loop.arrays, loop.interrupts, loop.k0, loop.k1};
}

static void advance_member(const FlowTangentLoop& loop, int64_t member) {
    typedef ManyMembers Side;
    const FlowLoop plain = without_tangents(loop);
    const FlowTables& tables = plain.tables;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size;
    TangentBundle<double, TangentLanes> bundle(loop.tables.tangents);
    bundle.begin(loop.memory_of(member), loop.k0 == 0);
    FlowTangentState<double, TangentLanes, SharedConstants> tangent_state(
        tables, SharedConstants{}, loop.tables.tangents.hessians, size, bundle.rows);
    const auto sweep_momentum = tables.compensated ? sweep<CORRECTED, false, double, GroupRows, SharedConstants>
                                                   : sweep<PLAIN, false, double, GroupRows, SharedConstants>;
    RecorderBySize<Side> recorder(plain, member,
                                  tables.compensated ? sweep<CORRECTED, false, Side, Side, SharedConstants>
                                                     : sweep<PLAIN, false, Side, Side, SharedConstants>,
                                  sweep_momentum, tables.compensated);
    LoneMember alone(plain, member, 2 * size, sweep_momentum);
    const Vectors<double> momentum = alone.momentum();
    tangent_state.too_long = momentum.too_long;
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(plain);
    int64_t failed = 0, k = loop.k0 + 1;
    bool parallel = false;
    const auto no_group = [](int64_t, double*) { return true; };
    for (; k <= loop.k1 && !failed && !parallel; ++k) {
        loop.interrupts.after(work);
        alone.shared_steps.begin();
        tangent_state.sweep(rows_of_step(tables, k), momentum.at, momentum.errors, bundle.held(),
                            start_of(schedule, member, k), schedule.h);
        if (!finite(size, momentum.at)) {
            failed = alone.step_that_failed(k);
            break;
        }
        if (k % CHECKPOINT_INTERVAL == 0) alone.store_checkpoint(k);
        if (!(failed = recorder.after(k, momentum.at, momentum.errors, no_group))) parallel = !bundle.after(k);
        alone.shared_steps.end();
    }
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    if (!failed && !parallel)
        bundle.end(
            1, [&](int) { return loop.memory_of(member); },
            [&](TangentLanes* vectors) {
                AlignedArray<double> copies(2 * size);
                std::copy_n(momentum.at, 2 * size, copies.at);
                tangent_state.sweep(finishing_rows(tables), copies.at, copies.at + size, vectors,
                                    start_of(schedule, member, loop.k1), schedule.h);
            });
    alone.end(failed ? failed : parallel ? k - 1 : 0, failed ? OVERFLOWED : PARALLEL);
}

// Members as lanes, each with all of its vectors.
static void advance_lanes(const FlowTangentLoop& loop, const int64_t* members, int64_t count) {
    typedef ManyMembers A;
    const FlowTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size;
    const FlowLoop plain = without_tangents(loop);
    AlignedArray<A> scratch(3 * size), copies(2 * size);
    AngleWorkspace<A> angles(tables.longest);
    TangentBundle<A, A> bundle(loop.tables.tangents);
    const auto memory_of = [&](int lane) { return loop.memory_of(members[std::min<int64_t>(lane, count - 1)]); };
    for (int lane = 0; lane < MEMBER_LANES; ++lane) bundle.begin(memory_of(lane), loop.k0 == 0, lane);
    FlowTangentState<A, A, SharedConstants> tangent_state(
        tables, SharedConstants{}, loop.tables.tangents.hessians, size, bundle.rows);
    const auto sweep_momenta = tables.compensated ? sweep_groups<CORRECTED, false, A, A, SharedConstants>
                                                  : sweep_groups<PLAIN, false, A, A, SharedConstants>;
    FlowLanes<A, SharedConstants> lane_group(plain, SharedConstants{}, {sweep_momenta, sweep_momenta}, members, count,
                                             scratch);
    tangent_state.too_long = lane_group.too_long;
    const int64_t work = (1 + bundle.rows) * MEMBER_LANES * work_of_step(plain);
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && lane_group.left > 0; ++k) {
        loop.interrupts.after(work);
        const A t = lane_group.start_of_step(k);
        const RowRange rows = rows_of_step(tables, k);
        tangent_state.sweep(rows, lane_group.momentum.at, lane_group.momentum.errors, bundle.held(), t, schedule.h);
        lane_group.after(k, rows.size(), t, copies.at, scratch.at, angles);
        lane_group.stop_where_not(bundle.after(k), k, PARALLEL);
    }
    bundle.end(int(count), memory_of, [&](A* vectors) {
        std::copy_n(lane_group.momentum.at, 2 * size, copies.at);
        tangent_state.sweep(finishing_rows(tables), copies.at, copies.at + size, vectors,
                            lane_group.start_of_step(loop.k1), schedule.h);
    });
}

static void advance(const FlowTangentLoop& loop, const MemberRange& range) {
    const int64_t size = loop.arrays.size;
    const bool narrow = size <= WIDEST && size * loop.tables.tangents.carried <= LARGEST_IN_LANES;
    int64_t position = range.first;
    for (; narrow && range.last - position >= MIN_LANES; position += MEMBER_LANES)
        advance_lanes(loop, range.members + position, std::min<int64_t>(MEMBER_LANES, range.last - position));
    for (; position < range.last; ++position) {
        const int64_t member = range.members[position];
        if (loop.arrays.status[member] == DONE) advance_member(loop, member);
    }
}

static int64_t memory_size(const FlowTangents& tables) { return memory_size(tables.tangents); }

EXPORT_LOOP(flow_tangents_advance, FlowTangents, advance, memory_size)

}  // namespace coadjoint
