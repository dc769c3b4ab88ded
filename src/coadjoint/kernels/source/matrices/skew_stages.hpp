// Isospectral Gauss methods with several stages, of skew-Hermitian matrices.
//
// With X_i = h a_ii P_i and Z_i = h a_ii P_i V_i, the stages are V_i = 1 + sum_j (a_ij / a_jj) Z_j, P_i = stream(V_i W V_i*)
// and Z_i = ((1 - X_i)^-1 - 1) R_i, R_i = V_i - Z_i: a stage is solved exactly for its own Z_i, with the newest Z_j of the
// others (block Gauss-Seidel, by which errors shrink as h^2 |P|^2 a_ij a_ji and as the change of P by one of M). Since b_i
// = 2 a_ii, the step is conjugation by 1 + 2 sum_i Z_i. Z is predicted from earlier steps.
#pragma once

#include "matrices/prediction.hpp"
#include "matrices/skew_step.hpp"

namespace coadjoint {

template <class T>
struct SkewStages final : SkewStep<T> {
    typedef SkewStep<T> Base;
    using Base::n, Base::square, Base::stages, Base::stream, Base::PARTS, Base::LAST_DIGIT, Base::GROWN, Base::layers;
    using Base::moving, Base::INVERSE, Base::FIRST, Base::SECOND, Base::whole, Base::G, Base::image;

    static constexpr int64_t HISTORY = 8;  // steps from which Z is predicted
    enum { POINT = Base::MATRICES, WITH_POINT };

    const int64_t block;    // numbers of a layer of Z_i: the planes of its parts
    std::vector<double> Z;  // layer by layer of each stage
    std::vector<double> weight, changes, sizes;  // of layers of Z; changes are compared by weights

    explicit SkewStages(const StepTables& tables)
        : Base(tables, WITH_POINT), block(PARTS * square), Z(stages * moving * block), weight(moving),
          changes(moving), sizes(moving) {
        this->memory_size = 3 + HISTORY * Z.size();
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const T* W = reinterpret_cast<const T*>(x);  // dx is below its last digit
        this->evaluations = 0;
        if (!predict(W, t, h)) return UNDEFINED;
        this->load_state(W);
        this->iterations = 0;
        for (double before = 0.0;;) {
            double change = 0.0, size = 0.0;
            for (int64_t i = 0; i < stages; ++i)
                if (!solve(i, t, h, change, size)) return UNDEFINED;
            this->residual = change;
            const double shrunk = this->iterations > 0 ? std::min(GROWN * change / before, 1.0) : 1.0;
            if (this->ended(change, 1.0) || change * shrunk <= LAST_DIGIT * size) break;
            before = change;
        }
        this->evaluations += this->iterations * stages;
        if (this->status != DONE) return this->status;
        store_history(h);
        set_sum(INVERSE, [](int64_t) { return 1.0; });
        this->multiply_state(INVERSE);
        for (int64_t l = 0; l < layers; ++l)
            each_tile(n, [=, this](const TileRange& range) {
                Tile<T> move = this->load_change(range, l);
                this->add_both(range, move, x + PARTS * l * square, dx + PARTS * l * square);
            });
        return DONE;
    }

    void store_changes(double, double* to) override { std::copy(Z.begin(), Z.end(), to); }

  private:
    double* numbers_of(int64_t i, int64_t l) { return Z.data() + (i * moving + l) * block; }

    // matrix := the sum of the stages' Z times factor(stage).
    template <class Factor>
    void set_sum(int64_t matrix, const Factor& factor) {
        for (int64_t l = 0; l < moving; ++l) this->add_stages(whole(matrix, l), Z.data(), l, factor);
    }

