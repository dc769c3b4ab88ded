// An array of numbers of any lanes, aligned to them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>
#include <vector>

#include "numbers/lanes.hpp"

namespace coadjoint {

NOINLINE inline void* zeros(size_t bytes) {
    constexpr size_t SMALL = 1024;
    // The cache of a thread for small pieces serves malloc, but not calloc of all systems.
    void* const memory = bytes <= SMALL ? std::malloc(bytes) : std::calloc(bytes, 1);
    if (!memory) throw std::bad_alloc();
    if (bytes <= SMALL) std::memset(memory, 0, bytes);
    return memory;
}

template <class A>
struct AlignedArray {
    A* at = nullptr;

    explicit AlignedArray(int64_t count) { clear(count); }
    ~AlignedArray() { std::free(memory); }
    // Allocate `count` zeros; the system provides the memory of a large array where it is first written.
    void clear(int64_t count) {
        std::free(memory);
        memory = nullptr;
        memory = zeros(sizeof(A) * (count + 1) + alignof(A));
        at = reinterpret_cast<A*>((reinterpret_cast<uintptr_t>(memory) + alignof(A) - 1) & ~(alignof(A) - 1));
    }
    AlignedArray(const AlignedArray&) = delete;
    AlignedArray& operator=(const AlignedArray&) = delete;

  private:
    void* memory = nullptr;
};

}  // namespace coadjoint
