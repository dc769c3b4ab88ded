// The isospectral midpoint rule of skew-Hermitian matrices, by Newton's method for the stream matrix P at the midpoint.
//
// With X = (h/2) P, B = (1 - X)^-1 and C = B - 1 the midpoint is M = B W B* = W + Z - Z* + V, Z = C W, V = Z C*, and
// P = stream(M) is solved. The step adds 2 (Z - Z*) + 4 V to W, which is conjugation by the Cayley transform 1 + 2 C of
// X: any P preserves the spectrum. A change D of P adds Y - Y* to M, Y = (h/2) B D M, and 2 (Y' - Y'*) to the step,
// Y' = (h/2) B D N with N = M (1 - X) = M + V - Z*. The linear equation for D needs few digits, and is solved in the
// lower precision. P is predicted from earlier steps, so that mostly one Newton step of one product by its slope is
// left: 2 5/8 products in the precision of the states, one of them the inverse, and four in the lower one.
#pragma once

#include "matrices/cayley.hpp"
#include "matrices/isospectral.hpp"

namespace coadjoint {

template <class T>
struct Lower;
template <>
struct Lower<double> {
    typedef float type;
};
template <>
struct Lower<Complex> {
    typedef std::complex<float> type;
};

inline float rounded(double value) { return float(value); }
inline std::complex<float> rounded(const Complex& value) { return {float(value.real()), float(value.imag())}; }
inline double exact(float value) { return value; }
inline Complex exact(const std::complex<float>& value) { return {value.real(), value.imag()}; }

template <class T>
struct SkewMidpoint final : Isospectral<T> {
    typedef Isospectral<T> Base;
    typedef typename Lower<T>::type LowPrecision;
    using Base::n, Base::all, Base::numbers, Base::stream;

    static constexpr int64_t PARTS = sizeof(T) / sizeof(double);
    static constexpr int64_t HISTORY = 14;            // rows of earlier steps from which P is predicted
    static constexpr int64_t SAMPLES = 256, RUN = 8;  // numbers of a row to which a prediction is fitted, in short runs
    static constexpr int64_t MOST_CORRECTIONS = 24;
    static constexpr double LOW_ACCURACY = 0x1p-21;  // accuracy of a correction in the lower precision
    static constexpr double LAST_DIGIT = 0x1p-52;
    static constexpr double NEAR = 0x1p-28;  // of P: within it, one correction reaches round-off
    static constexpr double GROWN = 2.0;  // K shrinks a residual by up to this factor less than the one before

    const int64_t half;  // real numbers on and above the diagonal; packed matrices have these only, row by row
    const PlaneProducts<T> products;
    const PlaneProducts<LowPrecision> low;
    Cayley<T> cayley;
    PlanesOf<T> planes;
    PlanesOf<LowPrecision> low_planes;
    const Planes<T> W_planes, C, Z, V;
    const Planes<LowPrecision> B, low_M, low_N, changed, U, Y;
    std::vector<T> M, G, image;
    std::vector<T> P, F, D, R, base, residuals;  // packed

    // Directions kept orthogonal; more cost memory, and fewer cost iterations.
    static constexpr int64_t DIRECTIONS = 4;
    struct Direction {
        std::vector<LowPrecision> p, q;
        double square, share, overlap[DIRECTIONS];
    };
    Direction directions[DIRECTIONS];

