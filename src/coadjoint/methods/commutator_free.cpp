// Commutator-free Lie group methods: states and group elements moved by exponentials of combinations of gradients.
#include "steps/exponential.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

struct CommutatorFree final : StepScheme {
    const StepTables& tables;
    const Own constants;
    const Field& field;
    const int64_t n, square, stages, ends;
    const int64_t* start;             // of each stage but the first
    const double *node, *combination;  // of each stage but the first, then of the exponentials at the end
    FieldRoom<double> room;
    std::vector<double> points, gradients, k, sums;
    ExponentialAction exponential;

    CommutatorFree(const StepTables& tables, const Own& constants)
        : tables(tables), constants(constants), field(tables.field), n(field.size),
          square(tables.group.size * tables.group.size), stages(tables.whole[0]), ends(tables.whole[1]),
          start(tables.whole + 2), node(tables.coefficients), combination(node + stages), room(field),
          points(stages * n), gradients(stages * n), k(n), sums(std::max(n, tables.group.size)),
          exponential(std::max(n, square)) {
        work = 16 * ((2 * stages + ends) * work_of(field) + ends * tables.group.size * tables.group.entries);
    }

    // Set k to h times combination `row` of the gradients.
    void combine(int64_t row, double h) {
        const double* weight = combination + row * stages;
        for (int64_t c = 0; c < n; ++c) {
            double sum = 0.0;
            for (int64_t j = 0; j < stages; ++j)
                if (weight[j] != 0.0) sum = fma(weight[j], gradients[j * n + c], sum);
            k[c] = h * sum;
        }
    }

    bool move_state(const double* y) {
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                sum = fma(absolute(constants.number_at<double>(field.constant, q)), absolute(k[field.column[q]]), sum);
            sums[i] = sum;
        }
        if (!exponential.measure(sums.data(), n, work)) return false;
        exponential.act(y, n, [&](const double* from, double factor, double* to) {
            product(field, constants, from, k.data(), factor, to, room);
        });
        return true;
    }

    // The stored group element is transposed, so that columns of rho are what is summed.
    bool move_group(double* g, double* dg) {
        const GroupField& group = tables.group;
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t q = 0; q < group.entries; ++q)
            sums[group.column[q]] = fma(absolute(constants.number_at<double>(group.value, q)),
                                        absolute(k[group.element[q]]), sums[group.column[q]]);
        if (!exponential.measure(sums.data(), group.size, work)) return false;
        exponential.act(g, square, [&](const double* from, double factor, double* to) {
            group_slope(group, constants, k.data(), from, factor, to);
        });
        add(g, dg, square);
        return true;
    }

    void add(double* x, double* dx, int64_t size) {
        for (int64_t i = 0; i < size; ++i) {
            const double old = x[i];
            add_owing_rest(old, dx[i] + exponential.move[i], x[i], dx[i]);
        }
    }

    int64_t step(double* x, double* dx, double* g, double* dg, double t, double h) override {
        evaluations = stages;
        residual = std::numeric_limits<double>::quiet_NaN();
        std::copy_n(x, n, points.data());
        for (int64_t i = 0; i < stages; ++i) {
            double* point = points.data() + i * n;
            if (i > 0) {
                const double* from = points.data() + start[i - 1] * n;
                combine(i - 1, h);
                if (!move_state(from)) return failed();
                for (int64_t c = 0; c < n; ++c) point[c] = from[c] + exponential.move[c];
            }
            gradient(field, constants, point, fma(node[i], h, t), gradients.data() + i * n, room);
        }
        for (int64_t e = 0; e < ends; ++e) {
            combine(stages - 1 + e, h);
            if (!move_state(x)) return failed();
            add(x, dx, n);
            if (square && !move_group(g, dg)) return failed();
        }
        return DONE;
    }

    int64_t failed() const { return finite(n, k.data()) ? UNDEFINED : OVERFLOWED; }
};

}  // namespace

STEP_SCHEME(commutator_free, CommutatorFree)

}  // namespace coadjoint
