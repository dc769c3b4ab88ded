// Symmetric splitting of forces and a step of another loop: half flows, the step, half flows in reversed order; at
// fractions of the step for higher orders; with the work integrals of each force.
#include <cmath>
#include <memory>

#include "forces/force.hpp"
#include "matrices/compiled_transforms.hpp"
#include "matrices/invariants.hpp"
#include "steps/forced_layout.hpp"
#include "steps/inner_step.hpp"
#include "steps/member_batches.hpp"

namespace coadjoint {

namespace {

struct Forced final : BatchScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const ForcedLayout layout;
    const std::unique_ptr<MatrixInvariants> matrices;
    const int64_t n, tracked;
    std::vector<std::unique_ptr<InnerStep>> inner, batched;  // one for each length; of many members
    std::vector<std::unique_ptr<Force>> forces;
    std::vector<double> values, before, arguments, workspace;
    bool measured = true;  // whether all forces compute the changes of the energy themselves

    // `whole` is read by `ForcedLayout`; for a matrix its invariants replace those of the tables.
    Forced(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), layout(tables.whole),
          matrices(matrix_invariants(layout.rest, tables.coefficients)), n(tables.field.size),
          tracked(matrices ? matrices->count() : tables.restored.size),
          values(tracked), before(tracked), arguments(tables.restored.longest + 1),
          workspace(2 * tables.restored.longest + 2) {
        for (const int64_t* loop : layout.loops)
            inner.emplace_back(new InnerStep(loop, n, tables.group.size * tables.group.size));
        for (const ForceTable* force : layout.forces)
            forces.emplace_back(new Force(*force, tables.field, tables.group, constants));
        for (const auto& force : forces) measured = measured && force->measures() && force->table.work_integrals <= 1;
        // The memory of schemes of matrices consists of initial guesses, which remain useful after forces, but not for
        // substeps of other lengths.
        memory_size = matrices && layout.substeps.size() == 1 ? tables.whole[3] : 0;
        work = 16 * work_of(tables.field) +
               int64_t(layout.substeps.size() * (2 * forces.size() + 2)) *
                   (matrices ? matrices->work() : work_of_terms(tables.restored.terms, 0, tables.restored.terms.size));
    }

    int64_t step(double* x, double* dx, double* group, double*, double t, double h) override {
        for (const Substep& one : layout.substeps) {
            const bool ends[] = {&one == &layout.substeps.front(), &one == &layout.substeps.back()};
            if (const int64_t status = take(one, x, dx, group, t, h, ends)) return status;
        }
        return DONE;
    }

    // A substep of the step from t of length h, at the `ends` of which forces act that act around steps.
    int64_t take(const Substep& one, double* x, double* dx, double* group, double t, double h, const bool* ends) {
        InnerStep& inner = *this->inner[one.loop];
        if (const int64_t status = move_all(one, 0, x, dx, group, t, h, ends[0])) return status;
        const int64_t status =
            inner.take(x, group, t + one.begin * h, one.length * h, memory_size ? memory : nullptr);
        evaluations += inner.evaluations;
        iterations += inner.iterations;
        residual = inner.residual;
        if (status != DONE) return status;
        return move_all(one, 1, x, dx, group, t, h, ends[1]);
    }

    // Apply the flows of all forces before (side 0) or after (1) a substep; at an end of the step also those around it.
    int64_t move_all(const Substep& one, int64_t side, double* x, double* dx, double* group, double t, double h, bool end) {
        const double begin = t + one.begin * h, length = one.length * h, half = 0.5 * length;
        const double frozen = side ? begin + length : begin;
        bool evaluated = false;
        for (size_t k = 0; k < forces.size(); ++k) {
            Force& force = *forces[side ? forces.size() - 1 - k : k];
            const bool around = force.around_steps();
            if (around && !(end && force.acts(t, h, member, side))) continue;
            if (!evaluated && !evaluate(x, frozen)) return UNDEFINED;
            evaluated = true;
            const int64_t status = around ? move(force, x, dx, group, t, h, frozen, side)
                                          : move(force, x, dx, group, side ? begin + half : begin, half, frozen, side);
            if (status != DONE) return status;
        }
        return DONE;
    }

