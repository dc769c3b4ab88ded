// Entry points of flow methods with tangent vectors for Python.
#include "flows/compiled_rows.hpp"
#include "flows/flow_lanes.hpp"
#include "tangents/flow_tangents.hpp"

namespace coadjoint {

typedef Loop<FlowTangents> FlowTangentLoop;

// Members are lanes if the vectors of each have at most this many numbers; lanes of vectors then stay in the cache.
constexpr int64_t LARGEST_IN_LANES = 512;

static FlowLoop without_tangents(const FlowTangentLoop& loop) {
    return {loop.tables.base, loop.watch, loop.schedule, loop.arrays, loop.interrupts, loop.k0, loop.k1};
}

static void advance_member(const FlowTangentLoop& loop, int64_t member) {
    const FlowTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t size = arrays.size;
    TangentBundle<double, TangentLanes> bundle(loop.tables.tangents);
    bundle.begin(loop.memory_of(member), loop.k0 == 0);
    FlowTangentState<double, TangentLanes, SharedConstants> tangent_state(
        tables, SharedConstants{}, loop.tables.tangents.hessians, size, bundle.rows);
    RecorderBySize<ManyMembers> recorder(
        without_tangents(loop), member,
        tables.compensated ? sweep<CORRECTED, false, ManyMembers, ManyMembers, SharedConstants>
                           : sweep<PLAIN, false, ManyMembers, ManyMembers, SharedConstants>,
        tables.compensated ? sweep<CORRECTED, false, double, GroupRows, SharedConstants>
                           : sweep<PLAIN, false, double, GroupRows, SharedConstants>,
        tables.compensated);
    AlignedArray<double> momenta(2 * size), copies(2 * size);
    double *x = momenta.at, *dx = momenta.at + size;
    std::copy_n(arrays.momenta + member * size, size, x);
    std::copy_n(arrays.errors + member * size, size, dx);
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(without_tangents(loop));
    int64_t failed = 0, too_long = 0, k = loop.k0 + 1;
    tangent_state.too_long = &too_long;
    bool parallel = false;
    const auto no_group = [](int64_t, double*) { return true; };
    SharedSteps shared_steps(schedule.threads, size);
    for (; k <= loop.k1 && !failed && !parallel; ++k) {
        loop.interrupts.after(work);
        shared_steps.begin();
        const double t = schedule.t0 + double(k - 1) * schedule.h;
        tangent_state.sweep(tables.section[k == 1 ? 0 : 1], tables.section[k == 1 ? 1 : 2], x, dx, bundle.held(), t,
                            schedule.h);
        if (!finite(size, x))
            failed = k;
        else if (!(failed = recorder.after(k, x, dx, no_group)))
            parallel = !bundle.after(k);
        shared_steps.end();
    }
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    const int64_t last = failed ? failed : k - 1, taken = last - loop.k0, start = loop.k0 == 0;
    arrays.evaluations[member] += start * (int64_t(tables.section[1]) - tables.section[0]) +
                                  (taken - start) * (int64_t(tables.section[2]) - tables.section[1]);
    if (failed)
        loop.overflow(member, failed, too_long && failed == k - 1);
    else if (parallel)
        loop.fail(member, last, PARALLEL, std::numeric_limits<double>::quiet_NaN());
    else
        bundle.end(
            1, [&](int) { return loop.memory_of(member); },
            [&](TangentLanes* vectors) {
                std::copy_n(x, 2 * size, copies.at);
                tangent_state.sweep(tables.section[2], tables.section[3], copies.at, copies.at + size, vectors,
                                    schedule.t0 + double(last - 1) * schedule.h, schedule.h);
            });
    std::copy_n(x, size, arrays.momenta + member * size);
    std::copy_n(dx, size, arrays.errors + member * size);
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
    A t(schedule.t0);
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && lane_group.left > 0; ++k) {
        loop.interrupts.after(work);
        t = A(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t from = tables.section[k == 1 ? 0 : 1], to = tables.section[k == 1 ? 1 : 2];
        tangent_state.sweep(from, to, lane_group.momentum.at, lane_group.momentum.errors, bundle.held(), t, schedule.h);
        lane_group.evaluations += to - from;
        lane_group.stop_where_not(finite(size, lane_group.momentum.at), k);
        lane_group.recorder.after(
            k, [&](bool saving) { return lane_group.finished(k, saving, t, copies.at, scratch.at, angles); });
        lane_group.stop_where_not(bundle.after(k), k, PARALLEL);
    }
    bundle.end(int(count), memory_of, [&](A* vectors) {
        std::copy_n(lane_group.momentum.at, 2 * size, copies.at);
        tangent_state.sweep(tables.section[2], tables.section[3], copies.at, copies.at + size, vectors, t, schedule.h);
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
