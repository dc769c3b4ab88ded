// Commutator-free Lie group methods: states and group elements moved by exponentials of combinations of gradients.
#include "matrices/compiled_transforms.hpp"
#include "matrices/isospectral.hpp"
#include "steps/exponential.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

// A momentum of a Lie algebra with structure constants, and its group element.
struct VectorOrbit {
    const StepTables& tables;
    const MemberConstants constants;
    const Field& field;
    const int64_t n, square;
    FieldWorkspace<double> workspace;
    std::vector<double> sums;
    ExponentialAction exponential;

    VectorOrbit(const StepTables& tables, const MemberConstants& constants, const double*)
        : tables(tables), constants(constants), field(tables.field), n(field.size),
          square(tables.group.size * tables.group.size), workspace(field), sums(std::max(n, tables.group.size)),
          exponential(std::max(n, square)) {}

    static int64_t stages(const StepTables& tables) { return tables.whole[0]; }

    int64_t work(int64_t stages, int64_t ends) const {
        return 16 * ((2 * stages + ends) * work_of(field) + ends * tables.group.size * tables.group.entries);
    }

    bool gradient_at(const double* point, double t, double* to) {
        gradient(field, constants, point, t, to, workspace);
        return true;
    }

    bool move_state(const double* k, const double* y) {
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                sum = fma(absolute(constants.number_at<double>(field.constant, q)), absolute(k[field.column[q]]), sum);
            sums[i] = sum;
        }
        if (!exponential.measure(sums.data(), n, work_of(field))) return false;
        exponential.act(y, n, [&](const double* from, double factor, double* to) {
            product(field, constants, from, k, factor, to, workspace);
        });
        return true;
    }

    // The stored group element is transposed, so that columns of rho are summed.
    bool move_group(const double* k, const double* g) {
        const GroupField& group = tables.group;
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t q = 0; q < group.entries; ++q)
            sums[group.column[q]] = fma(absolute(constants.number_at<double>(group.value, q)),
                                        absolute(k[group.element[q]]), sums[group.column[q]]);
        if (!exponential.measure(sums.data(), group.size, group.size * group.entries)) return false;
        const auto multiply = [&](const double* from, double factor, double* to) {
            group_slope(group, constants, k, from, factor, to);
        };
        exponential.act(g, square, multiply, group.size);
        return true;
    }
};

// A matrix W that moves by [P, W], with P in the role of the gradient. One or two layers, as in `Products`.
template <class T>
struct MatrixOrbit {
    const int64_t size, all, n, square = 0;
    const bool skew;
    const Products<T> products;
    Stream<T> stream;
    std::vector<T> left, right;
    std::vector<double> sums;
    ExponentialAction exponential;

    MatrixOrbit(const StepTables& tables, const MemberConstants&, const double* numbers)
        : size(tables.whole[0]), all(tables.whole[1] * size * size), n(all * int64_t(sizeof(T) / sizeof(double))),
          skew(!tables.whole[GENERAL]), products(tables.whole[GEMM], size, tables.whole[1]),
          stream(tables.whole, numbers), left(all), right(skew ? 0 : all), sums(2 * size), exponential(n) {}

    static int64_t stages(const StepTables& tables) { return tables.whole[STAGES]; }

    int64_t work(int64_t stages, int64_t) const { return stages * stream.work(); }

    bool gradient_at(const double* point, double t, double* to) {
        return stream.apply(reinterpret_cast<const T*>(point), t, reinterpret_cast<T*>(to));
    }

