// The loop over the steps of programs backward, for Python.
#include "flows/compiled_rows.hpp"
#include "tangents/flow_cotangents.hpp"
#include "tangents/members.hpp"

namespace coadjoint {

// Apply a CUBIC block, and return its factors.
template <Summation summation, class A, class V, class C>
static NOINLINE Rotation<A> apply_cubic(const Action& action, const C& constants, uint32_t run, const A& theta,
                                        const Vectors<V>& vectors) {
    const CubicFactors<A> factors = cubic_factors(action, constants, run, theta);
    gather(BlockRows(action, run), vectors);
    cubic_by<summation>(action, constants, run, factors, vectors);
    return {factors.s, factors.c};
}

// Apply a flow, and store its rotations, or the factors of its CUBIC blocks in the places of sine and cosine.
template <Summation summation, bool with_group, class A, class G, class N, class C>
static INLINE void apply_and_store(const FlowTables& tables, const C& constants, const ElementaryFlow<N>& flow,
                                   const Vectors<A>& x, const Vectors<G>& group, AppliedRotations<A>* applied) {
    if (__builtin_expect(flow.kind != CUBIC, 1))
        return apply_flow<summation, with_group>(flow, constants, x, group, applied);
    const A theta = angle_of(flow, constants, x.at);
    applied->momentum =
        apply_cubic<summation>(tables.state, constants, flow.momentum.run, flow.momentum.factor * theta, x);
    if (with_group)
        applied->group =
            apply_cubic<CORRECTED>(tables.group, constants, flow.group.run, flow.group.factor * theta, group);
}

// Members as lanes, or one member with the rows of its group element as lanes.
template <bool of_members, class C>
class StepsBackward final : public Kept {
    typedef std::conditional_t<of_members, ManyMembers, double> A;
    typedef std::conditional_t<of_members, ManyMembers, GroupRows> G;

  public:
    StepsBackward(const FlowCotangents& all, const C& constants, const BackwardRun& run, int64_t count,
                  InterruptCheck& interrupts)
        : all(all), tables(all.base), constants(constants), run(run), interrupts(interrupts), used(of_members ? count : 1),
          members{0, used}, size(run.size), d(run.square > 0 ? tables.group.size : 0),
          rows(of_members ? d : (d + Numbers<G>::lanes - 1) / Numbers<G>::lanes), square(d * rows),
          steps(run.undone ? 0 : run.k1 - run.k0), coefficients(CoefficientCotangents<A>::count(tables.terms)),
          states((steps + 1) * size), x(2 * size), cotangents(size), finished(2 * size), added(size),
          scratch(3 * size), of_coefficients(coefficients), groups((steps + 1) * square), group(2 * square),
          group_cotangents(square), copies(2 * square), group_added(square), group_scratch(3 * square),
          angles(tables.longest), derivatives(tables.terms, of_coefficients.at),
          backward(all, constants, derivatives, run.square > 0, angles),
          work(Numbers<A>::lanes * work_of_flows(tables)) {
        if constexpr (Numbers<A>::lanes == 1) angles.use_properties(tables);
        FlowsOfRows<N, C> flows_of(tables, constants, run.square > 0, true);
        opening = flows_of(rows_of_step(tables, 1));
        repeated = flows_of(rows_of_step(tables, 2));
        finish = flows_of(finishing_rows(tables));
        longest = std::max(opening.size(), repeated.size());
        rotations.clear(run.undone ? 0 : steps * longest);
    }

    // Carry the cotangents of the members from `first` on, of a run with as many steps as that of the constructor.
    void take(const BackwardRun& given, int64_t first) {
        run = given, members.first = first;
        shared_steps.emplace(of_members ? 1 : run.threads, size);
        std::fill_n(of_coefficients.at, coefficients, A(0.0));
        largest_deviation = A(0.0);
        read(x.at, run.momenta), read(x.at + size, run.errors), read(cotangents.at, run.cotangents);
        read_group(group.at, run.groups), read_group(group.at + square, run.group_errors);
        read_group(group_cotangents.at, run.group_cotangents);
        if (tables.compensated)
            run.square > 0 ? forward<CORRECTED, true>() : forward<CORRECTED, false>();
        else
            run.square > 0 ? forward<PLAIN, true>() : forward<PLAIN, false>();
        take_back();
        shared_steps.reset();
    }

