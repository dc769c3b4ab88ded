// Layout of the constants of a table: shared by all members, or a row of numbers, one for each member.
#pragma once

#include "numbers/lanes.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

struct MemberConstants;

// A constant beside numbers A is a Constant<A>; `from` is where the constants begin that follow an entry of a table.
struct SharedConstants {
    INLINE operator MemberConstants() const;
    template <class A>
    using Constant = double;
    static INLINE const double* from(const double* at, int64_t position) { return at + position; }
    template <class A>
    static INLINE A number_at(const double* from, int64_t position) { return A(from[position]); }
    static INLINE int64_t address(const int64_t* from, int64_t position, int) { return from[position]; }
    static INLINE int used(int lanes) { return lanes; }
    static INLINE SharedConstants of_lane(int) { return {}; }
};

// The constants of one of the members below, the same in every lane.
struct MemberConstants {
    int64_t stride, first;
    template <class A>
    INLINE A number_at(const double* from, int64_t position) const { return A(from[position * stride + first]); }
    INLINE int64_t address(const int64_t* from, int64_t position, int) const { return from[position * stride + first]; }
    static INLINE int used(int lanes) { return lanes; }
    INLINE MemberConstants of_lane(int) const { return *this; }
};

INLINE SharedConstants::operator MemberConstants() const { return {1, 0}; }

// Constants that differ by member: a row of `stride` numbers for each entry of a table. The lanes begin at `first`.
struct LaneConstants {
    int64_t stride, first;
    template <class A>
    using Constant = A;
    INLINE const double* from(const double* at, int64_t position) const { return at + position * stride; }
    template <class A>
    INLINE A number_at(const double* from, int64_t position) const { return load<A>(from + position * stride + first); }
    INLINE int64_t address(const int64_t* from, int64_t position, int lane) const {
        return from[position * stride + first + lane];
    }
    static INLINE int used(int lanes) { return lanes; }
    INLINE MemberConstants of_lane(int lane) const { return {stride, first + lane}; }
};

// Constants of which only the first lanes are used; functions of the user are not called for the others.
template <class C>
struct FirstLanes : C {
    int count;
    INLINE FirstLanes(const C& constants, int count) : C(constants), count(count) {}
    INLINE int used(int) const { return count; }
};

}  // namespace coadjoint
