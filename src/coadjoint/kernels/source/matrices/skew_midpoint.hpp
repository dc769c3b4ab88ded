// The isospectral midpoint rule of skew-Hermitian matrices, by Newton's method for the stream matrix P at the midpoint.
//
// With X = (h/2) P, B = (1 - X)^-1 and C = B - 1 the midpoint is M = B W B* = W + Z - Z* + V, Z = C W, V = Z C*, and
// P = stream(M) is solved. The step adds 2 (Z - Z*) + 4 V to W, which is conjugation by the Cayley transform 1 + 2 C of
// X: any P preserves the spectrum. A change D of P adds Y - Y* to M, Y = (h/2) B D M, and 2 (Y' - Y'*) to the step,
// Y' = (h/2) B D N with N = M (1 - X) = M + V - Z*. The linear equation for D needs few digits, and is solved in the
// lower precision. P is predicted from earlier steps, so that mostly one Newton step of one product by its slope is
// left: 2 5/8 products in the precision of the states, one of them the inverse, and four in the lower one.
#pragma once

#include "matrices/prediction.hpp"
#include "matrices/skew_step.hpp"

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

template <class T>
struct SkewMidpoint final : SkewStep<T> {
    typedef SkewStep<T> Base;
    typedef typename Lower<T>::type LowPrecision;
    using Base::n, Base::square, Base::stream, Base::PARTS, Base::LAST_DIGIT, Base::GROWN, Base::layers, Base::moving;
    using Base::STATE, Base::INVERSE, Base::FIRST, Base::SECOND;
    using Base::products, Base::whole, Base::each_product, Base::load_both, Base::store_for_stream, Base::G, Base::image;

    static constexpr int64_t HISTORY = MOST_ROWS;  // rows of earlier steps from which P is predicted
    static constexpr int64_t MOST_CORRECTIONS = 24;
    static constexpr double LOW_ACCURACY = 0x1p-21;  // accuracy of a correction in the lower precision
    static constexpr double NEAR = 0x1p-28;  // of P: within it, one correction reaches round-off

    // Directions kept orthogonal; more cost memory, and fewer cost iterations.
    static constexpr int64_t DIRECTIONS = 4;
    enum LowMatrix { LOW_INVERSE, LOW_MIDPOINT, LOW_END, CHANGE, TURNED, SLOPE, LOW_MATRICES };

    // Packed matrices have the `half` real numbers on and above the diagonal only, row by row, of each layer.
    const int64_t half;
    const PlaneProducts<LowPrecision> low;
    PlanesOf<LowPrecision> low_planes;
    std::vector<double> M, base, P, F, D, R, residuals;  // packed
    std::vector<double> weight;  // of a layer of P, by which residuals are compared
    std::vector<double> largest_of_row;

    struct Direction {
        std::vector<float> p, q;
        double square, share, overlap[DIRECTIONS];
    };
    Direction directions[DIRECTIONS];

    explicit SkewMidpoint(const StepTables& tables)
        : Base(tables), half(PARTS * n * (n + 1) / 2), low(tables.whole[LOWER_GEMM], n),
          low_planes(square, LOW_MATRICES * layers), M(layers * half), base(M), P(moving * half), F(P), D(P), R(P),
          residuals(P), weight(moving, 1.0), largest_of_row(n) {
        for (Direction& each : directions) each.p.resize(P.size()), each.q.resize(P.size());
        this->memory_size = 3 + M.size() + (1 + HISTORY) * P.size();
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const T* W = reinterpret_cast<const T*>(x);  // dx is below its last digit
        if (!predict(W, t, h)) return UNDEFINED;
        this->load_state(W);
        this->iterations = 0, this->evaluations = 1;
        bool corrected = false;
        while (!corrected) {
            solve(h);
            double size;
            if (!evaluate(t + 0.5 * h, size)) return UNDEFINED;
            if (this->ended(this->residual, size) || this->residual <= LAST_DIGIT * size) break;
            const bool last = this->residual <= NEAR * size;
            const double enough = std::max(LOW_ACCURACY * this->residual, last ? LAST_DIGIT * size : NEAR * size / 4);
            corrected = correct(enough) && last;
        }
        if (this->status != DONE) return this->status;
        store_history(h, corrected);
        if (corrected) multiply_change(D.data(), [this](int64_t) { return 1.0 / this->residual; }, LOW_END, 0);
        advance(x, dx, corrected);
        return DONE;
    }