  private:
    // Take the steps, and store their states and rotations, unless steps are undone from the last state.
    template <Summation summation, bool with_group>
    void forward() {
        const Vectors<A> momentum{x.at, x.at + size, 1, scratch.at};
        const Vectors<G> element{group.at, group.at + square, rows, group_scratch.at};
        store(0);
        for (int64_t k = run.k0 + 1; !run.undone && k <= run.k1; ++k) {
            interrupts.after(work);
            shared_steps->begin();
            const A t(run.t0 + double(k - 1) * run.h);
            const auto& flows = k == 1 ? opening : repeated;
            for (size_t position = 0; position < flows.size(); ++position)
                if (const Flow& flow = flows[position]; __builtin_expect(flow.kind != WHOLE_ROW, 1))
                    apply_and_store<summation, with_group>(tables, constants, flow, momentum, element,
                                                           rotations_of(k) + position);
                else
                    rows_forward<summation>({flow.row, flow.row + 1}, momentum, element, t);
            if (flows.empty()) rows_forward<summation>(rows_of_step(tables, k), momentum, element, t);
            store(k - run.k0);
            shared_steps->end();
        }
    }

    void take_back() {
        int64_t mark = run.marked;
        for (int64_t k = run.k1; k > run.k0; --k) {
            interrupts.after(4 * work);
            run.undone ? shared_steps->begin() : shared_steps->begin_as_measured();
            const A t(run.t0 + double(k - 1) * run.h);
            const A* state = run.undone ? x.at : states.at + (k - run.k0) * size;
            const G* after = run.undone ? group.at : groups.at + (k - run.k0) * square;
            if (mark > 0 && run.marks[mark - 1] == k) {
                --mark;
                // The states of the steps are unfinished: a copy is finished and undone.
                shared_copy(state, size, finished.at);
                std::copy_n(after, square, copies.at);
                read(added.at, run.at_points + mark * run.members * size);
                read_group(group_added.at, run.at_groups + mark * run.members * d * d);
                const Vectors<A> copy{finished.at, nullptr, 1, scratch.at};
                const Vectors<G> copied{copies.at, copies.at + square, rows, group_scratch.at};
                std::fill_n(copied.errors, square, G(0.0));
                rows_forward<PLAIN>(finishing_rows(tables), copy, copied, t);
                backward.sweep(finishing_rows(tables), finish,
                               {finished.at, added.at, copied, {group_added.at, nullptr, rows, group_scratch.at}}, t, run.h);
                share(size, [&](int64_t low, int64_t high) {
                    for (int64_t i = low; i < high; ++i) cotangents.at[i] += added.at[i];
                });
                for (int64_t e = 0; e < square; ++e) group_cotangents.at[e] += group_added.at[e];
            }
            if (!run.undone) {
                shared_copy(state, size, x.at);
                std::copy_n(after, square, group.at);
            }
            backward.sweep(rows_of_step(tables, k), k == 1 ? opening : repeated,
                           {x.at, cotangents.at, {group.at, nullptr, rows, group_scratch.at},
                            {group_cotangents.at, nullptr, rows, group_scratch.at}}, t, run.h, rotations_of(k));
            if (run.deviations && !run.undone) compare_with(states.at + (k - 1 - run.k0) * size);
            run.undone ? shared_steps->end() : shared_steps->end_as_measured();
        }
        members.each_number(cotangents.at, size, used, write_entries(run.cotangents));
        members.each_number(of_coefficients.at, coefficients, used,
                    [&](A& entry, int lane, int64_t position) { run.coefficients[position] += lane_of(entry, lane); });
        each_entry(group_cotangents.at, used, write_entries(run.group_cotangents));
        for (int64_t lane = 0; run.deviations && lane < used; ++lane) {
            double& deviation = run.deviations[members.member_of(lane)];
            deviation = std::max(deviation, lane_of(largest_deviation, int(lane)));
        }
    }

