// Runs of isospectral Gauss methods of skew-Hermitian matrices with tangent vectors, and backward, for Python.
//
// As in matrices/skew_stages.hpp, Z_i = h a_ii P_i V_i, V_i = 1 + sum_j (a_ij / a_jj) Z_j and B_i = (1 - h a_ii P_i)^-1; a
// step is W' = Q W Q*, Q = 1 + 2 sum_i Z_i. With R_i the sum of the other stages' (a_ij / a_jj) dZ_j, tangents are
//     dZ_i = B_i (h a_ii dP_i V_i + R_i) - R_i,  dP_i = stream(Y_i - Y_i* + V_i dW V_i*),  Y_i = (dZ_i + R_i) W V_i*,
// and dW' = Y - Y* + Q dW Q*, Y = 2 sum_i dZ_i W Q*. Backward, with R_i = -4 h a_ii G Q W, G the cotangent after the step,
// and the sum of the other stages' (a_ji / a_jj) z_j, those of P_i and M_i = V_i W V_i* are p_i and m_i,
//     z_i = B_i* (R_i - 2 h a_ii m_i V_i W) - R_i,  m_i = stream(p_i),  p_i = (Y_i - Y_i*)/2,  Y_i = (z_i + R_i) V_i*,
// and that before the step is Q* G Q + sum_i V_i* m_i V_i. With one stage, the last factor is moved into the others. Both
// are linear fixed points, with the contraction of the step. Streams are symmetric in the pairing of the layers: that of
// X0 + eps X1 has products of opposite layers, that of independent layers their weights.
#include "matrices/prediction.hpp"
#include "matrices/skew_step.hpp"
#include "tangents/members.hpp"
#include "tangents/stage_equations.hpp"

namespace coadjoint {

namespace {

// Indices in `whole` behind those of `TableIndex`: the count of coefficients and of streams that are slopes by them, the
// index of the numbers of the first one, a factor and those that a stream with a constant reads, the count of these, and
// the coefficient of each; and the blocks of the rows as `project_on_blocks` reads them.
enum SlopeIndex { COEFFICIENTS = GENERAL + 1, SLOPES, SLOPE_NUMBERS, SLOPE_SIZE, SLOPE_COEFFICIENTS };

// Visit the substeps of a step: with their beginning, length and number in the run.
template <class Run, class Visit>
void each_substep(const Stepping& tables, const Run& run, int64_t k, bool backward, const Visit& visit) {
    for (int64_t p = 0; p < tables.substeps; ++p) {
        const int64_t part = backward ? tables.substeps - 1 - p : p;
        visit(run.t0 + double(k - 1) * run.h + tables.moment[part] * run.h, tables.fraction[part] * run.h,
              (k - run.k0 - 1) * tables.substeps + part);
    }
}

template <class T>
class StepDerivative final : public SkewStep<T>, public Kept {
    typedef SkewStep<T> Base;
    using Base::n, Base::square, Base::all, Base::numbers, Base::stages, Base::stream, Base::PARTS, Base::LAST_DIGIT;
    using Base::GROWN, Base::layers, Base::moving, Base::STATE, Base::INVERSE, Base::FIRST, Base::SECOND, Base::whole;
    using Base::multiply, Base::G, Base::image;
    enum { WHOLE_STEP = Base::MATRICES, VECTOR, REST, SUM, FIRST_STAGE };
    // Of a stage: V, M, W V* or V W, B or its adjoint, V* behind R + z, R of one stage, z, and V dW V*.
    enum { POINT, MIDDLE, STATE_FACTOR, OWN, BEHIND, GIVEN, UNKNOWN, ADDED, OF_STAGE };
    static constexpr int64_t HISTORY = 8, MOST_HISTORIES = 8;  // earlier steps, of as many vectors