    // Z of the last P, which a correction moves away from INVERSE.
    void store_changes(double h, double* to) override {
        for (int64_t l = 0; l < moving; ++l) unpack<T>(n, P.data() + l * half, 0.5 * h, whole(INVERSE, l));
        this->invert();
        for (int64_t l = 0; l < moving; ++l)
            for (int64_t p = 0; p < PARTS; ++p)
                shared_copy(whole(INVERSE, l).plane[p], square, to + (l * PARTS + p) * square);
    }

  private:
    Planes<LowPrecision> lower(int64_t matrix, int64_t l) { return low_planes.layer(matrix * layers + l); }

    // c := a b in the lower precision, layers from a number on.
    void multiply_low(int64_t a, int64_t b, int64_t c, int64_t in_a, int64_t in_b, int64_t from = 0) {
        each_product(in_a, in_b, from, [&](int64_t i, int64_t j, int64_t l, bool add) {
            low.multiply(lower(a, i), lower(b, j), lower(c, l), add);
        });
    }

    // Call use(first, at, count) for each row, on the threads of a team: the index in G of its diagonal entry's first
    // number, that of a packed matrix, and the count of its numbers.
    template <class Use>
    void each_row(int64_t in_layers, const Use& use) const {
        for (int64_t l = 0; l < in_layers; ++l)
            each_row_shared(n, [&](int64_t i) {
                use(PARTS * (l * square + i * (n + 1)), l * half + PARTS * packed_index(n, i, i), PARTS * (n - i));
            });
    }

    // The largest |value(row number k of image, k packed)| of a layer; NaN if one of them is not finite.
    template <class Value>
    double largest_of_rows(int64_t l, const Value& value) {
        const double* const from = reinterpret_cast<const double*>(image.data()) + PARTS * l * square;
        each_row_shared(n, [&](int64_t i) {
            const double* const row = from + PARTS * i * (n + 1);
            const int64_t at = l * half + PARTS * packed_index(n, i, i);
            largest_of_row[i] = largest_of(PARTS * (n - i), [=](int64_t k) { return value(row[k], at + k); });
        });
        double most = 0.0;
        for (int64_t i = 0; i < n; ++i) keep_larger(most, largest_of_row[i]);
        return most;
    }

    // F := stream(M) - P, the residual, its largest number, and the size of P. Of a linear stream F is stream(M - base)
    // - R, whose rounding errors are relative to these small numbers. Layers are compared in units of the first P.
    bool evaluate(double t, double& size) {
        if (stream.linear()) stream.apply_linear(G.data(), image.data(), true);
        else if (!stream.apply(G.data(), t, image.data(), true)) return false;
        ++this->evaluations;
        const double *less = stream.linear() ? R.data() : P.data(), *p = P.data();
        double* f = F.data();
        std::vector<double> residual(moving), sizes(moving);
        double largest = 0.0;
        for (int64_t l = 0; l < moving; ++l) {
            residual[l] = largest_of_rows(l, [=](double from, int64_t k) { return f[k] = from - less[k]; });
            sizes[l] = shared_largest(half, [=](int64_t k) { return p[l * half + k]; });
            sizes[l] = std::max(sizes[l], stream.largest_constant(l));
            largest = std::max(largest, std::max(sizes[l], residual[l]));
        }
        this->residual = size = 0.0;
        for (int64_t l = 0; l < moving; ++l) {
            const double own = std::max(sizes[l], residual[l]);
            if (this->iterations == 0) weight[l] = own > 0.0 ? largest / own : 1.0;
            const double found = weight[l] * residual[l];
            if (!(found <= this->residual) && this->residual - this->residual == 0.0) this->residual = found;
            size = std::max(size, weight[l] * sizes[l]);
        }
        return true;
    }

