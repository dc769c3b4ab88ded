// What Python calls for Runge-Kutta methods.
#include "runge_kutta_loop.hpp"

// Whether members of a crowd have room in the cache: their stages, and the matrix of a direct scheme.
static bool fits(const RungeKuttaTables& tables) {
    const int64_t n = tables.field.size, edge = tables.direct ? tables.stages * std::max(n, tables.group.size) : 0;
    return edge * edge + 5 * tables.stages * (n + tables.group.size * tables.group.size) <= 4096;
}

// Take the steps k0 + 1 to k1 for the positions first to last - 1 of a crew. With a stride the constants of the tables
// differ by position, `stride` of them side by side.
EXPORT void runge_kutta_advance(const RungeKuttaTables* tables, const Watch* watch, const Saves* saves,
                                const Schedule* schedule, const State* state, const int64_t* members, int64_t first,
                                int64_t last, int64_t k0, int64_t k1, const Report* report, int64_t stride) {
    typedef Lanes<CROWD> Crowd;
    const RungeKuttaLoop loop{*tables, *watch, *saves, *schedule, *state, *report, k0, k1};
    // What only some members take, linear systems by iteration, they take alone.
    const bool iterated = tables->solver >= STRUCTURE && !tables->direct;
    const bool narrow = fits(*tables) && !iterated;
    int64_t place = first;
    for (; place < last && (stride || (narrow && last - place >= FEWEST)); place += CROWD) {
        const int64_t count = std::min<int64_t>(CROWD, last - place);
        if (stride)
            Together<Crowd, Varied>(loop, Varied{stride, place}, members + place, count).follow();
        else
            Together<Crowd, Shared>(loop, Shared{}, members + place, count).follow();
    }
    if (place >= last) return;
    const auto one = single_of(*tables, Shared{});
    for (; place < last; ++place) {
        const int64_t member = members[place];
        if (report->status[member] != DONE) continue;
        if (tables->field.size <= WIDEST)
            follow_alone<Crowd>(loop, *one, member);
        else
            follow_alone<double>(loop, *one, member);
    }
}
