// Symmetric splitting of forces and a step of another loop: half flows, the step, half flows in reversed order; at
// fractions of the step for higher orders; with the work integrals of each force.
#include <cmath>
#include <cstring>
#include <memory>

#include "forces/force_lanes.hpp"
#include "matrices/compiled_transforms.hpp"
#include "matrices/invariants.hpp"
#include "steps/forced_layout.hpp"
#include "steps/inner_lanes.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

struct Forced final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const ForcedLayout layout;
    const std::unique_ptr<MatrixInvariants> matrices;
    const int64_t n, tracked;
    // One of both for each length: programs of states that are not large, without a group element, and other loops.
    std::vector<std::unique_ptr<FinishedStep<double>>> programs;
    std::vector<std::unique_ptr<InnerStep>> inner;
    // Programs of a member with constants of its own, which is one of the lanes.
    std::vector<std::unique_ptr<InnerLanes<LaneConstants>>> columns;
    AlignedArray<Lanes<MEMBER_LANES>> state;
    std::vector<std::unique_ptr<Force>> forces;
    std::vector<double> values, before, arguments, workspace;
    bool measured = true;  // whether all forces compute the changes of the energy themselves

    // `whole` is read by `ForcedLayout`; for a matrix its invariants replace those of the tables.
    Forced(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), layout(tables.whole),
          matrices(matrix_invariants(layout.rest, tables.coefficients)), n(tables.field.size),
          tracked(matrices ? matrices->count() : tables.restored.size), state(constants.stride == 1 ? 0 : n), values(tracked), before(tracked), arguments(tables.restored.longest + 1),
          workspace(2 * tables.restored.longest + 2) {
        for (const int64_t* loop : layout.loops) {
            const int64_t square = tables.group.size * tables.group.size;
            const bool own = constants.stride != 1;
            if (own) columns.emplace_back(new InnerLanes<LaneConstants>(loop, n, {constants.stride, constants.first - lane()}));
            programs.push_back(own || square || n > WIDEST ? nullptr : FinishedStep<double>::of(loop, n));
            inner.emplace_back(own || programs.back() ? nullptr : new InnerStep(loop, n, square));
        }
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
        if (const int64_t status = move_all(one, 0, x, dx, group, t, h, ends[0])) return status;
        if (const int64_t status = take_inner(one, x, group, t + one.begin * h, one.length * h)) return status;
        return move_all(one, 1, x, dx, group, t, h, ends[1]);
    }

    // The lane of a member with constants of its own.
    int lane() const { return int(constants.first % MEMBER_LANES); }

    int64_t take_column(InnerLanes<LaneConstants>& inner, double* x, double t, double h) {
        for (int64_t i = 0; i < n; ++i) state.at[i] = Lanes<MEMBER_LANES>(x[i]);
        Lanes<MEMBER_LANES> only(0.0);
        only.set(lane(), 1.0);
        inner.take(state.at, t, h, only > Lanes<MEMBER_LANES>(0.0));
        for (int64_t i = 0; i < n; ++i) x[i] = state.at[i][lane()];
        evaluations += int64_t(inner.evaluations[lane()]);
        iterations += int64_t(inner.iterations[lane()]);
        residual = inner.residual[lane()];
        return int64_t(inner.status[lane()]);
    }

    int64_t take_inner(const Substep& one, double* x, double* group, double t, double h) {
        if (!columns.empty()) return take_column(*columns[one.loop], x, t, h);
        if (FinishedStep<double>* const program = programs[one.loop].get()) {
            program->take(x, t, h, true);
            evaluations += int64_t(program->evaluations);
            residual = std::numeric_limits<double>::quiet_NaN();
            return int64_t(program->status);
        }
        InnerStep& inner = *this->inner[one.loop];
        const int64_t status = inner.take(x, group, t, h, memory_size ? memory : nullptr);
        evaluations += inner.evaluations;
        iterations += inner.iterations;
        residual = inner.residual;
        return status;
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

    std::unique_ptr<WideStep> wide_step(const LaneConstants* own) override;

    double value(int64_t i, const double* x, double t) {
        return value_of(tables.restored, constants, i, x, t, arguments.data(), workspace.data());
    }

    bool evaluate(const double* x, double t) {
        if (measured) return true;
        if (matrices) return matrices->begin(x, t);
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
        const int64_t changing = std::min(tracked, force.table.work_integrals);
        if (matrices) {
            if (!matrices->change(x, frozen, values.data())) return UNDEFINED;
            for (int64_t i = 0; i < changing; ++i) add(x, dx, force.table.work_integral + i, values[i]);
            return DONE;
        }
        before.swap(values);
        if (!evaluate(x, frozen)) return UNDEFINED;
        for (int64_t i = 0; i < changing; ++i) {
            const double period = constants.number_at<double>(tables.restored.period, i);
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

// The same step of members as lanes, without group elements and memories. `C` are the constants of one table, or those of
// each member.
template <class C>
struct ForcedLanes final : WideStep {
    typedef Numbers<A>::Mask Mask;
    Forced& alone;
    const StepTables& tables;
    const C constants;
    const int64_t n, tracked;
    std::vector<std::unique_ptr<InnerLanes<C>>> inner;
    std::vector<std::unique_ptr<ForceLanes<C>>> forces;
    AlignedArray<A> values, arguments;
    std::vector<double> workspace;
    std::vector<bool> known;  // which of the values are those of the state now
    Mask moving;
    A statuses, evaluated, iterated, residuals;

    ForcedLanes(Forced& alone, const C& constants)
        : alone(alone), tables(alone.tables), constants(constants), n(alone.n), tracked(alone.tracked), values(tracked),
          arguments(tables.restored.longest + 1), workspace(2 * tables.restored.longest + 2), known(tracked) {
        for (const int64_t* loop : alone.layout.loops) inner.emplace_back(new InnerLanes<C>(loop, n, constants));
        for (const auto& force : alone.forces) forces.emplace_back(new ForceLanes<C>(*force, tables.group, constants, number));
        work = lanes * alone.work;
    }

    void step(A* x, A* dx, const A& t, const A& h, const int64_t* active) override {
        for (int k = 0; k < A::count; ++k) {
            A::Bits some;
            std::memcpy(&some, active + k * A::width, sizeof(some));
            moving.part[k] = some != 0;
        }
        statuses = evaluated = iterated = A(0.0);
        residuals = A(std::numeric_limits<double>::quiet_NaN());
        take_all(x, dx, t[0], h[0]);
        store(residual, residuals);
        store_whole(status, statuses);
        store_whole(evaluations, evaluated);
        store_whole(iterations, iterated);
    }

    static void store_whole(int64_t* to, const A& from) {
        for (int k = 0; k < A::count; ++k) {
            const auto whole = __builtin_convertvector(from.part[k], A::Bits);
            std::memcpy(to + k * A::width, &whole, sizeof(whole));
        }
    }

    void take_all(A* x, A* dx, double t, double h) {
        for (const auto& force : forces) force->begin(t, h);
        for (const Substep& one : alone.layout.substeps) {
            move_all(one, 0, x, dx, t, h, &one == &alone.layout.substeps.front());
            InnerLanes<C>& inner = *this->inner[one.loop];
            inner.take(x, t + one.begin * h, one.length * h, moving);
            count(inner, moving);
            move_all(one, 1, x, dx, t, h, &one == &alone.layout.substeps.back());
        }
    }

    // Count what a part of the step has computed for some members, and stop those that it has failed.
    template <class Part>
    void count(const Part& part, const Mask& where) {
        evaluated = select(where, evaluated + part.evaluations, evaluated);
        iterated = select(where, iterated + part.iterations, iterated);
        residuals = select(where, part.residual, residuals);
        const Mask done = part.status == A(double(DONE));
        if (__builtin_expect(all(done), 1)) return;
        statuses = select(where, part.status, statuses);
        moving = moving & (done | !where);
    }

    void move_all(const Substep& one, int64_t side, A* x, A* dx, double t, double h, bool end) {
        const double begin = t + one.begin * h, length = one.length * h, half = 0.5 * length;
        const double frozen = side ? begin + length : begin;
        known.assign(tracked, false);
        for (size_t k = 0; k < forces.size() && any(moving); ++k) {
            const size_t position = side ? forces.size() - 1 - k : k;
            if (!forces[position]->around_steps())
                move(position, x, dx, side ? begin + half : begin, half, frozen, side, moving);
            else if (const Mask acting = moving & forces[position]->acts(side); end && any(acting))
                move(position, x, dx, t, h, frozen, side, acting);
        }
    }

    // Apply the flow of a force to the members for which it is `acting`, and add its work.
    void move(size_t position, A* x, A* dx, double t, double tau, double frozen, int64_t side, Mask acting) {
        ForceLanes<C>& force = *forces[position];
        const ForceTable& table = alone.forces[position]->table;
        const int64_t changing = alone.measured ? 0 : std::min(tracked, table.work_integrals);
        for (int64_t i = 0; i < changing; ++i)
            if (!known[i]) values.at[i] = value(i, x, frozen);
        force.flow(x, t, tau, side, acting);
        count(force, acting);
        acting = acting & moving;
        if (alone.measured && table.work_integrals) add(x, dx, table.work_integral, force.change, acting);
        for (int64_t i = 0; i < tracked; ++i) {
            if (!(known[i] = i < changing)) continue;
            const A before = values.at[i], now = value(i, x, frozen);
            A change = now - before;
            values.at[i] = now;
            if (const A period = constants.template number_at<A>(tables.restored.period, i); any(period > A(0.0)))
                for (int lane = 0; lane < lanes; ++lane)
                    if (period[lane] > 0.0) change.set(lane, unwrapped(now[lane], before[lane], period[lane]) - before[lane]);
            add(x, dx, table.work_integral + i, change, acting & (change - change == A(0.0)));
        }
    }

    A value(int64_t i, const A* x, double t) {
        return value_of(tables.restored, constants, i, x, A(t), arguments.at, workspace.data());
    }

    void add(A* x, A* dx, int64_t work_integral, const A& change, const Mask& where) {
        A &old = x[n + work_integral], &error = dx[n + work_integral], sum, remainder;
        two_sum(old, error + change, sum, remainder);
        old = select(where, sum, old);
        error = select(where, remainder, error);
    }
};

std::unique_ptr<WideStep> Forced::wide_step(const LaneConstants* own) {
    if (matrices || tables.group.size) return nullptr;
    if (own) return std::make_unique<ForcedLanes<LaneConstants>>(*this, *own);
    return std::make_unique<ForcedLanes<SharedConstants>>(*this, SharedConstants{});
}

}  // namespace

STEP_SCHEME(forced, Forced)

}  // namespace coadjoint