    explicit SkewMidpoint(const StepTables& tables)
        : Base(tables), half(numbers / n * (n + 1) / 2), products(tables.whole[REAL_GEMM], n),
          low(tables.whole[LOWER_GEMM], n), cayley(tables.whole[REAL_GEMM], n), planes(all, 4), low_planes(all, 6),
          W_planes(planes.layer(0)), C(planes.layer(1)), Z(planes.layer(2)), V(planes.layer(3)),
          B(low_planes.layer(0)), low_M(low_planes.layer(1)), low_N(low_planes.layer(2)),
          changed(low_planes.layer(3)), U(low_planes.layer(4)), Y(low_planes.layer(5)), M(all), G(all), image(all),
          P(entries()), F(entries()), D(entries()), R(entries()), base(entries()), residuals(entries()) {
        for (Direction& each : directions) each.p.resize(entries()), each.q.resize(entries());
        this->memory_size = 3 + (2 + HISTORY) * half;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const T* W = reinterpret_cast<const T*>(x);  // dx is below its last digit
        double *p = numbers_of(P.data()), *d = numbers_of(D.data()), *rest = numbers_of(R.data());
        if (!predict(W, t, h)) return UNDEFINED;
        for (int64_t e = 0; e < all; ++e) W_planes.set(e, W[e]);
        this->iterations = 0, this->evaluations = 1;
        this->status = DONE;
        bool corrected = false;
        const double constant = stream.largest_constant();
        while (!corrected) {
            solve(W, h);
            if (!evaluate(t + 0.5 * h)) return UNDEFINED;
            const double size = std::max(largest_of(half, [=](int64_t k) { return p[k]; }), constant);
            if (this->ended(this->residual, size) || this->residual <= LAST_DIGIT * size) break;
            const bool last = this->residual <= NEAR * size;
            const double enough = std::max(LOW_ACCURACY * this->residual, last ? LAST_DIGIT * size : NEAR * size / 4);
            corrected = correct(enough) && last;
            for (int64_t k = 0; k < half; ++k) p[k] += d[k], rest[k] += d[k];
        }
        if (this->status != DONE) return this->status;
        store_history(h, corrected);
        if (corrected) {
            const double scale = 1.0 / this->residual;
            multiply_change([this, scale](int64_t k) { return rounded(scale * D[k]); }, low_N);
        }
        increment(corrected);
        this->advance(x, dx, G.data());
        return DONE;
    }

  private:
    int64_t entries() const { return n * (n + 1) / 2; }

    // Call use(first, at, count) for each row: the index of its diagonal entry, that when packed, and their number.
    template <class Use>
    void each_row(const Use& use) const {
        for (int64_t i = 0, at = 0; i < n; at += n - i, ++i) use(i * (n + 1), at, n - i);
    }

    // G := the matrix with the packed entries value(k), only on and above the diagonal if a stream reads no others.
    template <class Value>
    void unpack_for_stream(const Value& value) {
        T* const to = G.data();
        each_row([&](int64_t first, int64_t at, int64_t count) {
            for (int64_t j = 0; j < count; ++j) to[first + j] = value(first + j, at + j);
        });
        if (stream.upper_suffices()) return;
        each_pair(n, [=](int64_t e, int64_t f) {
            if (e != f) to[e] = -conjugate(to[f]);
        });
    }

    // F := stream(M) - P, and the residual its largest number. Of a linear stream that is stream(M - base) - R, whose
    // rounding errors are relative to these small numbers.
    bool evaluate(double t) {
        const T *m = M.data(), *b = base.data();
        if (stream.linear()) {
            unpack_for_stream([=](int64_t e, int64_t k) { return m[e] - b[k]; });
            stream.apply_linear(G.data(), image.data(), true);
        } else if (!stream.apply(m, t, image.data(), true)) {
            return false;
        }
        ++this->evaluations;
        const double *g = numbers_of(image.data()), *less = numbers_of(stream.linear() ? R.data() : P.data());
        double* f = numbers_of(F.data());
        this->residual = 0.0;
        each_row([&](int64_t first, int64_t at, int64_t count) {
            const double* const from = g + PARTS * first;
            const double most = largest_of(PARTS * count, [=](int64_t k) {
                return f[PARTS * at + k] = from[k] - less[PARTS * at + k];
            });
            if (!(most <= this->residual)) this->residual = most;  // NaN stays
        });
        return true;
    }

    // Set `to` to the skew-Hermitian matrix with the packed entries value(k).
    template <class R, class Value>
    void unpack(const Planes<R>& to, const Value& value) const {
        each_row([&](int64_t first, int64_t at, int64_t count) {
            for (int64_t j = 0; j < count; ++j) to.set(first + j, value(at + j));
        });
        each_pair(n, [=](int64_t e, int64_t f) {
            if (e != f) to.set(e, -conjugate(to.at(f)));
        });
    }