    // Compute C, Z and V for P, the midpoint M, and (h/2) M and (h/2) N, N = M (1 - X) = M + V - Z*, in the lower
    // precision; G := what a stream reads.
    void solve(double h) {
        for (int64_t l = 0; l < moving; ++l) unpack<T>(n, P.data() + l * half, 0.5 * h, whole(INVERSE, l));
        this->invert();
        this->multiply_state(INVERSE);
        const double half_step = 0.5 * h;
        const bool linear = stream.linear();
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<T> state = whole(STATE, l), opposite = whole(FIRST, l), V = whole(SECOND, l);
            const Planes<LowPrecision> midpoint = lower(LOW_MIDPOINT, l), end = lower(LOW_END, l);
            each_tile(n, [=, this](const TileRange& range) {
                const TileRange other = range.opposite();
                Tile<T> own, v, v_below, z, z_below, m, turned;  // z: of -Z*
                load(range, state, own), load(range, opposite, z), load(other, opposite, z_below);
                load_both(range, V, v, v_below);
                const Tile<T> z_opposite = z_below.opposite();
                m.set([&](int p, int i) {
                    return own.row[p][i] + (v.row[p][i] + (z_opposite.row[p][i] + z.row[p][i]));
                });
                if (range.diagonal()) m.mirror();
                turned.set([&](int p, int i) { return m.row[p][i] + (v.row[p][i] + z.row[p][i]); });
                store(range, m, half_step, midpoint), store(range, turned, half_step, end);
                store_packed(range, m, M.data() + l * half);
                if (!range.diagonal()) {
                    const Tile<T> m_below = m.opposite();
                    turned.set([&](int p, int i) {
                        return m_below.row[p][i] + (v_below.row[p][i] + z_below.row[p][i]);
                    });
                    store(other, m_below, half_step, midpoint), store(other, turned, half_step, end);
                }
                if (linear) {
                    load_packed(range, base.data() + l * half, own);
                    m.set([&](int p, int i) { return m.row[p][i] - own.row[p][i]; });
                }
                store_for_stream(range, m, G.data() + l * square);
            });
        }
    }

    // Y := B D A for the D of these packed numbers, times factor(layer); only layers of Y from a number on.
    template <class Number, class Factor>
    void multiply_change(const Number* packed, const Factor& factor, int64_t A, int64_t from) {
        typedef std::conditional_t<std::is_same_v<Number, double>, T, LowPrecision> Entry;
        for (int64_t l = 0; l < moving; ++l) unpack<Entry>(n, packed + l * half, factor(l), lower(CHANGE, l));
        multiply_low(LOW_INVERSE, CHANGE, TURNED, moving, moving);
        for (int64_t l = 0; l < moving; ++l) combine_products(square, lower(TURNED, l));
        multiply_low(TURNED, A, SLOPE, moving, layers, from);
    }

    // image := K D, on and above the diagonal, for the D of these packed numbers, times factor(layer).
    template <class Number, class Factor>
    void apply_slope(const Number* packed, const Factor& factor) {
        // A stream for which only one layer of P moves does not read the one that it carries.
        const int64_t from = stream.carries() ? 1 : 0;
        multiply_change(packed, factor, LOW_MIDPOINT, from);
        for (int64_t l = from; l < layers; ++l) {
            const Planes<LowPrecision> Y = lower(SLOPE, l);
            each_tile(n, [=](const TileRange& range) {
                Tile<T> moved;
                load_sum(range, Y, 1.0, moved);
                store_for_stream(range, moved, G.data() + l * square);
            });
        }
        stream.apply_linear(G.data(), image.data(), true);
        ++this->evaluations;
    }

    // Load a factor times Y - Y* of products of planes.
    static void load_sum(const TileRange& range, const Planes<LowPrecision>& Y, double factor, Tile<T>& to) {
        Tile<LowPrecision> above, below;
        load_product(range, Y, above), load_product(range.opposite(), Y, below);
        below = below.opposite();
        to.set([&](int p, int i) {
            return factor * __builtin_convertvector(above.row[p][i] + below.row[p][i], Row<double>);
        });
    }

    // Add 2 (Z - Z*) + 4 V to W, and with `corrected` 2 (Y - Y*) of the last change of P; with compensation.
    void advance(double* x, double* dx, bool corrected) {
        const double twice = 2.0 * this->residual;
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<LowPrecision> Y = lower(SLOPE, l);
            double *const to = x + PARTS * l * square, *const rest = dx + PARTS * l * square;
            each_tile(n, [=, this](const TileRange& range) {
                Tile<T> move = this->load_change(range, l);
                if (corrected) {
                    Tile<T> more;
                    load_sum(range, Y, twice, more);
                    move.set([&](int p, int i) { return move.row[p][i] + more.row[p][i]; });
                }
                this->add_both(range, move, to, rest);
            });
        }
    }

    // Solve D - K D = F, where K D is the stream of Y - Y*, Y = (h/2) B D M, up to an error of at most `enough`, and
    // add D to P; return whether that was reached. After D = F the residual is K F. Then residuals are minimized along
    // one direction after the other, whose images under 1 - K are orthogonal to the others since the last restart
    // (GCR). The last residual is added to D, which leaves K of it.
    bool correct(double enough) {
        double *p = P.data(), *rest = R.data(), *d = D.data(), *f = F.data(), *r = residuals.data();
        if (!stream.linear()) {
            share(int64_t(P.size()), [=](int64_t first, int64_t last) {
                for (int64_t k = first; k < last; ++k) d[k] = f[k], p[k] += d[k], rest[k] += d[k];
            });
            return false;
        }
        for (int64_t l = 0; l < moving; ++l) {
            const Planes<LowPrecision> B = lower(LOW_INVERSE, l);
            round_planes(square, whole(INVERSE, l), B);
            for (int64_t e = 0; e < square && (l == 0 || stream.direct); e += n + 1) B.plane[0][e] += 1.0f;
            add_parts(square, B);
        }
        // The lower precision has a small range: residuals are in units of the first one.
        const double unit = this->residual, scale = 1.0 / unit;
        apply_slope(f, [=](int64_t) { return scale; });
        double left = 0.0;
        for (int64_t l = 0; l < moving; ++l) {
            const double factor = weight[l];
            left = std::max(left, largest_of_rows(l, [=](double from, int64_t k) { return r[k] = factor * from; }));
        }
        double shrunk = left;
        int64_t used = 0;
        bool combined = false;
        const int64_t numbers = P.size();
        const auto reached = [&] { return left * std::min(GROWN * shrunk, 1.0) <= enough * scale; };
        for (int64_t k = 1; k < MOST_CORRECTIONS && !reached(); ++k) {
            if (used == DIRECTIONS) combine(used, combined), used = 0;
            Direction& now = directions[used];
            float *p = now.p.data(), *q = now.q.data();
            share(numbers, [=](int64_t first, int64_t last) {
                for (int64_t e = first; e < last; ++e) p[e] = float(r[e]);
            });
            apply_slope(p, [this](int64_t l) { return 1.0 / weight[l]; });
            double most = 0.0;
            for (int64_t l = 0; l < moving; ++l) {
                const double factor = weight[l];
                most = std::max(most, largest_of_rows(l, [=](double from, int64_t k) {
                                    return double(q[k] = float(factor * from));
                                }));
            }
            shrunk = most / left;
            share(numbers, [=](int64_t first, int64_t last) {
                for (int64_t e = first; e < last; ++e) q[e] = p[e] - q[e];
            });
            for (int64_t j = 0; j < used; ++j) {
                Direction& old = directions[j];
                const float *other = old.q.data(), overlap = float(dot(numbers, q, other) / old.square);
                now.overlap[j] = overlap;
                share(numbers, [=](int64_t first, int64_t last) {
                    for (int64_t e = first; e < last; ++e) q[e] -= overlap * other[e];
                });
            }
            now.square = dot(numbers, q, q);
            now.share = dot(numbers, r, q) / now.square;
            if (!(now.square > 0.0) || !(now.share - now.share == 0.0)) break;
            const double part = now.share;
            left = shared_largest(numbers, [=](int64_t e) { return r[e] -= part * q[e]; });
            ++used;
        }
        combine(used, combined);
        for (int64_t l = 0; l < moving; ++l) {
            const double own = unit / weight[l];
            share(half, [=](int64_t first, int64_t last) {
                for (int64_t k = l * half + first; k < l * half + last && combined; ++k) r[k] += d[k];
                for (int64_t k = l * half + first; k < l * half + last; ++k) {
                    d[k] = f[k] + own * r[k];
                    p[k] += d[k], rest[k] += d[k];
                }
            });
        }
        return reached();
    }

    // Add the sum of the directions to D: shares of the orthogonal images become those of the directions.
    void combine(int64_t used, bool& combined) {
        double* d = D.data();
        if (used > 0 && !combined) std::fill(D.begin(), D.end(), 0.0), combined = true;
        for (int64_t k = used - 1; k >= 0; --k) {
            Direction& now = directions[k];
            const double part = now.share;
            for (int64_t j = 0; j < k; ++j) directions[j].share -= now.overlap[j] * part;
            const float* p = now.p.data();
            share(int64_t(D.size()), [=](int64_t first, int64_t last) {
                for (int64_t e = first; e < last; ++e) d[e] += part * double(p[e]);
            });
        }
    }

    // memory: the number of steps that it knows, their length, the row that was written last, M of the last step, K D
    // of its last change D of P, and a ring of rows: stream(M + M of the step before - 2 W in between), small and
    // smooth in time. From these, P of the last step is stream(M) + K D. (P is stored instead of M if the stream is a
    // function.) After one step the row is stream(M) + 2 (P - stream(W before it)).
    double* slope_of_last() const { return this->memory + 3 + M.size(); }
    double* past(int64_t steps) const {
        return slope_of_last() + (1 + (int64_t(this->memory[2]) + steps) % HISTORY) * P.size();
    }

    // P := stream(base) + R; return whether the stream is defined. With the M before, base = 2 W - M. The next row is
    // predicted by the combination that fits the last one to those before it; in the second step, P - stream(W) at
    // its start is that of the first.
    bool predict(const T* W, double t, double h) {
        const bool known = this->known_steps(h), linear = stream.linear();
        const bool second = known && linear && this->memory[0] == 1.0;
        double *p = P.data(), *rest = R.data(), *b = base.data(), *g = numbers_of(G.data());
        if (!known || !linear) std::fill(R.begin(), R.end(), 0.0);
        const double *last = known ? this->memory + 3 : rest, *w = reinterpret_cast<const double*>(W);
        if (linear) {
            each_row(layers, [=](int64_t first, int64_t at, int64_t count) {
                for (int64_t k = 0; k < count; ++k)
                    g[first + k] = b[at + k] = known ? 2.0 * w[first + k] - last[at + k] : w[first + k];
            });
            for (int64_t l = 0; l < layers && !stream.upper_suffices(); ++l) {
                T* const to = G.data() + l * square;
                each_pair(n, [=](int64_t e, int64_t f) {
                    if (e != f) to[e] = -conjugate(to[f]);
                });
            }
        }
        if (!stream.apply(linear ? G.data() : W, t, image.data(), true)) return false;
        const double* const from = reinterpret_cast<const double*>(image.data());
        if (second) {
            const double* const row = past(0);
            each_row(moving, [=](int64_t first, int64_t at, int64_t count) {
                for (int64_t k = 0; k < count; ++k) rest[at + k] = 0.5 * (row[at + k] - from[first + k]);
            });
        } else if (known) {
            for (int64_t l = 0; l < moving; ++l) extrapolate(l, rest);
        }
        const double of_stream = known && !linear ? 2.0 : 1.0, of_P = known && !linear ? 1.0 : 0.0;
        each_row(moving, [=](int64_t first, int64_t at, int64_t count) {
            for (int64_t k = 0; k < count; ++k)
                p[at + k] = (of_stream * from[first + k] - of_P * last[at + k]) + rest[at + k];
        });
        return true;
    }

    // Compute the predicted row of a layer, less K D of the last step.
    void extrapolate(int64_t l, double* rest) const {
        double factor[HISTORY];
        const auto row = [this, l](int64_t j) -> const double* { return past(j) + l * half; };
        const int64_t taken = fit_rows(half, int64_t(this->memory[0]) - 1, row, factor);
        const double* const slope = slope_of_last() + l * half;
        share(half, [=](int64_t first, int64_t last) {
            for (int64_t k = first; k < last; ++k) rest[l * half + k] = -slope[k];
        });
        add_rows(half, taken, row, factor, rest + l * half);
    }

    void store_history(double h, bool corrected) {
        double* memory = this->memory;
        if (!memory) return;
        const bool known = this->known_steps(h), linear = stream.linear();
        if (!known) memory[0] = 0.0, memory[1] = h, memory[2] = 0.0;
        if (memory[0] > 1.0) memory[2] = double((int64_t(memory[2]) + HISTORY - 1) % HISTORY);
        const double *f = F.data(), *d = D.data(), *rest = R.data(), *p = P.data();
        double *slope = slope_of_last(), *row = past(0);
        const int64_t numbers = P.size();
        share(numbers, [=](int64_t first, int64_t last) {
            for (int64_t k = first; k < last && known; ++k) row[k] = rest[k] + slope[k] + (corrected ? 0.0 : f[k]);
            for (int64_t k = first; k < last; ++k) slope[k] = corrected && linear ? d[k] - f[k] : 0.0;
            for (int64_t k = first; k < last && !known; ++k) row[k] = (p[k] - slope[k]) + 2.0 * rest[k];
        });
        const std::vector<double>& last = linear ? M : P;
        shared_copy(last.data(), int64_t(last.size()), memory + 3);
        memory[0] = std::min(memory[0] + 1.0, double(HISTORY + 1));
    }
};

}  // namespace coadjoint
