// The arrays of a run: each with its type, its name, and its axes as a product of numbers of `Extent` and of limits.
// `coadjoint.kernels.loop` documents their contents.
#pragma once

#include "boundary/codes.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

// Results at the saved points.
#define SAVED_ARRAYS(_)                        \
    _(numbers, x, points * members * size)     \
    _(numbers, group, points * members * square) \
    _(numbers, values, points * members * invariants)

// The state of a run between two steps.
#define STATE_ARRAYS(_)                          \
    _(numbers, momenta, members * size)          \
    _(numbers, errors, members * size)           \
    _(numbers, groups, members * square)         \
    _(numbers, group_errors, members * square)   \
    _(numbers, memory, members * memory_size)    \
    _(numbers, first, members * invariants)      \
    _(numbers, last, members * invariants)       \
    _(numbers, worst, members * TENTHS * invariants) \
    _(numbers, residual, members)                \
    _(integers, status, members)                 \
    _(integers, step, members)                   \
    _(integers, evaluations, members)            \
    _(integers, iterations, members)

#define DECLARE_ARRAY(type, name, axes) coadjoint::type name;
#define ASSIGN_ARRAY(type, name, axes) name = reinterpret_cast<coadjoint::type>(at), at += axes;
#define DESCRIBE_ARRAY(type, name, axes) #type " " #name " " #axes ";"

// Each kind is one block of memory, array after array; every number takes eight bytes.
struct Arrays : Extent {
    SAVED_ARRAYS(DECLARE_ARRAY)
    STATE_ARRAYS(DECLARE_ARRAY)

    Arrays(const Extent& extent, double* saved, double* state) : Extent(extent) {
        double* at = saved;
        SAVED_ARRAYS(ASSIGN_ARRAY)
        at = state;
        STATE_ARRAYS(ASSIGN_ARRAY)
    }

    // The saved state after step k is not finite, and left out. Its member counts as failed at the end of the run.
    void left_out(int64_t member, int64_t k) const {
        if (step[member] == 0) step[member] = k;
    }

    // Both kinds in one block.
    Arrays(const Extent& extent, double* at) : Extent(extent) {
        SAVED_ARRAYS(ASSIGN_ARRAY)
        STATE_ARRAYS(ASSIGN_ARRAY)
    }
};

constexpr char saved_arrays[] = "arrays saved:" SAVED_ARRAYS(DESCRIBE_ARRAY) "\n";
constexpr char state_arrays[] = "arrays state:" STATE_ARRAYS(DESCRIBE_ARRAY) "\n";

}  // namespace coadjoint
