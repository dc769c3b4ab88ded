// Entry points of Runge-Kutta methods for Python.
#include "stages/runge_kutta_loop.hpp"

namespace coadjoint {

// Whether members as lanes fit into the cache: their stages, and the matrix of a direct scheme.
static bool fits(const RungeKuttaTables& tables) {
    const int64_t n = tables.field.size, edge = tables.direct ? tables.stages * std::max(n, tables.group.size) : 0;
    return edge * edge + 5 * tables.stages * (n + tables.group.size * tables.group.size) <= 4096;
}

static void advance(const RungeKuttaLoop& loop, const MemberRange& range) {
    typedef Lanes<MEMBER_LANES> LaneNumbers;
    const RungeKuttaTables& tables = loop.tables;
    const auto [members, first, last, stride] = range;
    // Linear systems by iteration are solved for each member alone.
    const bool iterated = tables.solver >= STRUCTURE && !tables.direct;
    // Stages fill lanes as well as members do, and fit better into registers.
    const bool side_by_side = tables.solver == IMPLICIT && tables.stages >= 4 && tables.field.size > 3;
    // Lanes share one step length.
    const bool narrow = fits(tables) && !iterated && !side_by_side && !loop.schedule.lengths;
    int64_t position = first;
    for (; position < last && stride; ++position) {
        const MemberConstants constants{stride, position};
        if (!loop.schedule.lengths && !reuses_functions(tables.field, constants)) break;
        if (loop.arrays.status[members[position]] != DONE) continue;
        advance_alone<double>(loop, *single_of(tables, constants), members[position], constants);
    }
    for (; position < last && (stride || (narrow && last - position >= MIN_LANES)); position += MEMBER_LANES) {
        const int64_t count = std::min<int64_t>(MEMBER_LANES, last - position);
        if (stride)
            RungeKuttaLanes<LaneNumbers, LaneConstants>(loop, LaneConstants{stride, position}, members + position,
                                                        count)
                .advance();
        else
            RungeKuttaLanes<LaneNumbers, SharedConstants>(loop, SharedConstants{}, members + position, count).advance();
    }
    if (position >= last) return;
    const auto one = single_of(tables, SharedConstants{});
    for (; position < last; ++position) {
        const int64_t member = members[position];
        if (loop.arrays.status[member] != DONE) continue;
        if (tables.field.size <= WIDEST)
            advance_alone<LaneNumbers>(loop, *one, member, SharedConstants{});
        else
            advance_alone<double>(loop, *one, member, SharedConstants{});
    }
}

EXPORT_LOOP(runge_kutta_advance, RungeKuttaTables, advance, memory_size)

}  // namespace coadjoint