    // Compute the midpoint M for P, and (h/2) M and (h/2) N, N = M (1 - X) = M + V - Z*, in the lower precision.
    void solve(const T* W, double h) {
        const T* p = P.data();
        const Planes<T> C = this->C, Z = this->Z, V = this->V;
        unpack(C, [=](int64_t k) { return 0.5 * h * p[k]; });
        cayley.transform(C);
        products.multiply(C, W_planes, Z);
        for (int64_t e = 0; e < all; ++e) Z.set_with_difference(e, Z.product(e));
        products.lower(Z, C, V, true);
        const Planes<LowPrecision> low_M = this->low_M, low_N = this->low_N;
        const double half_step = 0.5 * h;
        const bool whole = !stream.upper_suffices();
        T* m = M.data();
        each_pair(n, [=](int64_t e, int64_t f) {
            const T z = Z.at(e), opposite = Z.at(f), v = V.product_by_adjoint(e);
            const T entry = W[e] + (v + (z - conjugate(opposite))), low_entry = half_step * entry;
            low_N.set(f, rounded(-half_step * conjugate(entry + (v + z))));
            low_N.set(e, rounded(half_step * (entry + (v - conjugate(opposite)))));
            low_M.set(f, rounded(-conjugate(low_entry)));
            low_M.set(e, rounded(low_entry));
            if (whole) m[e] = entry;
            m[f] = e == f ? 0.5 * (entry - conjugate(entry)) : -conjugate(entry);
        });
    }

    // Y := B D A for the D of these packed entries.
    template <class Value>
    void multiply_change(const Value& value, const Planes<LowPrecision>& A) {
        const Planes<LowPrecision> U = this->U;
        unpack(changed, value);
        low.multiply(B, changed, U);
        for (int64_t e = 0; e < all; ++e) U.set(e, U.product(e));
        low.multiply(U, A, Y);
    }

    // image := K D, on and above the diagonal, for the D of these packed entries.
    template <class Value>
    void apply_slope(const Value& value) {
        multiply_change(value, low_M);
        const Planes<LowPrecision> Y = this->Y;
        const bool whole = !stream.upper_suffices();
        T* moved = G.data();
        each_pair(n, [=](int64_t e, int64_t f) {
            const T entry = exact(Y.product(f) - conjugate(Y.product(e)));
            if (whole) moved[e] = -conjugate(entry);
            moved[f] = entry;
        });
        stream.apply_linear(G.data(), image.data(), true);
        ++this->evaluations;
    }

    // G := 2 (Z - Z*) + 4 V, and with `corrected` 2 (Y - Y*) of the last change of P.
    void increment(bool corrected) {
        const Planes<T> Z = this->Z, V = this->V;
        const Planes<LowPrecision> Y = this->Y;
        T* move = G.data();
        const double twice = 2.0 * this->residual;
        each_pair(n, [=](int64_t e, int64_t f) {
            T entry = 4.0 * V.product_by_adjoint(e) + 2.0 * (Z.at(e) - conjugate(Z.at(f)));
            if (corrected) entry += twice * exact(Y.product(e) - conjugate(Y.product(f)));
            if (e == f) entry = 0.5 * (entry - conjugate(entry));
            move[f] = -conjugate(entry);
            move[e] = entry;
        });
    }

    // Solve D - K D = F, where K D is the stream of Y - Y*, Y = (h/2) B D M, up to an error of at most `enough`; return
    // whether that was reached. After D = F the residual is K F. Then residuals are minimized along one direction after
    // the other, whose images under 1 - K are orthogonal to the others since the last restart (GCR). The last residual
    // is added to D, which leaves K of it.
    bool correct(double enough) {
        std::copy_n(F.data(), entries(), D.data());
        if (!stream.linear()) return false;
        const Planes<T> C = this->C;
        const Planes<LowPrecision> B = this->B;
        for (int64_t e = 0; e < all; ++e) B.set(e, rounded(C.at(e)));
        for (int64_t e = 0; e < all; e += n + 1) B.set(e, B.at(e) + LowPrecision(1));
        // The lower precision has a small range: residuals are in units of the first one.
        const double unit = this->residual, scale = 1.0 / unit;
        const T* f = F.data();
        apply_slope([=](int64_t k) { return rounded(scale * f[k]); });
        each_row([&](int64_t first, int64_t at, int64_t count) {
            std::copy_n(image.data() + first, count, residuals.data() + at);
        });
        double *r = numbers_of(residuals.data()), *d = numbers_of(D.data());
        double left = largest_of(half, [=](int64_t k) { return r[k]; }), shrunk = left;
        int64_t used = 0;
        const auto reached = [&] { return left * std::min(GROWN * shrunk, 1.0) <= enough * scale; };
        for (int64_t k = 1; k < MOST_CORRECTIONS && !reached(); ++k) {
            if (used == DIRECTIONS) combine(used, unit), used = 0;
            Direction& now = directions[used];
            float *p = row(now.p), *q = row(now.q);
            for (int64_t e = 0; e < half; ++e) p[e] = float(r[e]);
            const LowPrecision* entry = now.p.data();
            apply_slope([=](int64_t e) { return entry[e]; });
            each_row([&](int64_t first, int64_t at, int64_t count) {
                for (int64_t j = 0; j < count; ++j) now.q[at + j] = rounded(image[first + j]);
            });
            shrunk = largest_of(half, [=](int64_t e) { return double(q[e]); }) / left;
            for (int64_t e = 0; e < half; ++e) q[e] = p[e] - q[e];
            for (int64_t j = 0; j < used; ++j) {
                Direction& old = directions[j];
                const float *other = row(old.q), overlap = float(dot(q, other) / old.square);
                now.overlap[j] = overlap;
                for (int64_t e = 0; e < half; ++e) q[e] -= overlap * other[e];
            }
            now.square = dot(q, q);
            now.share = dot(r, q) / now.square;
            if (!(now.square > 0.0) || !(now.share - now.share == 0.0)) break;
            const double share = now.share;
            left = largest_of(half, [=](int64_t e) { return r[e] -= share * q[e]; });
            ++used;
        }
        combine(used, unit);
        for (int64_t k = 0; k < half; ++k) d[k] += unit * r[k];
        return reached();
    }

