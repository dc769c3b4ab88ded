// The map from a state W to its stream P: linear maps that act on each diagonal of a matrix separately, or a function.
#pragma once

#include <cmath>
#include <deque>
#include <memory>
#include <vector>

#include "boundary/codes.hpp"
#include "field/terms.hpp"
#include "matrices/circulants.hpp"
#include "matrices/products.hpp"

namespace coadjoint {

// Contents of `numbers` by kind:
//   TRIDIAGONAL: for each diagonal m from the main one upwards the factors L D L^T of a tridiagonal matrix, by rows:
//                n x n below the diagonal of L, then n x n inverse pivots. A first number other than 0, which no row
//                has below its diagonal, marks a map that ignores the trace: then the means of W and P are subtracted.
//   MULTIPLIED:  the tridiagonal matrix of each diagonal: n x n on its diagonal, then n x n off it.
//   CIRCULANT:   for each cyclic diagonal d up to (n - 1)/2 the n entries of a circulant matrix's first column.
//   WEIGHTS:     n x n factors of the entries.
//   SYMMETRIC:   for each diagonal m from the main one upwards two symmetric matrices, of the even and of the odd part
//                about its middle, (n - m + 1)/2 and (n - m)/2 squared numbers.
//   BY_FUNCTION:    nothing.
template <class T>
class DiagonalMap {
  public:
    DiagonalMap(int64_t kind, int64_t size, const double* numbers)
        : kind(kind), n(size), numbers(numbers),
          circulants(kind == CIRCULANT ? std::make_unique<Circulants<T>>(size, numbers) : nullptr),
          halves(kind == SYMMETRIC ? 2 * even_of(size) : 0) {}

    // The count of numbers that a map reads.
    static int64_t numbers_of(int64_t kind, int64_t n) {
        if (kind == CIRCULANT) return (n + 1) / 2 * n;
        int64_t halves = 0;
        for (int64_t m = 0; m < n; ++m) halves += even_of(n - m) * even_of(n - m) + (n - m) / 2 * ((n - m) / 2);
        if (kind == SYMMETRIC) return halves;
        if (kind == WEIGHTS) return n * n;
        return kind == TRIDIAGONAL || kind == MULTIPLIED ? 2 * n * n : 0;
    }

    // Approximate number of multiplications.
    int64_t work() const {
        return circulants ? circulants->work() : kind == SYMMETRIC ? 2 * numbers_of(kind, n) : 4 * n * n;
    }

    bool upper_suffices() const { return kind != CIRCULANT; }

    // With `upper`, of skew-Hermitian matrices, entries of P below the diagonal may be left out.
    NOINLINE void apply(const T* W, T* P, bool upper) {
        if (kind == TRIDIAGONAL) solve(W, P);
        if (kind == MULTIPLIED) multiply(W, P);
        if (kind == SYMMETRIC) multiply_halves(W, P);
        if (!upper && (kind == TRIDIAGONAL || kind == MULTIPLIED || kind == SYMMETRIC)) mirror(P);
        if (circulants) circulants->apply(W, P);
        if (kind == WEIGHTS)
            for (int64_t e = 0; e < n * n; ++e) P[e] = numbers[e] * W[e];
    }

  private:
    static constexpr int64_t GROUP = 32;  // diagonals that are solved together
    const int64_t kind, n;
    const double* const numbers;
    const std::unique_ptr<Circulants<T>> circulants;
    std::vector<T> halves;  // of one diagonal, the even one first

    // Row by row for some diagonals at once, so that dependent rows are adjacent; threads share the groups.
    void solve(const T* W, T* P) const {
        const bool unseen = numbers[0] != 0.0;
        const T trace = unseen ? mean(W) : T(0.0);
        each_row_shared((n + GROUP - 1) / GROUP, [=, this](int64_t group) {
            solve(W, P, GROUP * group, std::min(n, GROUP * (group + 1)), trace);
        });
        if (unseen) {
            const T rest = mean(P);
            for (int64_t i = 0; i < n; ++i) P[i * n + i] -= rest;
        }
    }

    // For the diagonals from `first` to `last` - 1.
    void solve(const T* W, T* P, int64_t first, int64_t last, T trace) const {
        const double *below = numbers, *inverse = numbers + n * n;
        for (int64_t i = 0; i < n - first; ++i) {
            const T *from = W + i * n + i, *before = P + (i - 1) * n + i - 1;
            T* to = P + i * n + i;
            const int64_t end = std::min(last, n - i);
            if (i == 0) std::copy(from + first, from + end, to + first);
            else
                for (int64_t m = first; m < end; ++m) to[m] = from[m] - below[i * n + m] * before[m];
            // The stages of a step have a trace; only a map that ignores it is symmetric on them.
            if (first == 0) to[0] -= trace;
        }
        for (int64_t i = n - 1 - first; i >= 0; --i) {
            T* to = P + i * n + i;
            const T* after = P + (i + 1) * n + i + 1;
            const int64_t end = std::min(last, n - i), inside = std::min(last, n - i - 1);
            for (int64_t m = first; m < inside; ++m)
                to[m] = to[m] * inverse[i * n + m] - below[(i + 1) * n + m] * after[m];
            for (int64_t m = std::max(first, inside); m < end; ++m) to[m] *= inverse[i * n + m];
        }
    }

