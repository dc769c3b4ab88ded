// An array of numbers of any lanes, aligned to them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace coadjoint {

template <class A>
struct AlignedArray {
    std::vector<char> bytes;
    A* at;

    explicit AlignedArray(int64_t count) { clear(count); }
    // Allocate `count` zeros.
    void clear(int64_t count) {
        bytes.assign(sizeof(A) * (count + 1) + alignof(A), 0);
        at = reinterpret_cast<A*>((reinterpret_cast<uintptr_t>(bytes.data()) + alignof(A) - 1) & ~(alignof(A) - 1));
    }
    AlignedArray(const AlignedArray&) = delete;
    AlignedArray& operator=(const AlignedArray&) = delete;
};

}  // namespace coadjoint