    // Add the sum of the directions to D: shares of the orthogonal images become those of the directions.
    void combine(int64_t used, double unit) {
        double* d = numbers_of(D.data());
        for (int64_t k = used - 1; k >= 0; --k) {
            Direction& now = directions[k];
            const double share = now.share;
            for (int64_t j = 0; j < k; ++j) directions[j].share -= now.overlap[j] * share;
            const float* p = row(now.p);
            for (int64_t e = 0; e < half; ++e) d[e] += unit * share * double(p[e]);
        }
    }

    template <class A, class B>
    double dot(const A* a, const B* b) const { return dot(half, a, b); }

    template <class A, class B>
    static double dot(int64_t count, const A* a, const B* b) {
        // Partial sums, in a fixed order on every processor.
        constexpr int64_t ROWS = 8;
        double sums[ROWS] = {};
        int64_t e = 0;
        for (; e + ROWS <= count; e += ROWS)
            for (int64_t k = 0; k < ROWS; ++k) sums[k] += double(a[e + k]) * double(b[e + k]);
        for (; e < count; ++e) sums[0] += double(a[e]) * double(b[e]);
        for (int64_t k = 1; k < ROWS; ++k) sums[0] += sums[k];
        return sums[0];
    }

    static float* row(std::vector<LowPrecision>& of) { return reinterpret_cast<float*>(of.data()); }

    // memory: the number of steps that it knows, their length, the row that was written last, M of the last step, K D
    // of its last change D of P, and a ring of rows: stream(M + M of the step before - 2 W in between), small and smooth
    // in time. From these, P of the last step is stream(M) + K D. (P is stored instead of M if the stream is a function.)
    bool known_steps(double h) const {
        return this->memory && this->memory[0] == this->memory[0] && this->memory[1] == h;
    }
    double* past(int64_t steps) const {
        return this->memory + 3 + (2 + (int64_t(this->memory[2]) + steps) % HISTORY) * half;
    }

