// Entry points of Runge-Kutta methods for Python.
#include "stages/runge_kutta_loop.hpp"

namespace coadjoint {

// Whether members of a crowd fit into the cache: their stages, and the matrix of a direct scheme.
static bool fits(const RungeKuttaTables& tables) {
    const int64_t n = tables.field.size, edge = tables.direct ? tables.stages * std::max(n, tables.group.size) : 0;
    return edge * edge + 5 * tables.stages * (n + tables.group.size * tables.group.size) <= 4096;
}

static void follow(const RungeKuttaLoop& loop, const Crew& crew) {
    typedef Lanes<CROWD> Crowd;
    const RungeKuttaTables& tables = loop.tables;
    const auto [members, first, last, stride] = crew;
    // Linear systems by iteration are solved for each member alone.
    const bool iterated = tables.solver >= STRUCTURE && !tables.direct;
    // Stages fill lanes as well as members do, and fit better into registers.
    const bool side_by_side = tables.solver == IMPLICIT && tables.stages >= 4 && tables.field.size > 3;
    // Lanes share one step length.
    const bool narrow = fits(tables) && !iterated && !side_by_side && !loop.schedule.lengths;
    int64_t place = first;
    for (; place < last && stride && loop.schedule.lengths; ++place) {
        if (loop.arrays.status[members[place]] != DONE) continue;
        const Own own{stride, place};
        follow_alone<double>(loop, *single_of(tables, own), members[place], own);
    }
    for (; place < last && (stride || (narrow && last - place >= FEWEST)); place += CROWD) {
        const int64_t count = std::min<int64_t>(CROWD, last - place);
        if (stride)
            Together<Crowd, Varied>(loop, Varied{stride, place}, members + place, count).follow();
        else
            Together<Crowd, Shared>(loop, Shared{}, members + place, count).follow();
    }
    if (place >= last) return;
    const auto one = single_of(tables, Shared{});
    for (; place < last; ++place) {
        const int64_t member = members[place];
        if (loop.arrays.status[member] != DONE) continue;
        if (tables.field.size <= WIDEST)
            follow_alone<Crowd>(loop, *one, member, Shared{});
        else
            follow_alone<double>(loop, *one, member, Shared{});
    }
}

EXPORT_LOOP(runge_kutta_advance, RungeKuttaTables, follow, remembered_by)

}  // namespace coadjoint