    bool takes_batches() const override { return !matrices && !memory_size && !tables.group.size; }

    void step_batch(BatchMember* members, int64_t count, double t, double h) override {
        if (batched.empty())
            for (const int64_t* loop : layout.loops) batched.emplace_back(new InnerStep(loop, n, 0, MOST_MEMBERS));
        for (int64_t b = 0; b < count; ++b) members[b].evaluations = members[b].iterations = 0;
        const auto move_members = [&](const Substep& one, int64_t side, bool end) {
            for (BatchMember* to = members; to < members + count; ++to) {
                if (to->status != DONE) continue;
                member = to->number;
                evaluations = iterations = 0;
                to->status = move_all(one, side, to->x, to->dx, nullptr, t, h, end);
                to->evaluations += evaluations;
                to->iterations += iterations;
                to->residual = residual;
            }
        };
        for (const Substep& one : layout.substeps) {
            move_members(one, 0, &one == &layout.substeps.front());
            double* states[MOST_MEMBERS];
            int64_t status[MOST_MEMBERS], moving = 0;
            for (int64_t b = 0; b < count; ++b)
                if (members[b].status == DONE) states[moving++] = members[b].x;
            InnerStep& inner = *batched[one.loop];
            if (moving) inner.take_all(states, moving, t + one.begin * h, one.length * h, status);
            for (int64_t b = 0, position = 0; b < count; ++b) {
                if (members[b].status != DONE) continue;
                members[b].status = status[position];
                members[b].evaluations += inner.evaluations_of(position);
                members[b].iterations += inner.iterations_of(position);
                members[b].residual = inner.residual_of(position++);
            }
            move_members(one, 1, &one == &layout.substeps.back());
        }
    }

    double value(int64_t i, const double* x, double t) {
        return value_of(tables.restored, constants, i, x, t, arguments.data(), workspace.data());
    }

    bool evaluate(const double* x, double t) {
        if (measured) return true;
        if (matrices) return matrices->of(x, t, values.data());
        for (int64_t i = 0; i < tracked; ++i) values[i] = value(i, x, t);
        return true;
    }

    // Apply the flow of a force, and add its changes of invariants, at the time `frozen`, to its work integrals, which are
    // stored behind the coordinates.
    int64_t move(Force& force, double* x, double* dx, double* group, double t, double tau, double frozen,
                 int64_t side) {
        const int64_t status = force.flow(x, group, t, tau, member, side);
        evaluations += force.evaluations;
        iterations += force.iterations;
        residual = force.residual;
        if (status != DONE) return status;
        if (measured) {
            if (force.table.work_integrals) add(x, dx, force.table.work_integral, force.change());
            return DONE;
        }
        before.swap(values);
        if (!evaluate(x, frozen)) return UNDEFINED;
        for (int64_t i = 0; i < std::min(tracked, force.table.work_integrals); ++i) {
            const double period = matrices ? 0.0 : constants.number_at<double>(tables.restored.period, i);
            const double now = period > 0.0 ? unwrapped(values[i], before[i], period) : values[i];
            // An invariant without a value here, such as log|x| at zero, has no change either; its balance is NaN.
            const double change = now - before[i];
            if (std::isfinite(change)) add(x, dx, force.table.work_integral + i, change);
        }
        return DONE;
    }

    void add(double* x, double* dx, int64_t work_integral, double change) {
        const int64_t position = n + work_integral;
        const double old = x[position];
        two_sum(old, dx[position] + change, x[position], dx[position]);
    }
};

}  // namespace

STEP_SCHEME(forced, Forced)

}  // namespace coadjoint