    const Stepping& stepping;
    const StepTables& tables;
    std::unique_ptr<StepScheme> scheme;
    std::deque<Stream<T>> slopes;
    std::vector<double> images, points, given;  // of all stages: dP or m, and what their streams read
    std::vector<T> row;
    struct History {
        int64_t count = 0;
        std::vector<double> rows;
    };
    // Of a member: the memory of its steps, and the last solutions for its first vectors.
    struct Past {
        std::vector<double> steps;
        std::vector<History> of_vectors;
    };
    std::vector<Past> pasts;
    Past* past = nullptr;
    const int64_t vectors;

  public:
    const int64_t coefficients, held;  // held: numbers of Z of a step

    StepDerivative(const Stepping& stepping, int64_t vectors)
        : Base(stepping.tables, FIRST_STAGE + OF_STAGE * stepping.tables.whole[STAGES]), stepping(stepping), tables(stepping.tables),
          scheme(reinterpret_cast<StepScheme* (*)(const StepTables&, const MemberConstants&)>(stepping.step[0])(
              tables, MemberConstants{1, 0})),
          images(stages * numbers), points(images), given(images), row(all), vectors(std::min(vectors, MOST_HISTORIES)),
          coefficients(tables.whole[COEFFICIENTS]),
          held(stages * moving * PARTS * square) {
        std::vector<int64_t> with_constant(tables.whole, tables.whole + GEMM);
        with_constant[4] = 1;
        for (int64_t k = 0; k < tables.whole[SLOPES]; ++k) slopes.emplace_back(with_constant.data(), slope(k) + 1);
    }

    // Begin with a member, or continue with one of those that are `kept`.
    void begin(int64_t member, bool kept) {
        const size_t known = pasts.size();
        pasts.resize(kept ? std::max<size_t>(known, member + 1) : 1);
        for (size_t k = kept ? known : 0; k < pasts.size(); ++k) {
            pasts[k].steps.assign(scheme->memory_size, std::numeric_limits<double>::quiet_NaN());
            pasts[k].of_vectors.assign(vectors, {});
        }
        past = &pasts[kept ? member : 0];
        scheme->memory = past->steps.data();
    }

    // Take a step, and store its Z.
    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        return scheme->step(x, dx, nullptr, nullptr, t, h);
    }
    void store_changes(double h, double* to) override { static_cast<Base&>(*scheme).store_changes(h, to); }

    // The number k of the steps of a run, of the member with which it began: store the states and Z of its substeps.
    template <class Run>
    void take_step(const Run& run, int64_t k, double* x, double* dx, double* to) {
        each_substep(stepping, run, k, false, [&](double t, double h, int64_t number) {
            InterruptCheck::of_this_call().after(this->work);
            double* const own = to + number * (numbers + held);
            std::copy_n(x, numbers, own);
            if (step(x, dx, nullptr, nullptr, t, h) != DONE) throw NotSolved();
            store_changes(h, own + numbers);
        });
    }
    template <class Run>
    void pull_step(const Run& run, int64_t k, const double* from, double* cotangent, double* by_coefficients) {
        each_substep(stepping, run, k, true, [&](double, double h, int64_t number) {
            InterruptCheck::of_this_call().after(this->work);
            const double* const own = from + number * (numbers + held);
            prepare(own, own + numbers, h, true);
            pull(cotangent, h, by_coefficients);
        });
    }

    struct OneStep {
        double t0, h;
        int64_t k0 = 0;
    };
    int64_t stored() const override { return stepping.substeps * (numbers + held); }
    bool take(int64_t member, double* x, double t, double h, int64_t threads, double* to) override {
        AlignedArray<double> state((numbers + 7) / 8 * 8), rest((numbers + 7) / 8 * 8);
        std::copy_n(x, numbers, state.at), std::fill_n(rest.at, numbers, 0.0);
        begin(member, true);
        SharedSteps shared_steps(threads, numbers);
        shared_steps.begin();
        try {
            take_step(OneStep{t, h}, 1, state.at, rest.at, to);
        } catch (const NotSolved&) {
            return false;
        }
        shared_steps.end();
        std::copy_n(state.at, numbers, x);
        return true;
    }
    void pull(int64_t member, const double* from, double h, int64_t threads, double* cotangent,
              double* by_coefficients) override {
        begin(member, true);
        SharedSteps shared_steps(threads, numbers);
        shared_steps.begin_as_measured();
        pull_step(OneStep{0.0, h}, 1, from, cotangent, by_coefficients);
        shared_steps.end_as_measured();
    }

