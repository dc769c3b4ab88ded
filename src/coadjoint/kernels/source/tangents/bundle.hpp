// The tangent vectors of one member, side by side, and by how much each of them was stretched.
#pragma once

#include "boundary/crew.hpp"
#include "numbers/room.hpp"

namespace coadjoint {

typedef Lanes<4> Abreast;  // tangent vectors side by side

// Of what a vector was, what must be left of it beside the others: less, and half of its digits are round-off.
constexpr double NEARLY_DEPENDENT = 0x1p-26;

// Lengths multiplied with each other: (high + low) 2^exponent, high from 1/2 to 1, as accurate as one of them.
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

// Make vectors orthonormal, one after the other, by the modified process of Gram and Schmidt: component i of vector r
// stands at i * width + r. `lengths` become those that were left of them. False where one depends on those before it,
// or is no number.
inline bool orthonormalize(double* at, int64_t size, int64_t count, int64_t width, double* lengths, double* shares) {
    for (int64_t r = 0; r < count; ++r) {
        double square = 0.0;
        for (int64_t i = 0; i < size; ++i) square = fma(at[i * width + r], at[i * width + r], square);
        lengths[r] = std::sqrt(square);
    }
    for (int64_t r = 0; r < count; ++r) {
        Hearing::of_this_call().after(2 * size * (count - r));
        double square = 0.0;
        for (int64_t i = 0; i < size; ++i) square = fma(at[i * width + r], at[i * width + r], square);
        const double length = std::sqrt(square);
        if (!(length > NEARLY_DEPENDENT * lengths[r] && length - length == 0.0)) return false;
        lengths[r] = length;
        std::fill_n(shares, count, 0.0);
        for (int64_t i = 0; i < size; ++i) {
            const double own = at[i * width + r] /= length;
            for (int64_t s = r + 1; s < count; ++s) shares[s] = fma(own, at[i * width + s], shares[s]);
        }
        for (int64_t i = 0; i < size; ++i) {
            const double own = -at[i * width + r];
            for (int64_t s = r + 1; s < count; ++s) at[i * width + s] = fma(own, shares[s], at[i * width + s]);
        }
    }
    return true;
}

// How many numbers a member remembers of its vectors: themselves, and how each was stretched until the last time that
// they were made orthonormal, and until the last step.
inline int64_t remembered_by(const Tangents& tangents) { return tangents.carried * (tangents.size + 6); }

class Bundle {
  public:
    const int64_t size, count, rows;  // components, vectors, and blocks of them side by side

    explicit Bundle(const Tangents& given)
        : size(given.size), count(given.carried), rows((count + lanes - 1) / lanes), given(given), vectors(size * rows),
          copies(size * rows), lengths(count), shares(count), stretches(count) {}

    // Take up what a member remembers from `memory` on; before the first step the vectors are those that were given.
    void begin(double* memory, bool starting) {
        own = memory;
        const double *from = starting ? given.frame : own, *stretched = own + count * size;
        each([&](int64_t r, int64_t i) { entries(vectors)[i * width() + r] = from[r * size + i]; });
        for (int64_t r = 0; r < count; ++r)
            stretches[r] = starting ? Stretch{0.5, 0.0, 1.0}
                                    : Stretch{stretched[3 * r], stretched[3 * r + 1], stretched[3 * r + 2]};
    }

    // Component i of the vectors of a block stands at i * rows + block; beyond the last vector there are zeros.
    Abreast* at() { return vectors.at; }

    // To be called after each step; false where the vectors are no longer independent.
    bool after(int64_t k) { return k % given.every != 0 || grow(vectors, stretches); }

    // Leave the state in memory. `finish(vectors)` does for a copy what is left of the last step; where its vectors are
    // not independent, by how much they were stretched until then is no number.
    template <class Finish>
    void end(Finish finish) {
        each([&](int64_t r, int64_t i) { own[r * size + i] = entries(vectors)[i * width() + r]; });
        write(stretches, own + count * size);
        std::vector<Stretch> finished = stretches;
        std::copy_n(vectors.at, size * rows, copies.at);
        finish(copies.at);
        if (!grow(copies, finished)) std::fill(finished.begin(), finished.end(), Stretch{NAN, NAN, NAN});
        write(finished, own + count * (size + 3));
    }

  private:
    static constexpr int64_t lanes = Numbers<Abreast>::lanes;
    const Tangents& given;
    Room<Abreast> vectors, copies;
    std::vector<double> lengths, shares;
    std::vector<Stretch> stretches;
    double* own = nullptr;

    int64_t width() const { return rows * lanes; }
    static double* entries(Room<Abreast>& room) { return reinterpret_cast<double*>(room.at); }

    bool grow(Room<Abreast>& room, std::vector<Stretch>& by) {
        if (!orthonormalize(entries(room), size, count, width(), lengths.data(), shares.data())) return false;
        for (int64_t r = 0; r < count; ++r) by[r].grow(lengths[r]);
        return true;
    }

    void write(const std::vector<Stretch>& from, double* to) const {
        for (const Stretch& stretch : from) *to++ = stretch.high, *to++ = stretch.low, *to++ = stretch.exponent;
    }

    template <class Visit>
    void each(Visit visit) const {
        for (int64_t r = 0; r < count; ++r)
            for (int64_t i = 0; i < size; ++i) visit(r, i);
    }
};

}  // namespace coadjoint