    // Of the main diagonal.
    T mean(const T* W) const {
        T sum(0.0);
        for (int64_t i = 0; i < n; ++i) sum += W[i * n + i];
        return sum / double(n);
    }

    void multiply(const T* W, T* P) const {
        const double *main = numbers, *beside = numbers + n * n;
        for (int64_t i = 0; i < n; ++i)
            for (int64_t m = 0; m < n - i; ++m) {
                const T* at = W + i * n + i + m;
                T value = main[i * n + m] * at[0];
                if (i > 0) value += beside[i * n + m] * at[-n - 1];
                if (m < n - i - 1) value += beside[(i + 1) * n + m] * at[n + 1];
                P[i * n + i + m] = value;
            }
    }

    // The count of entries of the even part of a diagonal, with the middle one.
    static int64_t even_of(int64_t length) { return (length + 1) / 2; }

    // Columns are added in a fixed order, with the rows beside each other.
    void multiply_halves(const T* W, T* P) {
        const double* matrix = numbers;
        for (int64_t m = 0; m < n; ++m) {
            const int64_t length = n - m;
            for (int64_t odd = 0; odd < 2; ++odd) {
                const int64_t size = odd ? length / 2 : even_of(length);
                T* const sum = halves.data() + odd * even_of(n);
                std::fill_n(sum, size, T(0.0));
                for (int64_t a = 0; a < size; ++a) {
                    const int64_t b = length - 1 - a;
                    const T here = W[a * n + a + m], there = a == b ? T(0.0) : W[b * n + b + m];
                    const T part = odd ? here - there : here + there;
                    for (int64_t i = 0; i < size; ++i) sum[i] += matrix[a * size + i] * part;
                }
                matrix += size * size;
            }
            const T *even = halves.data(), *odd = even + even_of(n);
            for (int64_t a = 0; a < even_of(length); ++a) {
                const int64_t b = length - 1 - a;
                P[a * n + a + m] = a == b ? even[a] : even[a] + odd[a];
                if (a != b) P[b * n + b + m] = even[a] - odd[a];
            }
        }
    }

    void mirror(T* P) const {
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = i + 1; j < n; ++j) P[j * n + i] = -conjugate(P[i * n + j]);
    }
};

// Whether a state has independent layers, by the integers of its stream.
inline bool layered(const int64_t* whole) { return whole[2] == LAYERED; }

// The stream of the layers of a fluid. `numbers`: the weight of each layer in the energy, the matrices from layers to
// vertical modes and from these to layers, row by row, and the map of each mode, of one kind.
template <class T>
class LayeredMap {
  public:
    LayeredMap(int64_t kind, int64_t size, int64_t layers, const double* numbers)
        : square(size * size), layers(layers), weights(numbers), to_modes(weights + layers),
          to_layers(to_modes + layers * layers), mode(square), of_mode(square) {
        const int64_t count = DiagonalMap<T>::numbers_of(kind, size);
        for (int64_t m = 0; m < layers; ++m)
            maps.emplace_back(kind, size, to_layers + layers * layers + m * count);
    }

    int64_t work() const { return layers * (maps[0].work() + 2 * layers * square); }
    bool upper_suffices() const { return maps[0].upper_suffices(); }
    double weight(int64_t l) const { return weights[l]; }

    void apply(const T* X, T* Y, bool upper) {
        std::fill_n(Y, layers * square, T(0.0));
        for (int64_t m = 0; m < layers; ++m) {
            std::fill_n(mode.data(), square, T(0.0));
            for (int64_t l = 0; l < layers; ++l) add(to_modes[m * layers + l], X + l * square, mode.data());
            maps[m].apply(mode.data(), of_mode.data(), upper);
            for (int64_t l = 0; l < layers; ++l) add(to_layers[l * layers + m], of_mode.data(), Y + l * square);
        }
    }

  private:
    const int64_t square, layers;
    const double *const weights, *const to_modes, *const to_layers;
    std::deque<DiagonalMap<T>> maps;  // which do not move
    std::vector<T> mode, of_mode;

    void add(double factor, const T* from, T* to) const {
        for (int64_t e = 0; e < square; ++e) to[e] += factor * from[e];
    }
};

