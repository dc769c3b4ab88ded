// Sparse sums whose rows are lanes, so that a single trajectory fills vectors. A vector has four rows for up to four
// coordinates, else eight.
#pragma once

#include <type_traits>
#include <vector>

#include "numbers/aligned_array.hpp"
#include "field/terms.hpp"

namespace coadjoint {

template <int W>
struct alignas(8 * W) Positions {
    int64_t lane[W];
};

template <int W>
INLINE int64_t blocks_of(int64_t rows) { return (rows + W - 1) / W; }

// Gather the numbers at given indices of a vector that is padded to whole blocks.
template <int W>
INLINE Lanes<W> take(const double* from, const Positions<W>& positions) {
    Lanes<W> taken;
#if defined(__AVX512F__)
    if constexpr (W == 8) {
        taken.part[0] = (typename Lanes<W>::Vector)_mm512_i64gather_pd(_mm512_load_si512(&positions), from, 8);
        return taken;
    }
#endif
#if defined(__AVX2__)
    // Each number is loaded into its half at once, faster than by an instruction that gathers.
    const int64_t* at = positions.lane;
    auto pair = [&](int lane) { return _mm_loadh_pd(_mm_load_sd(from + at[lane]), from + at[lane + 1]); };
    if constexpr (W % 4 == 0 && Lanes<W>::width == 4) {
        for (int k = 0; k < W / 4; ++k)
            taken.part[k] = (typename Lanes<W>::Vector)_mm256_set_m128d(pair(4 * k + 2), pair(4 * k));
        return taken;
    }
#endif
    for (int lane = 0; lane < W; ++lane) taken.set(lane, from[positions.lane[lane]]);
    return taken;
}

// The same for K blocks in registers.
template <int K, int W>
INLINE Lanes<W> take(const Lanes<W>* from, const Positions<W>& positions) {
#if defined(__AVX512F__) && defined(__AVX512VL__)
    Lanes<W> taken;
    typedef typename Lanes<W>::Vector Vector;
    if constexpr (W == 4) {
        static_assert(K == 1, "more rows are taken in eights");
        const __m256i index = _mm256_load_si256(reinterpret_cast<const __m256i*>(&positions));
        taken.part[0] = (Vector)_mm256_permutexvar_pd(index, (__m256d)from[0].part[0]);
        return taken;
    } else {
        const __m512i index = _mm512_load_si512(&positions);
        auto part = [&](int k) { return (__m512d)from[k].part[0]; };
        if constexpr (K == 1) {
            taken.part[0] = (Vector)_mm512_permutexvar_pd(index, part(0));
        } else if constexpr (K == 2) {
            taken.part[0] = (Vector)_mm512_permutex2var_pd(part(0), index, part(1));
        } else {
            static_assert(K == 3, "more blocks are taken from memory");
            const __m512d low = _mm512_permutex2var_pd(part(0), index, part(1));
            const __mmask8 above = _mm512_test_epi64_mask(index, _mm512_set1_epi64(16));
            taken.part[0] = (Vector)_mm512_mask_permutexvar_pd(low, above, index, part(2));
        }
        return taken;
    }
#elif defined(__AVX2__)
    if constexpr (W == 4 && K == 1) {
        // There is a permutation of the halves of numbers only.
        const __m256i index = _mm256_load_si256(reinterpret_cast<const __m256i*>(&positions));
        const __m256i halves = _mm256_or_si256(_mm256_slli_epi64(index, 1), _mm256_slli_epi64(index, 33));
        const __m256i both = _mm256_or_si256(halves, _mm256_set1_epi64x(int64_t(1) << 32));
        Lanes<W> taken;
        taken.part[0] = (typename Lanes<W>::Vector)_mm256_permutevar8x32_ps((__m256)from[0].part[0], both);
        return taken;
    }
#endif
    return take<W>(reinterpret_cast<const double*>(from), positions);
}

// Source of the numbers: K blocks in registers, or memory.
template <int K, int W>
struct Newest {
    Lanes<W> at[K];
    INLINE explicit Newest(const double* from) { for (int b = 0; b < K; ++b) at[b] = load<Lanes<W>>(from + b * W); }
    INLINE explicit Newest(const Lanes<W>* from) { for (int b = 0; b < K; ++b) at[b] = from[b]; }
    INLINE Lanes<W> operator()(const Positions<W>& positions) const { return take<K>(at, positions); }
};
template <int W>
struct Newest<0, W> {
    const double* at;
    INLINE explicit Newest(const double* from) : at(from) {}
    INLINE explicit Newest(const Lanes<W>* from) : Newest(reinterpret_cast<const double*>(from)) {}
    INLINE Lanes<W> operator()(const Positions<W>& positions) const { return take<W>(at, positions); }
};

#if defined(__AVX2__)
// The sums of the even and of the odd lanes, in the order of `sum_of_lanes`.
template <int W>
INLINE __m128d sums_of_every_second(const Lanes<W>& a) {
    __m256d half;
#if defined(__AVX512F__)
    if constexpr (W == 8) {
        const __m512d whole = (__m512d)a.part[0];
        half = _mm256_add_pd(_mm512_castpd512_pd256(whole), _mm512_extractf64x4_pd(whole, 1));
    } else {
        half = (__m256d)a.part[0];
    }
#else
    half = (__m256d)a.part[0];
    if constexpr (W == 8) half = _mm256_add_pd(half, (__m256d)a.part[1]);
#endif
    return _mm_add_pd(_mm256_castpd256_pd128(half), _mm256_extractf128_pd(half, 1));
}
#endif

// The sum of the lanes. Of eight, those at distance four are added first; then those at distance two, then one.
template <int W>
INLINE double sum_of_lanes(const Lanes<W>& a) {
#if defined(__AVX2__)
    const __m128d pair = sums_of_every_second(a);
    return pair[0] + pair[1];
#else
    if constexpr (W == 4) return (a[0] + a[2]) + (a[1] + a[3]);
    const double p = a[0] + a[4], q = a[1] + a[5], r = a[2] + a[6], s = a[3] + a[7];
    return (p + r) + (q + s);
#endif
}

// Lanes without their alignment, since the memory of containers that are aligned takes long to find.
template <class A>
struct Unaligned {
    double numbers[Numbers<A>::lanes] = {};
    Unaligned() = default;
    INLINE Unaligned(const A& a) { store(numbers, a); }
    INLINE operator A() const { return load<A>(numbers); }
};
template <class N>
using Stored = std::conditional_t<std::is_same_v<N, double>, double, Unaligned<N>>;
template <class N>
void add(Stored<N>& sum, const N& more) { sum = N(sum) + more; }

// Sparse sums, sum_e weight_e x[left_e] (y[right_e]), of one member, or of members as lanes.
template <class N>
struct EntryOf {
    Stored<N> weight;
    int64_t left, right;
};
template <class N>
using SparseSumOf = std::vector<EntryOf<N>>;
typedef EntryOf<double> Entry;
typedef SparseSumOf<double> SparseSum;

// The rows in blocks of W; shorter rows of a block are padded with entries of weight zero.
template <int W>
struct Sums {
    // One entry of each row of a block.
    struct Vector {
        Lanes<W> weight;
        Positions<W> left, right;
    };
    int64_t blocks = 0, most = 0;    // most: entries of a block
    std::vector<int64_t> first{0};  // block b has the vectors first[b] to first[b + 1]
    AlignedArray<Vector> at{0};

