// What Python calls for flow methods that carry tangent vectors.
#include "tangents/flow_tangents.hpp"

namespace coadjoint {

typedef Loop<FlowTangents> FlowTangentLoop;

template <Care care, class Side>
static void follow_member(const FlowTangentLoop& loop, int64_t member) {
    const FlowTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t size = arrays.size;
    Bundle bundle(loop.tables.tangents);
    bundle.begin(loop.memory_of(member), loop.k0 == 0);
    FlowTraveller<care> traveller(loop.tables, size, bundle.rows);
    Room<double> momenta(2 * size), copies(2 * size);
    double *x = momenta.at, *dx = momenta.at + size;
    std::copy_n(arrays.momenta + member * size, size, x);
    std::copy_n(arrays.errors + member * size, size, dx);
    Finisher<care, Side> finisher(tables, schedule, size);
    MemberRecorder<Side, Shared, Finisher<care, Side>> recorder(loop.watch, arrays, schedule, Shared{}, finisher);
    recorder.begin(member, Shared{}, loop.k0);
    const FlowLoop plain{tables, loop.watch, schedule, arrays, loop.hearing, loop.k0, loop.k1};
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(plain);
    int64_t failed = 0, k = loop.k0 + 1;
    bool dependent = false;
    for (; k <= loop.k1 && !failed && !dependent; ++k) {
        loop.hearing.after(work);
        const double t = schedule.t0 + double(k - 1) * schedule.h;
        traveller.sweep(tables.section[k == 1 ? 0 : 1], tables.section[k == 1 ? 1 : 2], x, dx, bundle.at(), t,
                        schedule.h);
        if (!finite(size, x))
            failed = k;
        else if (!(failed = recorder.after(k, x, dx, [](int64_t, double*) { return true; })))
            dependent = !bundle.after(k);
    }
    if (const int64_t earlier = recorder.flush()) failed = earlier;
    const int64_t last = failed ? failed : k - 1, taken = last - loop.k0, start = loop.k0 == 0;
    arrays.evaluations[member] += start * (int64_t(tables.section[1]) - tables.section[0]) +
                                  (taken - start) * (int64_t(tables.section[2]) - tables.section[1]);
    if (!failed)
        bundle.end([&](Abreast* vectors) {
            std::copy_n(x, 2 * size, copies.at);
            traveller.sweep(tables.section[2], tables.section[3], copies.at, copies.at + size, vectors,
                            schedule.t0 + double(last - 1) * schedule.h, schedule.h);
        });
    if (failed)
        loop.overflow(member, failed);
    else if (dependent)
        loop.fail(member, last, PARALLEL, std::numeric_limits<double>::quiet_NaN());
    std::copy_n(x, size, arrays.momenta + member * size);
    std::copy_n(dx, size, arrays.errors + member * size);
}

template <Care care>
static void follow_each(const FlowTangentLoop& loop, const Crew& crew) {
    typedef Lanes<CROWD> Crowd;
    for (int64_t place = crew.first; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.arrays.status[member] != DONE) continue;
        if (loop.arrays.size <= WIDEST)
            follow_member<care, Crowd>(loop, member);
        else
            follow_member<care, double>(loop, member);
    }
}

static void follow(const FlowTangentLoop& loop, const Crew& crew) {
    loop.tables.base.compensated ? follow_each<CORRECTED>(loop, crew) : follow_each<PLAIN>(loop, crew);
}

static int64_t remembered_by(const FlowTangents& tables) {
    return remembered_by(tables.tangents);
}

EXPORT_LOOP(flow_tangents_advance, FlowTangents, follow, remembered_by)

}  // namespace coadjoint
