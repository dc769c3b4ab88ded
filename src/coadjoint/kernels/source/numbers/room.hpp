// Scratch memory of a loop: numbers of any lanes, aligned to them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace coadjoint {

template <class A>
struct Room {
    std::vector<char> bytes;
    A* at;

    explicit Room(int64_t count) { clear(count); }
    // Allocate `count` zeros.
    void clear(int64_t count) {
        bytes.assign(sizeof(A) * (count + 1) + alignof(A), 0);
        at = reinterpret_cast<A*>((reinterpret_cast<uintptr_t>(bytes.data()) + alignof(A) - 1) & ~(alignof(A) - 1));
    }
    Room(const Room&) = delete;
    Room& operator=(const Room&) = delete;
};

}  // namespace coadjoint
