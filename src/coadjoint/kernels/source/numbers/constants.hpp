// Layout of the constants of a table: shared by all lanes, or one for each member side by side.
#pragma once

#include "numbers/lanes.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

struct Shared {
    template <class A>
    static INLINE A number_at(const double* from, int64_t place) { return A(from[place]); }
    static INLINE int64_t address(const int64_t* from, int64_t place, int) { return from[place]; }
    static INLINE int used(int lanes) { return lanes; }
};

// Constants that differ by member: `stride` of them side by side for each entry of a table, the lanes from `first`.
struct Varied {
    int64_t stride, first;
    template <class A>
    INLINE A number_at(const double* from, int64_t place) const { return load<A>(from + place * stride + first); }
    INLINE int64_t address(const int64_t* from, int64_t place, int lane) const {
        return from[place * stride + first + lane];
    }
    static INLINE int used(int lanes) { return lanes; }
};

// The constants of one such member, the same in every lane.
struct Own {
    int64_t stride, first;
    template <class A>
    INLINE A number_at(const double* from, int64_t place) const { return A(from[place * stride + first]); }
    INLINE int64_t address(const int64_t* from, int64_t place, int) const { return from[place * stride + first]; }
    static INLINE int used(int lanes) { return lanes; }
};

// Constants of which only the first lanes are used; functions of the user are not called for the others.
template <class C>
struct First : C {
    int count;
    INLINE First(const C& constants, int count) : C(constants), count(count) {}
    INLINE int used(int) const { return count; }
};

}  // namespace coadjoint