    // Prepare the step from a state with these Z.
    void prepare(const double* W, const double* Z, double h, bool backward) {
        this->load_state(reinterpret_cast<const T*>(W));
        set_sum(WHOLE_STEP, Z, [](int64_t) { return 2.0; });
        for (int64_t i = 0; i < stages; ++i) {
            const int64_t V = at(i, POINT), of_state = at(i, STATE_FACTOR), own = at(i, OWN);
            set_sum(V, Z, [&](int64_t j) { return this->a[i * stages + j] / this->a[j * stages + j]; });
            multiply(V, STATE, of_state, moving, layers, true);
            multiply(V, of_state, at(i, MIDDLE), moving, layers, false);
            if (stages > 1) {
                read_skew(at(i, MIDDLE), 0.5, -1);
                stream.apply(G.data(), 0.0, image.data(), true);
                this->load_stream(INVERSE, image.data(), h * this->a[i * stages + i]);
                this->invert();
                for (int64_t l = 0; l < moving; ++l) add_unit(INVERSE, l);
            }
            const int64_t B = stages > 1 ? INVERSE : V;
            if (backward) set_adjoint(B, own, 1.0, moving), set_adjoint(V, at(i, BEHIND), 1.0, moving);
            else set_combination(own, 1.0, B, 0.0, B, moving);
            if (backward && stages > 1) {
                set_adjoint(of_state, FIRST, -1.0, layers);
                set_combination(of_state, 1.0, FIRST, 0.0, FIRST, layers);
            }
        }
    }

    // Replace a cotangent after the prepared step by that before it.
    void pull(double* cotangent, double h, double* by_coefficients) {
        load_vector(cotangent, true);
        const int64_t Q = WHOLE_STEP, G_after = VECTOR;
        if (stages == 1) {
            set_combination(FIRST, 2.0, at(0, MIDDLE), -1.0, at(0, STATE_FACTOR), layers);
            multiply(G_after, FIRST, SECOND, layers, layers, false);
        } else {
            multiply(Q, STATE, FIRST, moving, layers, false);
            multiply(G_after, FIRST, SECOND, layers, layers, false);
        }
        for (int64_t i = 0; i < stages; ++i)
            set_combination(at(i, GIVEN), -4.0 * h * this->a[i * stages + i], SECOND, 0.0, SECOND, layers);
        solve(h, true, &past->of_vectors[0]);
        for (int64_t i = 0; i < stages; ++i)
            each_slope(i, [&](int64_t coefficient, double factor) {
                by_coefficients[coefficient] += factor * paired_with_image(i);
            });
        multiply(G_after, Q, FIRST, layers, moving, true);
        multiply(FIRST, Q, SUM, layers, moving, false);
        for (int64_t i = 0; i < stages; ++i) {
            load_image(i);
            multiply(INVERSE, at(i, POINT), FIRST, moving, moving, true);
            multiply(FIRST, at(i, POINT), SECOND, moving, moving, false);
            set_combination(SUM, 1.0, SUM, 1.0, SECOND, moving);
        }
        store_vector(SUM, cotangent, true);
    }

