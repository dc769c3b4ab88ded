// The loops over steps of Runge-Kutta methods with tangent vectors that are saved, and backward, for Python.
#include "tangents/members.hpp"
#include "tangents/stage_derivatives.hpp"

namespace coadjoint {

// A member with the slopes of its steps.
struct SteppedMember {
    const RungeKuttaTables& tables;
    const int64_t n, square, size;  // numbers of the slopes of a substep
    std::unique_ptr<Single> one;

    explicit SteppedMember(const RungeKuttaTables& tables)
        : tables(tables), n(tables.field.size), square(tables.group.size * tables.group.size),
          size(tables.stages * (n + square)), one(single_of(tables, SharedConstants{})),
          memory(slope_memory_size(tables)) {}

    template <class Run>
    void begin(const Run& run, int64_t member) {
        std::copy_n(run.momenta + member * n, n, one->x);
        std::copy_n(run.errors + member * n, n, one->dx);
        if (square > 0) std::copy_n(run.groups + member * square, square, one->g);
        std::fill_n(one->dg, square, 0.0);
        one->newton = 0.0;
        std::fill(memory.begin(), memory.end(), 0.0);
        one->read_slopes(memory.data());
    }

    // Take a substep, after `store` with the slopes.
    template <class Store>
    void substep(double t, double h, int64_t part, Store store) {
        if (!one->solve(t, h, part)) throw NotSolved();
        one->write_slopes(memory.data());
        store(memory.data() + tables.substeps);
        one->add();
    }

  private:
    std::vector<double> memory;
};

static int64_t work_of_step(const RungeKuttaTables& tables) {
    const int64_t d = tables.group.size;
    return tables.substeps * tables.stages * 8 * (work_of(tables.field) + d * tables.group.entries);
}

static void forward_members(const RungeKuttaCotangents& all, const ForwardRun& run, int64_t first, int64_t last,
                            InterruptCheck& interrupts) {
    typedef Lanes<8> V;
    constexpr int64_t lanes = Numbers<V>::lanes;
    const RungeKuttaTables& tables = all.base;
    const int64_t n = run.size, square = run.square, rows = (run.carried + lanes - 1) / lanes;
    const int64_t count = CoefficientCotangents<double>::count(all.added);
    SteppedMember stepped(tables);
    StagePoints points(all);
    StageTangents<V> tangents(points, rows);
    AlignedArray<V> vectors(n * rows), of_group(square * rows), directions(count * rows);
    const int64_t work = (2 + 4 * rows) * work_of_step(tables);
    for (int64_t member = first; member < last; ++member) {
        const MembersOfRun<false> one{member, 1};
        const auto each = [&](V* to, int64_t length, auto&& visit) { one.each_component(to, length, run.carried, visit); };
        const bool directed = one.read_directions(directions.at, count, run);
        each(vectors.at, n, read_entries(run.tangents));
        if (square > 0) each(of_group.at, square, read_entries(run.group_tangents));
        stepped.begin(run, member);
        tangents.restart();
        int64_t mark = 0;
        SharedSteps shared_steps(run.threads, n);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            interrupts.after(work);
            shared_steps.begin();
            const double start = run.t0 + double(k - 1) * run.h;
            for (int64_t part = 0; part < tables.substeps; ++part) {
                const double t = start + tables.moment[part] * run.h, h = tables.fraction[part] * run.h;
                stepped.substep(t, h, part, [&](const double* slopes) {
                    points.begin(stepped.one->x, stepped.one->g, t, h, slopes);
                    tangents.move(vectors.at, square > 0 ? of_group.at : nullptr, directed ? directions.at : nullptr);
                });
            }
            shared_steps.end();
            if (mark == run.marked || run.marks[mark] != k) continue;
            const int64_t saved = mark++ * run.members * run.carried;
            each(vectors.at, n, write_entries(run.at_points + saved * n));
            if (square > 0) each(of_group.at, square, write_entries(run.at_groups + saved * square));
        }
        each(vectors.at, n, write_entries(run.tangents));
        if (square > 0) each(of_group.at, square, write_entries(run.group_tangents));
    }
}