    // Replace Z_i by that of the stream at the stage; add to the largest change, and to the largest number of Z. Layers
    // are compared in units of their first Z.
    bool solve(int64_t i, double t, double h, double& change, double& size) {
        set_sum(POINT, [&](int64_t j) { return this->a[i * stages + j] / this->a[j * stages + j]; });
        for (int64_t l = 0; l < moving; ++l) {
            const Planes<T> V = whole(POINT, l);
            for (int64_t e = 0; e < square && (l == 0 || stream.direct); e += n + 1) V.plane[0][e] += 1.0;
            add_parts(square, V);
        }
        this->multiply_state(POINT);
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<T> product = whole(SECOND, l);
            each_tile(n, [=, this](const TileRange& range) {
                Tile<T> M, below;
                this->load_both(range, product, M, below);
                this->store_for_stream(range, M, G.data() + l * square);
            });
        }
        if (!stream.apply(G.data(), t + this->c[i] * h, image.data(), true)) return false;
        this->load_stream(INVERSE, image.data(), h * this->a[i * stages + i]);
        this->invert();
        for (int64_t l = 0; l < moving; ++l) {
            const Planes<T> R = whole(POINT, l);
            for (int64_t p = 0; p < PARTS; ++p) {
                const double* own = numbers_of(i, l) + p * square;
                for (int64_t e = 0; e < square; ++e) R.plane[p][e] -= own[e];
            }
            add_parts(square, R);
        }
        this->multiply(INVERSE, POINT, FIRST, moving, moving, false);
        std::fill(changes.begin(), changes.end(), 0.0), std::fill(sizes.begin(), sizes.end(), 0.0);
        for (int64_t l = 0; l < moving; ++l)
            for (int64_t p = 0; p < PARTS; ++p) {
                double* const own = numbers_of(i, l) + p * square;
                const double* const next = whole(FIRST, l).plane[p];
                // A NaN is never replaced.
                const double found = largest_of(square, [=](int64_t e) {
                    const double moved = next[e] - own[e];
                    own[e] = next[e];
                    return moved;
                });
                if (!(found <= changes[l])) changes[l] = changes[l] - changes[l] == 0.0 ? found : changes[l];
                sizes[l] = std::max(sizes[l], largest_of(square, [=](int64_t e) { return next[e]; }));
            }
        for (int64_t l = 0; l < moving; ++l) {
            if (this->iterations == 0 && i == 0)
                weight[l] = l > 0 && !stream.direct && sizes[0] > 0.0 && sizes[l] > 0.0 ? sizes[0] / sizes[l] : 1.0;
            const double found = weight[l] * changes[l];
            if (!(found <= change)) change = change - change == 0.0 ? found : change;
            size = std::max(size, weight[l] * sizes[l]);
        }
        return true;
    }

    // memory: the number of steps that it knows, their length, the row that was written last, and a ring of rows, Z of
    // earlier steps.
    double* past(int64_t steps) const {
        return this->memory + 3 + (int64_t(this->memory[2]) + steps) % HISTORY * Z.size();
    }

    // Predict Z, each layer of each stage by the combination that fits that of the last step to those before it; without
    // earlier steps from the stream at the start. Return whether that is defined.
    bool predict(const T* W, double t, double h) {
        if (!this->known_steps(h)) {
            if (!stream.apply(W, t, image.data(), true)) return false;
            ++this->evaluations;
            this->load_stream(INVERSE, image.data(), h);
            for (int64_t k = 0; k < stages * moving * PARTS; ++k) {
                const int64_t p = k % PARTS, l = k / PARTS % moving, i = k / PARTS / moving;
                const double *from = whole(INVERSE, l).plane[p], share = this->a[i * stages + i];
                double* const to = Z.data() + k * square;
                for (int64_t e = 0; e < square; ++e) to[e] = share * from[e];
            }
            return true;
        }
        std::fill(Z.begin(), Z.end(), 0.0);
        for (int64_t first = 0; first < int64_t(Z.size()); first += block) {
            double factor[HISTORY];
            const auto row = [=, this](int64_t j) -> const double* { return past(j) + first; };
            add_rows(block, fit_rows(block, int64_t(this->memory[0]), row, factor), row, factor, Z.data() + first);
        }
        return true;
    }

    void store_history(double h) {
        double* const memory = this->memory;
        if (!memory) return;
        if (!this->known_steps(h)) memory[0] = 0.0, memory[1] = h, memory[2] = 0.0;
        memory[2] = double((int64_t(memory[2]) + HISTORY - 1) % HISTORY);
        std::copy(Z.begin(), Z.end(), past(0));
        memory[0] = std::min(memory[0] + 1.0, double(HISTORY));
    }
};

}  // namespace coadjoint