    // Replace a tangent before the prepared step by that after it, along directions of the coefficients.
    void push(double* tangent, double h, const double* directions, int64_t number) {
        load_vector(tangent, false);
        std::fill(given.begin(), given.end(), 0.0);
        for (int64_t i = 0; i < stages; ++i) {
            multiply(at(i, POINT), VECTOR, FIRST, moving, layers, true);
            multiply(at(i, POINT), FIRST, at(i, ADDED), moving, layers, false);
            if (directions)
                each_slope(i, [&](int64_t coefficient, double factor) {
                    const double* const from = reinterpret_cast<const double*>(image.data());
                    for (int64_t e = 0; e < numbers; ++e)
                        given[i * numbers + e] += factor * directions[coefficient] * from[e];
                });
            set_combination(at(i, GIVEN), 0.0, STATE, 0.0, STATE, layers);
        }
        solve(h, false, number < vectors ? &past->of_vectors[number] : nullptr);
        set_combination(SUM, 0.0, STATE, 0.0, STATE, layers);
        for (int64_t i = 0; i < stages; ++i) {
            double factor = 2.0;
            if (stages == 1) {
                load_image(i);
                multiply(INVERSE, at(i, POINT), FIRST, moving, moving, false);
                multiply(at(i, OWN), FIRST, at(i, UNKNOWN), moving, moving, false);
                factor = 2.0 * h * this->a[0];
            }
            set_combination(SUM, 1.0, SUM, factor, at(i, UNKNOWN), moving);
        }
        multiply(WHOLE_STEP, STATE, FIRST, moving, layers, true);
        multiply(SUM, FIRST, REST, moving, layers, false);
        multiply(WHOLE_STEP, VECTOR, FIRST, moving, layers, true);
        multiply(WHOLE_STEP, FIRST, SUM, moving, layers, false);
        read_skew(REST, 1.0, SUM, false);
        for (int64_t l = 0; l < layers; ++l) project(G.data() + l * square);
        std::copy_n(reinterpret_cast<const double*>(G.data()), numbers, tangent);
    }

  private:
    static int64_t at(int64_t i, int64_t kind) { return FIRST_STAGE + i * OF_STAGE + kind; }
    const double* slope(int64_t k) const {
        return tables.coefficients + tables.whole[SLOPE_NUMBERS] + k * tables.whole[SLOPE_SIZE];
    }

    // Call use(coefficient, factor) for each stream that is a slope, with what it is at a stage in `image`.
    template <class Use>
    void each_slope(int64_t i, const Use& use) {
        if (!slopes.empty()) read_skew(at(i, MIDDLE), 0.5, -1);
        for (size_t k = 0; k < slopes.size(); ++k) {
            slopes[k].apply(G.data(), 0.0, image.data(), true);
            use(tables.whole[SLOPE_COEFFICIENTS + k], slope(k)[0]);
        }
    }

    // Project a skew-Hermitian matrix on the algebra.
    void project(T* X) const { project_on_blocks(n, tables.whole + SLOPE_COEFFICIENTS + slopes.size(), X); }

    // to := a times one matrix, plus b times another one.
    void set_combination(int64_t to, double a, int64_t one, double b, int64_t other, int64_t count) {
        for (int64_t l = 0; l < count; ++l)
            for (int p = 0; p < Planes<T>::COUNT; ++p) {
                const double *first = whole(one, l).plane[p], *second = whole(other, l).plane[p];
                double* const sum = whole(to, l).plane[p];
                share(square, [=](int64_t begin, int64_t end) {
                    for (int64_t e = begin; e < end; ++e) sum[e] = a * first[e] + b * second[e];
                });
            }
    }

    void add_unit(int64_t matrix, int64_t l) {
        const Planes<T> to = whole(matrix, l);
        for (int64_t e = 0; e < square && (l == 0 || stream.direct); e += n + 1) to.plane[0][e] += 1.0;
        add_parts(square, to);
    }

    // to := 1 + the sum of the stages' Z times factor(stage).
    template <class Factor>
    void set_sum(int64_t to, const double* Z, const Factor& factor) {
        for (int64_t l = 0; l < moving; ++l) {
            this->add_stages(whole(to, l), Z, l, factor);
            add_unit(to, l);
        }
    }

    // to := a sign times the adjoint.
    void set_adjoint(int64_t from, int64_t to, double sign, int64_t count) {
        for (int64_t l = 0; l < count; ++l) {
            const Planes<T> source = whole(from, l), target = whole(to, l);
            each_tile(n, [=](const TileRange& range) {
                Tile<T> own, other;
                load(range, source, own), load(range.opposite(), source, other);
                store(range, other.opposite(), -sign, target);
                if (!range.diagonal()) store(range.opposite(), own.opposite(), -sign, target);
            });
        }
    }