// The stream of a state of one or two layers, X = Theta + eps W: Y = P + eps J, where P comes from W and J from Theta;
// with a buoyancy Theta that adds B Theta to W, entry by entry, P comes from W - B Theta and J is -B P, of a Theta and a J
// without their means; or of independent layers.
template <class T>
class Stream {
  public:
    // `whole`: the size, the layers, the kinds of the two maps, -1 for none, or LAYERED and that of the vertical modes,
    // whether a constant is added, and the address of a function. `numbers`: the constant, and the numbers that the maps
    // read, of THERMAL the n x n factors B.
    Stream(const int64_t* whole, const double* numbers)
        : n(whole[0]), layers(whole[1]), second(whole[3] >= 0 && whole[3] != THERMAL && !layered(whole)),
          direct(layered(whole)),
          constant(whole[4] ? numbers : nullptr),
          function(whole[2] == BY_FUNCTION ? whole[5] : 0),
          all_layers(direct ? std::make_unique<LayeredMap<T>>(whole[3], n, layers, numbers + offset(whole)) : nullptr),
          first_map(whole[2], n, numbers + offset(whole)),
          second_map(second ? whole[3] : int64_t(BY_FUNCTION), n,
                     numbers + offset(whole) + DiagonalMap<T>::numbers_of(whole[2], n)),
          of_buoyancy(whole[3] == THERMAL && !direct
                          ? numbers + offset(whole) + DiagonalMap<T>::numbers_of(whole[2], n)
                          : nullptr),
          vorticity(of_buoyancy ? n * n : 0) {}

    int64_t work() const {
        return direct ? all_layers->work() : first_map.work() + (second ? second_map.work() : 0);
    }
    double weight(int64_t l) const { return direct ? all_layers->weight(l) : 1.0; }

    // Compute the stream Y of X, with `upper` as for a map; return whether a function gave finite numbers.
    bool apply(const T* X, double t, T* Y, bool upper = false) {
        const int64_t all = layers * n * n;
        if (function) {
            call(function, reinterpret_cast<const double*>(X), t, reinterpret_cast<double*>(Y));
            double nan_sum = 0.0;
            for (int64_t e = 0; e < all; ++e) nan_sum += std::abs(Y[e]) - std::abs(Y[e]);
            if (nan_sum != 0.0) return false;
        } else {
            apply_linear(X, Y, upper);
        }
        if (constant) {
            const T* added = reinterpret_cast<const T*>(constant);
            for (int64_t e = 0; e < all; ++e) Y[e] += added[e];
        }
        return true;
    }

    bool linear() const { return !function; }

    // Whether entries of a skew-Hermitian X below the diagonal are not read, if only those of Y above it are used.
    bool upper_suffices() const {
        if (direct) return all_layers->upper_suffices();
        return !function && first_map.upper_suffices() && (!second || second_map.upper_suffices());
    }

    // Whether the second layer of P is zero: the second layer of X moves the first one, which does not act on it.
    bool carries() const {
        return layers == 2 && !direct && !second && !of_buoyancy && !function && largest_constant(1) == 0.0;
    }

    // The largest number of a layer of the constant, whose round-off remains where it cancels, as in a state at rest.
    double largest_constant(int64_t layer) const {
        const int64_t count = constant ? n * n * int64_t(sizeof(T) / sizeof(double)) : 0;
        double largest = 0.0;
        for (int64_t e = layer * count; e < (layer + 1) * count; ++e)
            largest = std::max(largest, std::abs(constant[e]));
        return largest;
    }

    // The same without the constant, for a stream that is not a function.
    void apply_linear(const T* X, T* Y, bool upper = false) {
        const int64_t square = n * n;
        if (direct) return all_layers->apply(X, Y, upper);
        if (of_buoyancy) {
            const T mean = mean_of(X);
            for (int64_t e = 0; e < square; ++e) vorticity[e] = X[square + e] - of_buoyancy[e] * X[e];
            for (int64_t e = 0; e < square; e += n + 1) vorticity[e] += of_buoyancy[e] * mean;
            first_map.apply(vorticity.data(), Y, upper);
            for (int64_t e = 0; e < square; ++e) Y[square + e] = -(of_buoyancy[e] * Y[e]);
            const T rest = mean_of(Y + square);
            for (int64_t e = 0; e < square; e += n + 1) Y[square + e] -= rest;
            return;
        }
        first_map.apply(X + (layers - 1) * square, Y, upper);
        if (second) second_map.apply(X, Y + square, upper);
        else std::fill_n(Y + square, (layers - 1) * square, T(0.0));
    }

  private:
    const int64_t n, layers;
    const bool second;

  public:
    const bool direct;  // whether layers are independent

  private:
    const double* const constant;
    const int64_t function;  // its address, or 0
    const std::unique_ptr<LayeredMap<T>> all_layers;
    DiagonalMap<T> first_map, second_map;
    const double* const of_buoyancy;
    std::vector<T> vorticity;  // without that part

    T mean_of(const T* W) const {
        T sum(0.0);
        for (int64_t e = 0; e < n * n; e += n + 1) sum += W[e];
        return sum / double(n);
    }

    static int64_t offset(const int64_t* whole) {
        return whole[4] ? whole[1] * whole[0] * whole[0] * int64_t(sizeof(T) / sizeof(double)) : 0;
    }
};

}  // namespace coadjoint