    // An entry of [P, W] is at most the sum of a row of P and of a column of P, times the largest entry of W.
    bool move_state(const double* k, const double* y) {
        const T* P = reinterpret_cast<const T*>(k);
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t e = 0; e < all; ++e) {
            const double entry = magnitude(P[e]);
            sums[e / size % size] += entry;
            sums[size + e % size] += entry;
        }
        double most = 0.0;
        for (int64_t j = 0; j < size; ++j) most = sums[size + j] > most ? sums[size + j] : most;
        for (int64_t i = 0; i < size; ++i) sums[i] += most;
        if (!exponential.measure(sums.data(), size, n * size)) return false;
        exponential.act(y, n, [&](const double* from, double factor, double* to) {
            commutator(P, reinterpret_cast<const T*>(from), factor, reinterpret_cast<T*>(to));
        });
        return true;
    }

    bool move_group(const double*, const double*) { return false; }

    void commutator(const T* P, const T* W, double factor, T* to) {
        products.multiply(P, W, left.data());
        if (skew) {
            for (int64_t first = 0; first < all; first += size * size)
                skew_part(size, left.data() + first, factor, to + first, false);
            return;
        }
        products.multiply(W, P, right.data());
        for (int64_t e = 0; e < all; ++e) to[e] = factor * (left[e] - right[e]);
    }
};

// `coefficients`: the number of exponentials at the end, the nodes of the stages, and for every stage but the first,
// then for every exponential at the end, the stage it starts from and the combination of gradients. They are followed
// by the coefficients that the orbit reads.
template <class Orbit>
struct CommutatorFree final : StepScheme {
    const int64_t stages, ends;
    const double *node, *rows;
    Orbit orbit;
    const int64_t n, square;
    std::vector<double> points, gradients, k;

    CommutatorFree(const StepTables& tables, const MemberConstants& constants)
        : stages(Orbit::stages(tables)), ends(int64_t(tables.coefficients[0])), node(tables.coefficients + 1),
          rows(node + stages), orbit(tables, constants, rows + (stages - 1 + ends) * (stages + 1)), n(orbit.n),
          square(orbit.square), points(stages * n), gradients(stages * n), k(n) {
        work = orbit.work(stages, ends);
    }

    const double* row_of(int64_t exponential) const { return rows + exponential * (stages + 1); }

    // Set k to h times a combination of the gradients.
    void combine(int64_t exponential, double h) {
        const double* weight = row_of(exponential) + 1;
        for (int64_t c = 0; c < n; ++c) {
            double sum = 0.0;
            for (int64_t j = 0; j < stages; ++j)
                if (weight[j] != 0.0) sum = fma(weight[j], gradients[j * n + c], sum);
            k[c] = h * sum;
        }
    }

    void add(double* x, double* dx, int64_t size) {
        for (int64_t i = 0; i < size; ++i) {
            const double old = x[i];
            two_sum(old, dx[i] + orbit.exponential.move[i], x[i], dx[i]);
        }
    }

    int64_t step(double* x, double* dx, double* g, double* dg, double t, double h) override {
        evaluations = stages;
        residual = std::numeric_limits<double>::quiet_NaN();
        std::copy_n(x, n, points.data());
        for (int64_t i = 0; i < stages; ++i) {
            double* point = points.data() + i * n;
            if (i > 0) {
                const double* from = points.data() + int64_t(row_of(i - 1)[0]) * n;
                combine(i - 1, h);
                if (!orbit.move_state(k.data(), from)) return failed();
                for (int64_t c = 0; c < n; ++c) point[c] = from[c] + orbit.exponential.move[c];
            }
            if (!orbit.gradient_at(point, fma(node[i], h, t), gradients.data() + i * n)) return OVERFLOWED;
        }
        for (int64_t e = 0; e < ends; ++e) {
            combine(stages - 1 + e, h);
            if (!orbit.move_state(k.data(), x)) return failed();
            add(x, dx, n);
            if (!square) continue;
            if (!orbit.move_group(k.data(), g)) return failed();
            add(g, dg, square);
        }
        return DONE;
    }

    int64_t failed() const { return finite(n, k.data()) ? UNDEFINED : OVERFLOWED; }
};

}  // namespace

STEP_SCHEME(commutator_free, CommutatorFree<VectorOrbit>)

EXPORT StepScheme* commutator_free_matrices_step(const StepTables& tables, const MemberConstants& constants) {
    if (tables.whole[COMPLEX]) return new CommutatorFree<MatrixOrbit<Complex>>(tables, constants);
    return new CommutatorFree<MatrixOrbit<double>>(tables, constants);
}

}  // namespace coadjoint