    // G := a factor times X - X*, plus the skew-Hermitian matrix `added`, if there is one.
    void read_skew(int64_t X, double factor, int64_t added, bool for_stream = true) {
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<T> from = whole(X, l), more = whole(added < 0 ? X : added, l);
            each_tile(n, [=, this](const TileRange& range) {
                Tile<T> own, other, sum;
                load(range, from, own), load(range.opposite(), from, other), load(range, more, sum);
                other = other.opposite();
                own.set([&](int p, int i) {
                    const auto skew = factor * (own.row[p][i] + other.row[p][i]);
                    return added < 0 ? skew : skew + sum.row[p][i];
                });
                if (range.diagonal()) own.mirror();
                T* const to = G.data() + l * square;
                if (for_stream) return this->store_for_stream(range, own, to);
                store(range, own, to);
                if (!range.diagonal()) store(range.opposite(), own.opposite(), to);
            });
        }
    }

    void load_image(int64_t i) {
        this->load_stream(INVERSE, reinterpret_cast<const T*>(images.data() + i * numbers), 1.0);
    }

    // The largest number on and above the diagonals of matrices, and of the product that `move` computed last.
    double largest_above(const double* X) const {
        double most = 0.0;
        for (int64_t row = 0; row < layers * n; ++row) {
            const double* const from = X + PARTS * (row * n + row % n);
            keep_larger(most, largest_of(PARTS * (n - row % n), [=](int64_t k) { return from[k]; }));
        }
        return most;
    }
    double largest_product() {
        double most = 0.0;
        for (int64_t l = 0; l < layers; ++l)
            for (int64_t p = 0; p < PARTS; ++p) {
                const double* const Y = whole(stages == 1 ? SECOND : FIRST, l).plane[p];
                keep_larger(most, shared_largest(square, [=](int64_t e) { return Y[e]; }));
            }
        return most;
    }

    // The pairing of what the stream of a stage read last with `image`, of which entries below the diagonal may be left
    // out.
    double paired_with_image(int64_t i) const {
        double total = 0.0;
        for (int64_t l = 0; l < layers; ++l) {
            const int64_t opposite = stream.direct || layers == 1 ? l : 1 - l;
            const double* const p = points.data() + i * numbers + PARTS * opposite * square;
            const double* const x = reinterpret_cast<const double*>(image.data()) + PARTS * l * square;
            double sum = 0.0;
            for (int64_t r = 0; r < n; ++r)
                for (int64_t k = PARTS * r * (n + 1); k < PARTS * (r + 1) * n; ++k)
                    sum += (k < PARTS * (r * (n + 1) + 1) ? 1.0 : 2.0) * p[k] * x[k];
            total += stream.weight(l) * sum;
        }
        return total;
    }

    // A layer of a vector for that of a cotangent, and its factor, in the pairing of the layers.
    int64_t paired_layer(int64_t l, bool backward) const { return backward && layers == 2 && !stream.direct ? 1 - l : l; }

    void load_vector(const double* from, bool backward) {
        for (int64_t l = 0; l < layers; ++l) {
            const T* const layer = reinterpret_cast<const T*>(from) + paired_layer(l, backward) * square;
            skew_part(n, layer, 0.5 / (backward ? stream.weight(l) : 1.0), row.data(), false);
            project(row.data());
            const Planes<T> to = whole(VECTOR, l);
            for (int64_t e = 0; e < square; ++e) to.set(e, row[e]);
        }
    }