static void backward_members(const RungeKuttaCotangents& all, const BackwardRun& run, int64_t first, int64_t last,
                             InterruptCheck& interrupts) {
    const RungeKuttaTables& tables = all.base;
    const int64_t n = run.size, square = run.square, substeps = tables.substeps, steps = run.k1 - run.k0;
    const int64_t count = CoefficientCotangents<double>::count(all.added);
    SteppedMember stepped(tables);
    StagePoints points(all);
    StageCotangents backward(points);
    // The states before the substeps, and their slopes.
    std::vector<double> states(steps * substeps * (n + square)), slopes(steps * substeps * stepped.size);
    std::vector<double> cotangents(n), of_group(square);
    const int64_t work = work_of_step(tables);
    const auto substep_at = [&](int64_t k, int64_t part, auto&& visit) {
        const int64_t position = (k - run.k0 - 1) * substeps + part;
        visit(run.t0 + double(k - 1) * run.h + tables.moment[part] * run.h, tables.fraction[part] * run.h,
              states.data() + position * (n + square), slopes.data() + position * stepped.size);
    };
    for (int64_t member = first; member < last; ++member) {
        std::copy_n(run.cotangents + member * n, n, cotangents.data());
        if (square > 0) std::copy_n(run.group_cotangents + member * square, square, of_group.data());
        const CoefficientCotangents<double> coefficients(all.added, run.coefficients + member * count);
        stepped.begin(run, member);
        backward.restart();
        SharedSteps shared_steps(run.threads, n);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            interrupts.after(work);
            shared_steps.begin();
            for (int64_t part = 0; part < substeps; ++part)
                substep_at(k, part, [&](double t, double h, double* state, double* found) {
                    stepped.substep(t, h, part, [&](const double* from) {
                        std::copy_n(stepped.one->x, n, state);
                        std::copy_n(stepped.one->g, square, state + n);
                        std::copy_n(from, stepped.size, found);
                    });
                });
            shared_steps.end();
        }
        int64_t mark = run.marked;
        for (int64_t k = run.k1; k > run.k0; --k) {
            interrupts.after(4 * work);
            shared_steps.begin_as_measured();
            if (mark > 0 && run.marks[mark - 1] == k) {
                const int64_t saved = --mark * run.members + member;
                for (int64_t i = 0; i < n; ++i) cotangents[i] += run.at_points[saved * n + i];
                for (int64_t e = 0; e < square; ++e) of_group[e] += run.at_groups[saved * square + e];
            }
            for (int64_t part = substeps; part-- > 0;)
                substep_at(k, part, [&](double t, double h, const double* state, const double* found) {
                    points.begin(state, state + n, t, h, found);
                    backward.move(cotangents.data(), square > 0 ? of_group.data() : nullptr, coefficients);
                });
            shared_steps.end_as_measured();
        }
        backward.finish(run.coefficients + member * count);
        std::copy_n(cotangents.data(), n, run.cotangents + member * n);
        if (square > 0) std::copy_n(of_group.data(), square, run.group_cotangents + member * square);
    }
}

template <class Move>
static int64_t outcome_of_derivatives(Move move) {
    return outcome_of([&]() -> int64_t {
        try {
            return move(), 0;
        } catch (const NotSolved&) {
            return UNSOLVED;
        }
    });
}

static int64_t carry_forward(const RungeKuttaCotangents& tables, const ForwardRun& run, int64_t first, int64_t last,
                             InterruptCheck& interrupts) {
    return outcome_of_derivatives([&] { forward_members(tables, run, first, last, interrupts); });
}

static int64_t carry_backward(const RungeKuttaCotangents& tables, const BackwardRun& run, int64_t first, int64_t last,
                              InterruptCheck& interrupts) {
    return outcome_of_derivatives([&] { backward_members(tables, run, first, last, interrupts); });
}

EXPORT_DERIVATIVES(runge_kutta_directions, RungeKuttaCotangents, ForwardRun, carry_forward)
EXPORT_DERIVATIVES(runge_kutta_cotangents, RungeKuttaCotangents, BackwardRun, carry_backward)

}  // namespace coadjoint
