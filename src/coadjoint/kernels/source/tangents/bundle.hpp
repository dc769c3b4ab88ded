// Tangent vectors and their stretching factors. The lanes are vectors of one member, or members.
#pragma once

#include "boundary/loop.hpp"
#include "numbers/aligned_array.hpp"

namespace coadjoint {

typedef Lanes<4> TangentLanes;  // tangent vectors of one member as lanes

// The smallest part of a vector that must remain after orthogonalization. In a smaller remainder, half of the digits
// are round-off.
constexpr double NEARLY_DEPENDENT = 0x1p-26;

// A product of lengths, (high + low) 2^exponent with high from 1/2 to 1. It is as accurate as one length.
struct Stretch {
    double high, low, exponent;

    void grow(double length) {
        const double product = high * length, rest = fma(high, length, -product) + low * length;
        int binary;
        high = std::frexp(product, &binary);
        low = std::ldexp(rest, -binary);
        exponent += binary;
    }
};

// Orthonormalize vectors, one after the other, by the modified Gram-Schmidt process: component i of vector r is at i *
// width + r. `lengths` become the lengths of the remainders. False if a vector depends on the previous ones, or is not
// finite.
template <class N>
typename Numbers<N>::Mask orthonormalize(N* at, int64_t size, int64_t count, int64_t width, N* lengths, N* shares) {
    const auto length_of = [&](int64_t r) {
        const N square = shared_sum<N>(size, [&](int64_t first, int64_t last) {
            N sum(0.0);
            for (int64_t i = first; i < last; ++i) sum = fma(at[i * width + r], at[i * width + r], sum);
            return sum;
        });
        return map(square, [](double entry) { return std::sqrt(entry); });
    };
    typename Numbers<N>::Mask valid = N(0.0) == N(0.0);
    for (int64_t r = 0; r < count; ++r) lengths[r] = length_of(r);
    for (int64_t r = 0; r < count; ++r) {
        InterruptCheck::of_this_call().after(2 * size * (count - r) * Numbers<N>::lanes);
        const N length = length_of(r);
        valid = valid & (length > N(NEARLY_DEPENDENT) * lengths[r]) & (length - length == N(0.0));
        if (!any(valid)) return valid;
        lengths[r] = length;
        std::fill_n(shares, count, N(0.0));
        shared_results<N>(
            size, count, shares,
            [&](int64_t first, int64_t last, N* to) {
                for (int64_t i = first; i < last; ++i) {
                    const N entry = at[i * width + r] = at[i * width + r] / length;
                    for (int64_t s = r + 1; s < count; ++s) to[s] = fma(entry, at[i * width + s], to[s]);
                }
            },
            [&](N* to, const N* more) {
                for (int64_t s = r + 1; s < count; ++s) to[s] = to[s] + more[s];
            });
        share(size, [&](int64_t first, int64_t last) {
            for (int64_t i = first; i < last; ++i) {
                const N entry = -at[i * width + r];
                for (int64_t s = r + 1; s < count; ++s) at[i * width + s] = fma(entry, shares[s], at[i * width + s]);
            }
        });
    }
    return valid;
}

// The memory per member: the vectors, their stretching until the last orthonormalization, and until the last step.
inline int64_t memory_size(const Tangents& tangents) { return tangents.carried * (tangents.size + 6); }

// An N is a number of one member, or of many as lanes; a V is an N, or vectors of one member side by side.
template <class N, class V>
class TangentBundle {
  public:
    typedef typename Numbers<N>::Mask Mask;
    const int64_t size, count, rows;  // components, vectors, and blocks of them side by side

    explicit TangentBundle(const Tangents& tables)
        : size(tables.size), count(tables.carried), rows((count + per_block - 1) / per_block), tables(tables),
          vectors(size * rows), copies(size * rows), lengths(count), shares(count), stretches(members * count) {}

    // Load the memory of the member of a lane; before the first step the vectors are `frame`.
    void begin(const double* memory, bool starting, int lane = 0) {
        const double *from = starting ? tables.frame : memory, *stretched = memory + count * size;
        each([&](int64_t r, int64_t i) { set_lane(entries(vectors)[i * width() + r], lane, from[r * size + i]); });
        for (int64_t r = 0; r < count; ++r, stretched += 3)
            stretches[lane * count + r] =
                starting ? Stretch{0.5, 0.0, 1.0} : Stretch{stretched[0], stretched[1], stretched[2]};
    }

    // Component i of the vectors of a block is at i * rows + block; beyond the last vector there are zeros.
    V* held() { return vectors.at; }

    // To be called after each step; false if the vectors are no longer independent.
    Mask after(int64_t k) { return k % tables.every != 0 ? N(0.0) == N(0.0) : grow(vectors, stretches); }

    // Store the state of each of the first `used` lanes in its memory. `finish(vectors)` takes copies of the vectors
    // through the rest of the last step. If the copies are not independent, their stretching is NaN.
    template <class MemoryOf, class Finish>
    void end(int used, MemoryOf memory_of, Finish finish) {
        std::copy_n(vectors.at, size * rows, copies.at);
        finish(copies.at);
        std::vector<Stretch> finished = stretches;
        const Mask valid = grow(copies, finished);
        for (int lane = 0; lane < used; ++lane) {
            double* to = memory_of(lane);
            each([&](int64_t r, int64_t i) { to[r * size + i] = lane_of(entries(vectors)[i * width() + r], lane); });
            to += count * size;
            for (int64_t r = 0; r < count; ++r) to = write(stretches[lane * count + r], to);
            for (int64_t r = 0; r < count; ++r)
                to = write(at(valid, lane) ? finished[lane * count + r] : Stretch{NAN, NAN, NAN}, to);
        }
    }

  private:
    static constexpr int members = Numbers<N>::lanes;
    static constexpr int64_t per_block = Numbers<V>::lanes / members;
    const Tangents& tables;
    AlignedArray<V> vectors, copies;
    AlignedArray<N> lengths, shares;
    std::vector<Stretch> stretches;

    int64_t width() const { return rows * per_block; }
    static N* entries(AlignedArray<V>& workspace) { return reinterpret_cast<N*>(workspace.at); }

    Mask grow(AlignedArray<V>& workspace, std::vector<Stretch>& by) {
        const Mask valid = orthonormalize(entries(workspace), size, count, width(), lengths.at, shares.at);
        for (int lane = 0; lane < members; ++lane)
            for (int64_t r = 0; at(valid, lane) && r < count; ++r)
                by[lane * count + r].grow(lane_of(lengths.at[r], lane));
        return valid;
    }

    static double* write(const Stretch& from, double* to) {
        *to++ = from.high, *to++ = from.low, *to++ = from.exponent;
        return to;
    }

    template <class Visit>
    void each(Visit visit) const {
        for (int64_t r = 0; r < count; ++r)
            for (int64_t i = 0; i < size; ++i) visit(r, i);
    }
};

}  // namespace coadjoint