    void store_vector(int64_t matrix, double* to, bool backward) {
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<T> from = whole(matrix, l);
            T* const layer = reinterpret_cast<T*>(to) + paired_layer(l, backward) * square;
            for (int64_t e = 0; e < square; ++e) row[e] = from.at(e);
            skew_part(n, row.data(), 0.5 * (backward ? stream.weight(l) : 1.0), layer, false);
            project(layer);
        }
    }

    // Solve the linear equations of the stages, from a prediction.
    void solve(double h, bool backward, History* history) {
        const int64_t size_of_all = stages * numbers;
        const auto earlier = [&](int64_t j) -> const double* {
            return history->rows.data() + (history->count - 1 - j) % HISTORY * size_of_all;
        };
        std::fill(images.begin(), images.end(), 0.0);
        if (history && history->count > 0) {
            double factor[HISTORY];
            const int64_t known = std::min(history->count, HISTORY);
            add_rows(size_of_all, fit_rows(size_of_all, known, earlier, factor), earlier, factor, images.data());
        }
        for (int64_t i = 0; i < stages; ++i)
            set_combination(at(i, UNKNOWN), 0.0, at(i, GIVEN), 0.0, at(i, GIVEN), layers);
        this->iterations = 0;
        for (double before = 0.0;;) {
            double change = 0.0, size = 0.0;
            for (int64_t i = 0; i < stages; ++i) {
                move(i, h, backward);
                stream.apply_linear(G.data(), image.data(), true);
                std::copy_n(reinterpret_cast<const double*>(G.data()), backward ? numbers : 0, points.data() + i * numbers);
                const double* const next = reinterpret_cast<const double*>(image.data());
                double *const own = images.data() + i * numbers, *const more = given.data() + i * numbers;
                keep_larger(change, largest_of(numbers, [=](int64_t k) {
                                const double value = backward ? next[k] : next[k] + more[k], moved = value - own[k];
                                own[k] = value;
                                return moved;
                            }));
                keep_larger(size, largest_of(numbers, [=](int64_t k) { return own[k]; }));
                // Where Y - Y* cancels, its rounding is relative to Y.
                const double left = largest_above(reinterpret_cast<const double*>(G.data()));
                if (left > 0.0) size = std::max(size, largest_product() / left * largest_above(next));
            }
            const double shrunk = this->iterations > 0 ? std::min(GROWN * change / before, 1.0) : 1.0;
            if (this->ended(change, size) || change * shrunk <= LAST_DIGIT * size) break;
            before = change;
        }
        if (this->status != DONE) throw NotSolved();
        if (!history) return;
        history->rows.resize(HISTORY * size_of_all);
        std::copy_n(images.data(), size_of_all, history->rows.data() + history->count++ % HISTORY * size_of_all);
    }

    // G := what the stream of a stage reads, for the unknowns so far.
    void move(int64_t i, double h, bool backward) {
        const bool one = stages == 1;
        const double factor = (backward ? -2.0 : 1.0) * h * this->a[i * stages + i];
        const int64_t behind = one ? at(i, MIDDLE) : at(i, backward ? STATE_FACTOR : POINT);
        const int64_t deep = backward || one ? layers : moving;
        load_image(i);
        multiply(INVERSE, behind, FIRST, moving, deep, false);
        set_combination(REST, 1.0, at(i, GIVEN), 0.0, at(i, GIVEN), deep);
        for (int64_t j = 0; j < stages; ++j) {
            const double share = this->a[(backward ? j : i) * stages + (backward ? i : j)] / this->a[j * stages + j];
            if (j != i) set_combination(REST, 1.0, REST, share, at(j, UNKNOWN), deep);
        }
        set_combination(FIRST, factor, FIRST, 1.0, REST, deep);
        multiply(at(i, OWN), FIRST, SECOND, moving, deep, false);
        if (!one) {
            set_combination(at(i, UNKNOWN), 1.0, SECOND, -1.0, REST, deep);
            multiply(SECOND, at(i, backward ? BEHIND : STATE_FACTOR), FIRST, deep, backward ? moving : layers, false);
        }
        read_skew(one ? SECOND : FIRST, backward ? 0.5 : 1.0, backward ? -1 : at(i, ADDED));
    }
};

