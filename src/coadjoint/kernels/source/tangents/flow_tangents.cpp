// Entry points of flow methods with tangent vectors for Python.
#include "flows/flow_crowd.hpp"
#include "tangents/flow_tangents.hpp"

namespace coadjoint {

typedef Loop<FlowTangents> FlowTangentLoop;

// Members are side by side if the vectors of each have at most this many numbers; lanes of vectors then stay in the
// cache.
constexpr int64_t MOST_TOGETHER = 512;

static FlowLoop without_tangents(const FlowTangentLoop& loop) {
    return {loop.tables.base, loop.watch, loop.schedule, loop.arrays, loop.hearing, loop.k0, loop.k1};
}

template <Care care, class Side>
static void follow_member(const FlowTangentLoop& loop, int64_t member) {
    const FlowTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t size = arrays.size;
    Bundle<double, Abreast> bundle(loop.tables.tangents);
    bundle.begin(loop.memory_of(member), loop.k0 == 0);
    FlowTraveller<care, double, Abreast> traveller(loop.tables, size, bundle.rows);
    Room<double> momenta(2 * size), copies(2 * size);
    double *x = momenta.at, *dx = momenta.at + size;
    std::copy_n(arrays.momenta + member * size, size, x);
    std::copy_n(arrays.errors + member * size, size, dx);
    Finisher<care, Side> finisher(tables, schedule, size, member);
    MemberRecorder<Side, Shared, Finisher<care, Side>> recorder(loop.watch, arrays, schedule, Shared{}, finisher);
    recorder.begin(member, Shared{}, loop.k0);
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(without_tangents(loop));
    int64_t failed = 0, k = loop.k0 + 1;
    bool parallel = false;
    for (; k <= loop.k1 && !failed && !parallel; ++k) {
        loop.hearing.after(work);
        const double t = schedule.t0 + double(k - 1) * schedule.h;
        traveller.sweep(tables.section[k == 1 ? 0 : 1], tables.section[k == 1 ? 1 : 2], x, dx, bundle.held(), t,
                        schedule.h);
        if (!finite(size, x))
            failed = k;
        else if (!(failed = recorder.after(k, x, dx, [](int64_t, double*) { return true; })))
            parallel = !bundle.after(k);
    }
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    const int64_t last = failed ? failed : k - 1, taken = last - loop.k0, start = loop.k0 == 0;
    arrays.evaluations[member] += start * (int64_t(tables.section[1]) - tables.section[0]) +
                                  (taken - start) * (int64_t(tables.section[2]) - tables.section[1]);
    if (failed)
        loop.overflow(member, failed);
    else if (parallel)
        loop.fail(member, last, PARALLEL, std::numeric_limits<double>::quiet_NaN());
    else
        bundle.end(1, [&](int) { return loop.memory_of(member); }, [&](Abreast* vectors) {
            std::copy_n(x, 2 * size, copies.at);
            traveller.sweep(tables.section[2], tables.section[3], copies.at, copies.at + size, vectors,
                            schedule.t0 + double(last - 1) * schedule.h, schedule.h);
        });
    std::copy_n(x, size, arrays.momenta + member * size);
    std::copy_n(dx, size, arrays.errors + member * size);
}

// Members as lanes, each with all of its vectors.
template <Care care>
static void follow_crowd(const FlowTangentLoop& loop, const int64_t* members, int64_t count) {
    typedef Lanes<CROWD> A;
    const FlowTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const int64_t size = loop.arrays.size;
    const FlowLoop plain = without_tangents(loop);
    Room<A> scratch(3 * size), copies(2 * size);
    AngleRoom<A> angles(tables.longest);
    Bundle<A, A> bundle(loop.tables.tangents);
    const auto memory_of = [&](int lane) { return loop.memory_of(members[std::min<int64_t>(lane, count - 1)]); };
    for (int lane = 0; lane < CROWD; ++lane) bundle.begin(memory_of(lane), loop.k0 == 0, lane);
    FlowTraveller<care, A, A> traveller(loop.tables, size, bundle.rows);
    FlowCrowd<care, false, A, Shared> crowd(plain, Shared{}, members, count, scratch);
    const int64_t work = (1 + bundle.rows) * CROWD * work_of_step(plain);
    A t(schedule.t0);
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && crowd.left > 0; ++k) {
        loop.hearing.after(work);
        t = A(schedule.t0 + double(k - 1) * schedule.h);
        const uint32_t from = tables.section[k == 1 ? 0 : 1], to = tables.section[k == 1 ? 1 : 2];
        traveller.sweep(from, to, crowd.momentum.at, crowd.momentum.errors, bundle.held(), t, schedule.h);
        crowd.evaluations += to - from;
        crowd.stop_where_not(finite(size, crowd.momentum.at), k);
        crowd.recorder.after(
            k, [&](bool saving) { return crowd.finished(k, saving, t, copies.at, scratch.at, angles); });
        crowd.stop_where_not(bundle.after(k), k, PARALLEL);
    }
    bundle.end(int(count), memory_of, [&](A* vectors) {
        std::copy_n(crowd.momentum.at, 2 * size, copies.at);
        traveller.sweep(tables.section[2], tables.section[3], copies.at, copies.at + size, vectors, t, schedule.h);
    });
}

template <Care care>
static void follow_each(const FlowTangentLoop& loop, const Crew& crew) {
    const int64_t size = loop.arrays.size;
    const bool narrow = size <= WIDEST && size * loop.tables.tangents.carried <= MOST_TOGETHER;
    int64_t place = crew.first;
    for (; narrow && crew.last - place >= FEWEST; place += CROWD)
        follow_crowd<care>(loop, crew.members + place, std::min<int64_t>(CROWD, crew.last - place));
    for (; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.arrays.status[member] != DONE) continue;
        if (size <= WIDEST)
            follow_member<care, Lanes<CROWD>>(loop, member);
        else
            follow_member<care, double>(loop, member);
    }
}

static void follow(const FlowTangentLoop& loop, const Crew& crew) {
    loop.tables.base.compensated ? follow_each<CORRECTED>(loop, crew) : follow_each<PLAIN>(loop, crew);
}

static int64_t remembered_by(const FlowTangents& tables) { return remembered_by(tables.tangents); }

EXPORT_LOOP(flow_tangents_advance, FlowTangents, follow, remembered_by)

}  // namespace coadjoint