    // P := stream(base) + R; return whether the stream is defined. With the M before, base = 2 W - M. The next row is
    // predicted by the combination that fits the last one to those before it.
    bool predict(const T* W, double t, double h) {
        const bool known = known_steps(h), linear = stream.linear();
        double *p = numbers_of(P.data()), *rest = numbers_of(R.data()), *b = numbers_of(base.data());
        std::fill_n(rest, half, 0.0);
        const double* last = known ? this->memory + 3 : rest;
        // Call use(at, from, count) for the numbers of each row, in a matrix and packed.
        const auto rows_of = [&](const T* matrix, const auto& use) {
            const double* const from = reinterpret_cast<const double*>(matrix);
            each_row([&](int64_t first, int64_t at, int64_t count) {
                use(PARTS * at, from + PARTS * first, PARTS * count);
            });
        };
        const double of_W = known && linear ? 2.0 : 1.0, of_M = known && linear ? 1.0 : 0.0;
        rows_of(W, [=](int64_t at, const double* from, int64_t count) {
            for (int64_t k = 0; k < count; ++k) b[at + k] = of_W * from[k] - of_M * last[at + k];
        });
        const T* const unpacked = base.data();
        if (linear) unpack_for_stream([=](int64_t, int64_t k) { return unpacked[k]; });
        if (!stream.apply(linear ? G.data() : W, t, image.data(), true)) return false;
        if (known) {
            double factor[HISTORY];
            const int64_t taken = fit(int64_t(this->memory[0]) - 1, factor);
            const double* slope = this->memory + 3 + half;
            // Numbers that stay in the first cache while all samples are added.
            constexpr int64_t BLOCK = 2048;
            for (int64_t begin = 0; begin < half; begin += BLOCK) {
                const int64_t end = std::min(begin + BLOCK, half);
                for (int64_t k = begin; k < end; ++k) rest[k] -= slope[k];
                for (int64_t j = 0; j < taken; ++j) {
                    const double *row = past(j), share = factor[j];
                    for (int64_t k = begin; k < end; ++k) rest[k] += share * row[k];
                }
            }
        }
        const double of_stream = known && !linear ? 2.0 : 1.0, of_P = known && !linear ? 1.0 : 0.0;
        rows_of(image.data(), [=](int64_t at, const double* from, int64_t count) {
            for (int64_t k = 0; k < count; ++k)
                p[at + k] = (of_stream * from[k] - of_P * last[at + k]) + rest[at + k];
        });
        return true;
    }

    // Least squares for samples of the rows, by orthogonalization; return the number of factors.
    int64_t fit(int64_t rows, double* factor) const {
        if (rows < 2) return std::fill_n(factor, rows, 1.0), rows;
        const int64_t count = std::min(half, SAMPLES), run = half < SAMPLES ? half : RUN, runs = count / run;
        double sample[HISTORY][SAMPLES], share[HISTORY][HISTORY];  // the last row in sample[0]
        for (int64_t j = 0; j < rows; ++j) {
            const double* row = past(j);
            for (int64_t k = 0; k < runs; ++k) std::copy_n(row + k * (half / runs), run, sample[j] + k * run);
        }
        const double* newest = sample[0];
        const double scale = 1.0 / largest_of(count, [=](int64_t k) { return newest[k]; });
        if (!(scale - scale == 0.0)) return 0;
        int64_t taken = 0;
        for (int64_t j = 0; j < rows; ++j)
            for (int64_t k = 0; k < count; ++k) sample[j][k] *= scale;
        for (int64_t j = 1; j < rows && taken < count / 2; ++j, ++taken) {
            const double square = dot(count, sample[j], sample[j]);
            if (!(square > 0.0)) break;
            for (int64_t i = 0; i < rows; ++i) {
                if (i > 0 && i <= j) continue;
                const double part = share[j][i] = dot(count, sample[j], sample[i]) / square;
                for (int64_t k = 0; k < count; ++k) sample[i][k] -= part * sample[j][k];
            }
        }
        for (int64_t j = taken; j > 0; --j) {
            factor[j - 1] = share[j][0];
            for (int64_t i = j + 1; i <= taken; ++i) factor[j - 1] -= share[j][i] * factor[i - 1];
        }
        return taken;
    }

    void store_history(double h, bool corrected) {
        double* memory = this->memory;
        if (!memory) return;
        const bool known = known_steps(h);
        if (!known) memory[0] = 0.0, memory[1] = h, memory[2] = 0.0;
        const double *f = numbers_of(F.data()), *d = numbers_of(D.data()), *rest = numbers_of(R.data());
        double* slope = memory + 3 + half;
        if (known) {
            memory[2] = double((int64_t(memory[2]) + HISTORY - 1) % HISTORY);
            double* row = past(0);
            for (int64_t k = 0; k < half; ++k) row[k] = rest[k] + slope[k] + (corrected ? 0.0 : f[k]);
        }
        const bool linear = stream.linear();
        for (int64_t k = 0; k < half; ++k) slope[k] = corrected && linear ? d[k] - f[k] : 0.0;
        T* const last = reinterpret_cast<T*>(memory + 3);
        each_row([&](int64_t first, int64_t at, int64_t count) {
            std::copy_n(linear ? M.data() + first : P.data() + at, count, last + at);
        });
        memory[0] = std::min(memory[0] + 1.0, double(HISTORY + 1));
    }
};

}  // namespace coadjoint