template <class T>
int64_t carry_of(const Stepping& tables, const ForwardRun& run, int64_t first, int64_t last,
                 InterruptCheck& interrupts, std::unique_ptr<Kept>* kept) {
    std::unique_ptr<Kept> own;
    std::unique_ptr<Kept>& found = kept ? *kept : own;
    if (!found) found.reset(new StepDerivative<T>(tables, run.carried));
    StepDerivative<T>& one = static_cast<StepDerivative<T>&>(*found);
    const int64_t n = run.size, count = one.coefficients;
    AlignedArray<double> x((n + 7) / 8 * 8), dx((n + 7) / 8 * 8);
    std::vector<double> before(n), changes(one.held);
    for (int64_t member = first; member < last; ++member) {
        const double* const directions = run.coefficients + (run.apart ? member * run.carried * count : 0);
        double* const vectors = run.tangents + member * run.carried * n;
        std::copy_n(run.momenta + member * n, n, x.at), std::copy_n(run.errors + member * n, n, dx.at);
        one.begin(member, kept != nullptr);
        int64_t mark = 0;
        SharedSteps shared_steps(run.threads, n);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            shared_steps.begin();
            each_substep(tables, run, k, false, [&](double t, double h, int64_t) {
                interrupts.after(one.work);
                std::copy_n(x.at, n, before.data());
                if (one.step(x.at, dx.at, nullptr, nullptr, t, h) != DONE) throw NotSolved();
                one.store_changes(h, changes.data());
                one.prepare(before.data(), changes.data(), h, false);
                for (int64_t v = 0; v < run.carried; ++v)
                    one.push(vectors + v * n, h, count ? directions + v * count : nullptr, v);
            });
            shared_steps.end();
            if (mark == run.marked || run.marks[mark] != k) continue;
            std::copy_n(vectors, run.carried * n, run.at_points + (mark++ * run.members + member) * run.carried * n);
        }
    }
    return 0;
}

template <class T>
int64_t carry_of(const Stepping& tables, const BackwardRun& run, int64_t first, int64_t last, InterruptCheck&,
                 std::unique_ptr<Kept>* kept) {
    std::unique_ptr<Kept> own;
    std::unique_ptr<Kept>& found = kept ? *kept : own;
    if (!found) found.reset(new StepDerivative<T>(tables, 1));
    StepDerivative<T>& one = static_cast<StepDerivative<T>&>(*found);
    const int64_t n = run.size, count = one.coefficients;
    AlignedArray<double> x((n + 7) / 8 * 8), dx((n + 7) / 8 * 8);
    std::vector<double> steps((run.k1 - run.k0) * one.stored());
    for (int64_t member = first; member < last; ++member) {
        std::copy_n(run.momenta + member * n, n, x.at), std::copy_n(run.errors + member * n, n, dx.at);
        one.begin(member, kept != nullptr);
        SharedSteps shared_steps(run.threads, n);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            shared_steps.begin();
            one.take_step(run, k, x.at, dx.at, steps.data());
            shared_steps.end();
        }
        double* const cotangent = run.cotangents + member * n;
        int64_t mark = run.marked;
        for (int64_t k = run.k1; k > run.k0; --k) {
            shared_steps.begin_as_measured();
            if (mark > 0 && run.marks[mark - 1] == k) {
                const double* const saved = run.at_points + (--mark * run.members + member) * n;
                for (int64_t i = 0; i < n; ++i) cotangent[i] += saved[i];
            }
            one.pull_step(run, k, steps.data(), cotangent, run.coefficients + member * count);
            shared_steps.end_as_measured();
        }
    }
    return 0;
}

template <class Run>
int64_t carry(const Stepping& tables, const Run& run, int64_t first, int64_t last, InterruptCheck& interrupts,
              std::unique_ptr<Kept>* kept) {
    return outcome_of([&]() -> int64_t {
        try {
            return tables.tables.whole[COMPLEX] ? carry_of<Complex>(tables, run, first, last, interrupts, kept)
                                                : carry_of<double>(tables, run, first, last, interrupts, kept);
        } catch (const NotSolved&) {
            return UNSOLVED;
        }
    });
}

}  // namespace

EXPORT_DERIVATIVES(isospectral_directions, Stepping, ForwardRun, carry<ForwardRun>)
EXPORT_DERIVATIVES(isospectral_cotangents, Stepping, BackwardRun, carry<BackwardRun>)

}  // namespace coadjoint
