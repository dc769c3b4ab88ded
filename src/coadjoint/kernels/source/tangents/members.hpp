// The members of a call with derivatives, as lanes or one after the other, and the numbers in the arrays of their run.
#pragma once

#include <deque>
#include <memory>
#include <type_traits>

#include "boundary/loop.hpp"
#include "numbers/constants.hpp"

namespace coadjoint {

// What a loop keeps from one call inside of another loop to the next.
struct Kept {
    virtual ~Kept() = default;
    // Of loops whose steps solve equations: how many numbers the cotangents of a step need, a step of a member that stores
    // them, and whether it is solved, and the cotangents of that step.
    virtual int64_t stored() const { return 0; }
    virtual bool take(int64_t, double* /* x */, double /* t */, double /* h */, int64_t /* threads */, double* /* to */) {
        return false;
    }
    virtual void pull(int64_t, const double* /* stored */, double /* h */, int64_t /* threads */, double* /* cotangent */,
                      double* /* by_coefficients */) {}
};

// That of blocks of members, and of all members that are alone.
struct KeptBlocks final : Kept {
    std::deque<std::unique_ptr<Kept>> blocks;
};

// Run `Steps<together, C>`, made for some tables, constants and a run, for the members first to last - 1, `lanes` of them at
// a time or each alone; return zero or the outcome.
template <int64_t lanes, template <bool, class> class Steps, class Run>
int64_t run_in_lanes(const FlowCotangents& tables, const Run& run, int64_t first, int64_t last, InterruptCheck& interrupts,
                     std::unique_ptr<Kept>* kept) {
    return outcome_of([&]() -> int64_t {
        if (kept && !*kept) kept->reset(new KeptBlocks);
        size_t block = 0;
        const auto take = [&](auto together, const auto& constants, int64_t count) {
            typedef Steps<together(), std::decay_t<decltype(constants)>> Own;
            std::unique_ptr<Kept> own;
            if (kept) {
                auto& blocks = static_cast<KeptBlocks&>(**kept).blocks;
                blocks.resize(std::max(blocks.size(), block + 1));
                own.swap(blocks[block]);
            }
            if (!own) own.reset(new Own(tables, constants, run, count, interrupts));
            static_cast<Own&>(*own).take(run, first);
            if (kept) own.swap(static_cast<KeptBlocks&>(**kept).blocks[block]);
        };
        while (first < last && (tables.stride || (run.size <= WIDEST && last - first >= MIN_LANES))) {
            const int64_t count = std::min<int64_t>(lanes, last - first);
            if (tables.stride)
                take(std::true_type(), LaneConstants{tables.stride, tables.column + first}, count);
            else
                take(std::true_type(), SharedConstants{}, count);
            first += count, ++block;
        }
        for (; first < last; ++first) take(std::false_type(), SharedConstants{}, 1);
        return 0;
    });
}

// Call a loop, with what it keeps if it keeps anything.
template <class Tables, class Run, class Carry>
int64_t call_derivative(const Carry& carry, const Tables& tables, const Run& run, int64_t first, int64_t last,
                        InterruptCheck& interrupts, std::unique_ptr<Kept>* kept) {
    if constexpr (std::is_invocable_v<Carry, const Tables&, const Run&, int64_t, int64_t, InterruptCheck&, decltype(kept)>)
        return carry(tables, run, first, last, interrupts, kept);
    else return carry(tables, run, first, last, interrupts);
}

// The entry points of a loop with derivatives: for Python, and inside of another loop.
#define EXPORT_DERIVATIVES(name, Tables, Run, carry)                                                                  \
    EXPORT int64_t name(const Tables* tables, const Run* run, int64_t first, int64_t last, const int64_t* stop) {     \
        InterruptCheck interrupts(stop);                                                                             \
        return call_derivative(carry, *tables, *run, first, last, interrupts, nullptr);                              \
    }                                                                                                                \
    EXPORT int64_t name##_inside(const Tables* tables, const Run* run, int64_t first, int64_t last,                  \
                                 std::unique_ptr<coadjoint::Kept>* kept) {                                           \
        return call_derivative(carry, *tables, *run, first, last, InterruptCheck::of_this_call(), kept);             \
    }

// Visitors of the numbers in lanes, which copy them from an array, or to it.
inline auto read_entries(const double* from) {
    return [from](auto& entry, int lane, int64_t position) { set_lane(entry, lane, from[position]); };
}

inline auto write_entries(double* to) {
    return [to](auto& entry, int lane, int64_t position) { to[position] = lane_of(entry, lane); };
}

// Members of a run as lanes, or one of them, the lanes of whose tangent vectors are vectors.
template <bool together>
struct MembersOfRun {
    int64_t first, used;

    // The last member fills further lanes.
    int64_t member_of(int64_t lane) const { return first + std::min(lane, used - 1); }

    // Numbers of a member are contiguous, (members, length).
    template <class A, class Visit>
    void each_number(A* to, int64_t length, int64_t lanes, const Visit& visit) const {
        for (int64_t lane = 0; lane < lanes; ++lane)
            for (int64_t i = 0; i < length; ++i) visit(to[i], int(lane), member_of(lane) * length + i);
    }

    // Components of vectors, (members, carried, length), or if all members have the same, (carried, length). Component i of
    // a block of vectors is at i * rows + block.
    template <class V, class Visit>
    void each_component(V* to, int64_t length, int64_t carried, const Visit& visit, bool own = true) const {
        constexpr int64_t per_block = together ? 1 : Numbers<V>::lanes;
        const int64_t rows = (carried + per_block - 1) / per_block;
        for (int64_t lane = 0; lane < used; ++lane)
            for (int64_t v = 0; v < carried; ++v)
                for (int64_t i = 0; i < length; ++i)
                    visit(to[i * rows + v / per_block], int(together ? lane : v % per_block),
                          ((own ? first + lane : 0) * carried + v) * length + i);
    }

    // Load directions of coefficients; return whether some are not zero.
    template <class V>
    bool read_directions(V* to, int64_t length, const ForwardRun& run) const {
        bool directed = false;
        each_component(to, length, run.carried, [&](V& entry, int lane, int64_t position) {
            set_lane(entry, lane, run.coefficients[position]);
            directed = directed || run.coefficients[position] != 0.0;
        }, run.apart);
        return directed;
    }
};

}  // namespace coadjoint