    int64_t size() const { return first.back(); }

    // Add rows, starting a new block.
    void add(const std::vector<SparseSum>& rows) {
        for (size_t low = 0; low < rows.size(); low += W) {
            const int64_t entries = longest(rows, low);
            for (int64_t e = 0; e < entries; ++e)
                for (size_t r = low; r < low + W; ++r) {
                    const bool there = r < rows.size() && e < int64_t(rows[r].size());
                    pending.push_back(there ? rows[r][e] : Entry{0.0, 0, 0});
                }
            first.push_back(first.back() + entries);
            most = std::max(most, entries);
            ++blocks;
        }
    }

    // The longest row of the block that begins with row `low`.
    template <class N>
    static int64_t longest(const std::vector<SparseSumOf<N>>& rows, size_t low) {
        size_t entries = 0;
        for (size_t r = low; r < std::min(low + W, rows.size()); ++r) entries = std::max(entries, rows[r].size());
        return int64_t(entries);
    }

    // Store the entries in the order of reading, after the last row.
    void finish() {
        at.clear(size());
        for (size_t k = 0; k < pending.size(); ++k) {
            Vector& vector = at.at[k / W];
            vector.weight.set(int(k % W), pending[k].weight);
            vector.left.lane[k % W] = pending[k].left;
            vector.right.lane[k % W] = pending[k].right;
        }
    }

  private:
    std::vector<Entry> pending;
};

}  // namespace coadjoint