    typedef typename RowsBackward<A, G, C>::N N;
    typedef ElementaryFlow<N> Flow;
    const FlowCotangents& all;
    const FlowTables& tables;
    const C constants;
    BackwardRun run;
    InterruptCheck& interrupts;
    const int64_t used;
    MembersOfRun<of_members> members;
    const int64_t size, d, rows, square, steps, coefficients;
    AlignedArray<A> states, x, cotangents, finished, added, scratch, of_coefficients;
    AlignedArray<G> groups, group, group_cotangents, copies, group_added, group_scratch;
    AngleWorkspace<A> angles;
    const CoefficientCotangents<A> derivatives;
    RowsBackward<A, G, C> backward;
    std::vector<Flow> opening, repeated, finish;
    std::optional<SharedSteps> shared_steps;
    const int64_t work;
    size_t longest;
    AlignedArray<AppliedRotations<A>> rotations{0};
    A largest_deviation{0.0};

    // Compare the state, from which the flows of a step were undone, with that before the step.
    void compare_with(const A* before) {
        const auto sum_of = [&](const auto& distance) {
            return shared_sum<A>(size, [&](int64_t first, int64_t last) {
                A sum(0.0);
                for (int64_t i = first; i < last; ++i) sum = sum + absolute(distance(i));
                return sum;
            });
        };
        const A off = sum_of([&](int64_t i) { return x.at[i] - before[i]; });
        const A whole = sum_of([&](int64_t i) { return before[i]; });
        largest_deviation = larger(largest_deviation, select(A(0.0) < off, off / whole, A(0.0)));
    }

    // A row of the program, unless it is the added one.
    template <Summation summation>
    NOINLINE void rows_forward(RowRange range, const Vectors<A>& momentum, const Vectors<G>& element, const A& t) {
        for (uint32_t r = range.first; r < range.last; ++r) {
            if (int64_t(tables.part[r]) == all.added) continue;
            if (d > 0)
                sweep<summation, true>(tables, constants, {r, r + 1}, momentum, element, t, run.h, angles);
            else
                sweep<summation, false>(tables, constants, {r, r + 1}, momentum, element, t, run.h, angles);
        }
    }

    // Entries (i, r) of a group element are at i * rows + r, or in its lanes.
    template <class Visit>
    void each_entry(G* to, int64_t lanes, const Visit& visit) const {
        for (int64_t lane = 0; lane < lanes; ++lane)
            for (int64_t i = 0; i < d; ++i)
                for (int64_t r = 0; r < d; ++r) {
                    const int64_t from = members.member_of(lane) * d * d + i * d + r;
                    if constexpr (of_members)
                        visit(to[i * rows + r], int(lane), from);
                    else
                        visit(to[i * rows + r / Numbers<G>::lanes], int(r % Numbers<G>::lanes), from);
                }
    }

    NOINLINE void read(A* to, const double* from) const {
        members.each_number(to, size, Numbers<A>::lanes, read_entries(from));
    }

    NOINLINE void read_group(G* to, const double* from) const {
        each_entry(to, Numbers<A>::lanes, read_entries(from));
    }

    void store(int64_t k) {
        shared_copy(x.at, size, states.at + k * size);
        std::copy_n(group.at, square, groups.at + k * square);
    }

    AppliedRotations<A>* rotations_of(int64_t k) const {
        return run.undone ? nullptr : rotations.at + (k - run.k0 - 1) * longest;
    }
};

// Carry the cotangents of the members first to last - 1 from the last step to the first; return zero or the outcome.
static int64_t carry_backward(const FlowCotangents& tables, const BackwardRun& run, int64_t first, int64_t last,
                              InterruptCheck& interrupts, std::unique_ptr<Kept>* kept) {
    return run_in_lanes<MEMBER_LANES, StepsBackward>(tables, run, first, last, interrupts, kept);
}

EXPORT_DERIVATIVES(flow_cotangents, FlowCotangents, BackwardRun, carry_backward)

}  // namespace coadjoint
