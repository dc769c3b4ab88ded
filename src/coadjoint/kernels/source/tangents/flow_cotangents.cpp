// The loop over the steps of programs backward, for Python.
#include "flows/compiled_rows.hpp"
#include "tangents/flow_cotangents.hpp"

namespace coadjoint {

// Apply a flow of CUBIC blocks, and store its factors.
template <Summation summation, bool with_group, class A, class G>
static INLINE void apply_cubic_flow(const FlowTables& tables, const ElementaryFlow& flow, const Vectors<A>& x,
                                    const Vectors<G>& group, AppliedRotations<A>* applied) {
    A theta(flow.offset);
    for (uint32_t entry = 0; entry < flow.entries; ++entry)
        theta = fma(A(flow.weight[entry]), x.at[flow.column[entry]], theta);
    const auto move = [&](auto sum, const Action& action, uint32_t run, double factor, const auto& vectors) {
        const CubicFactors<A> factors(action, SharedConstants{}, run, factor * theta);
        gather(BlockRows(action, run), vectors);
        cubic_by<decltype(sum)::value>(action, SharedConstants{}, run, factors, vectors);
        return Rotation<A>{factors.s, factors.c};
    };
    applied->momentum = move(std::integral_constant<Summation, summation>(), tables.state, flow.momentum.run,
                             flow.momentum.factor, x);
    if (with_group)
        applied->group = move(std::integral_constant<Summation, CORRECTED>(), tables.group, flow.group.run,
                              flow.group.factor, group);
}

// Members as lanes, or one member with the rows of its group element as lanes.
template <Summation summation, bool with_group, class A, class G>
static void run_backward(const FlowCotangents& all, const BackwardRun& run, int64_t first, int64_t count,
                         InterruptCheck& interrupts) {
    const FlowTables& tables = all.base;
    constexpr bool of_members = Numbers<A>::lanes == Numbers<G>::lanes;
    const int64_t size = run.size, d = with_group ? tables.group.size : 0;
    const int64_t rows = of_members ? d : (d + Numbers<G>::lanes - 1) / Numbers<G>::lanes, square = d * rows;
    const int64_t steps = run.undone ? 0 : run.k1 - run.k0, coefficients = CoefficientCotangents<A>::count(tables.terms);
    AlignedArray<A> states((steps + 1) * size), x(2 * size), cotangents(size), finished(2 * size), added(size);
    AlignedArray<A> scratch(3 * size), of_coefficients(coefficients);
    AlignedArray<G> groups((steps + 1) * square), group(2 * square), group_cotangents(square), copies(2 * square);
    AlignedArray<G> group_added(square), group_scratch(3 * square);
    AngleWorkspace<A> angles(tables.longest);
    if constexpr (Numbers<A>::lanes == 1) angles.use_properties(tables);
    const CoefficientCotangents<A> derivatives(tables.terms, of_coefficients.at);
    RowsBackward<A, G> backward(all, derivatives, with_group, angles);
    FlowsOfRows flows_of(tables, with_group, true);
    const auto opening = flows_of(tables.section[0], tables.section[1]);
    const auto repeated = flows_of(tables.section[1], tables.section[2]);
    const auto finish = flows_of(tables.section[2], tables.section[3]);
    // Numbers of a member are contiguous; entries (i, r) of a group element are at i * rows + r, or in its lanes.
    const auto each_number = [&](auto* to, int64_t length, auto&& visit) {
        for (int64_t lane = 0; lane < (of_members ? count : 1); ++lane)
            for (int64_t i = 0; i < length; ++i) visit(to[i], int(lane), (first + lane) * length + i);
    };
    const auto each_entry = [&](G* to, auto&& visit) {
        for (int64_t lane = 0; lane < (of_members ? count : 1); ++lane)
            for (int64_t i = 0; i < d; ++i)
                for (int64_t r = 0; r < d; ++r) {
                    const int64_t from = (first + lane) * d * d + i * d + r;
                    if constexpr (of_members)
                        visit(to[i * rows + r], int(lane), from);
                    else
                        visit(to[i * rows + r / Numbers<G>::lanes], int(r % Numbers<G>::lanes), from);
                }
    };
    const auto read = [&](A* to, const double* from) {
        each_number(to, size, [&](A& entry, int lane, int64_t position) { set_lane(entry, lane, from[position]); });
    };
    const auto read_group = [&](G* to, const double* from) {
        each_entry(to, [&](G& entry, int lane, int64_t position) { set_lane(entry, lane, from[position]); });
    };
    read(x.at, run.momenta), read(x.at + size, run.errors), read(cotangents.at, run.cotangents);
    if (with_group) {
        read_group(group.at, run.groups), read_group(group.at + square, run.group_errors);
        read_group(group_cotangents.at, run.group_cotangents);
    }
    const Vectors<A> momentum{x.at, x.at + size, 1, scratch.at};
    const Vectors<G> element{group.at, group.at + square, rows, group_scratch.at};
    SharedSteps shared_steps(of_members ? 1 : run.threads, size);
    const auto store = [&](int64_t k) {
        shared_copy(x.at, size, states.at + k * size);
        std::copy_n(group.at, square, groups.at + k * square);
    };
    const int64_t work = Numbers<A>::lanes * work_of_flows(tables);
    const size_t longest = std::max(opening.size(), repeated.size());
    AlignedArray<AppliedRotations<A>> rotations(run.undone ? 0 : steps * longest);
    const auto rotations_of = [&](int64_t k) { return run.undone ? nullptr : rotations.at + (k - run.k0 - 1) * longest; };
    store(0);
    for (int64_t k = run.k0 + 1; !run.undone && k <= run.k1; ++k) {
        interrupts.after(work);
        shared_steps.begin();
        const A t(run.t0 + double(k - 1) * run.h);
        const auto& flows = k == 1 ? opening : repeated;
        for (size_t position = 0; position < flows.size(); ++position) {
            const ElementaryFlow& flow = flows[position];
            AppliedRotations<A>* applied = rotations_of(k) + position;
            if (flow.kind == CUBIC)
                apply_cubic_flow<summation, with_group>(tables, flow, momentum, element, applied);
            else if (flow.kind != WHOLE_ROW)
                apply_flow<summation, with_group>(flow, momentum, element, applied);
            else if (int64_t(tables.part[flow.row]) != all.added)
                sweep<summation, with_group>(tables, SharedConstants{}, flow.row, flow.row + 1, momentum, element, t,
                                             run.h, angles);
        }
        for (uint32_t r = tables.section[k == 1 ? 0 : 1]; flows.empty() && r < tables.section[k == 1 ? 1 : 2]; ++r)
            if (int64_t(tables.part[r]) != all.added)
                sweep<summation, with_group>(tables, SharedConstants{}, r, r + 1, momentum, element, t, run.h, angles);
        store(k - run.k0);
        shared_steps.end();
    }
    int64_t mark = run.marked;
    for (int64_t k = run.k1; k > run.k0; --k) {
        interrupts.after(4 * work);
        run.undone ? shared_steps.begin() : shared_steps.begin_as_measured();
        const A t(run.t0 + double(k - 1) * run.h);
        const A* state = run.undone ? x.at : states.at + (k - run.k0) * size;
        const G* after = run.undone ? group.at : groups.at + (k - run.k0) * square;
        if (mark > 0 && run.marks[mark - 1] == k) {
            --mark;
            // The states of the steps are unfinished: a copy is finished and undone.
            shared_copy(state, size, finished.at);
            std::copy_n(after, square, copies.at);
            read(added.at, run.at_points + mark * run.members * size);
            if (with_group) read_group(group_added.at, run.at_groups + mark * run.members * d * d);
            const Vectors<A> copy{finished.at, nullptr, 1, scratch.at};
            const Vectors<G> copied{copies.at, copies.at + square, rows, group_scratch.at};
            std::fill_n(copied.errors, square, G(0.0));
            for (uint32_t r = tables.section[2]; r < tables.section[3]; ++r)
                if (int64_t(tables.part[r]) != all.added)
                    sweep<PLAIN, with_group>(tables, SharedConstants{}, r, r + 1, copy, copied, t, run.h, angles);
            backward.sweep(tables.section[2], tables.section[3], finish,
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
        backward.sweep(tables.section[k == 1 ? 0 : 1], tables.section[k == 1 ? 1 : 2], k == 1 ? opening : repeated,
                       {x.at, cotangents.at, {group.at, nullptr, rows, group_scratch.at},
                        {group_cotangents.at, nullptr, rows, group_scratch.at}}, t, run.h, rotations_of(k));
        run.undone ? shared_steps.end() : shared_steps.end_as_measured();
    }
    each_number(cotangents.at, size,
                [&](A& entry, int lane, int64_t position) { run.cotangents[position] = lane_of(entry, lane); });
    each_number(of_coefficients.at, coefficients,
                [&](A& entry, int lane, int64_t position) { run.coefficients[position] += lane_of(entry, lane); });
    if (with_group)
        each_entry(group_cotangents.at,
                   [&](G& entry, int lane, int64_t position) { run.group_cotangents[position] = lane_of(entry, lane); });
}

template <Summation summation, bool with_group>
static void run_members(const FlowCotangents& all, const BackwardRun& run, int64_t first, int64_t last,
                        InterruptCheck& interrupts) {
    for (; run.size <= WIDEST && last - first >= MIN_LANES; first += std::min<int64_t>(MEMBER_LANES, last - first))
        run_backward<summation, with_group, Lanes<MEMBER_LANES>, Lanes<MEMBER_LANES>>(
            all, run, first, std::min<int64_t>(MEMBER_LANES, last - first), interrupts);
    for (; first < last; ++first)
        run_backward<summation, with_group, double, GroupRows>(all, run, first, 1, interrupts);
}

// Carry the cotangents of the members first to last - 1 from the last step to the first; return zero or the outcome.
EXPORT int64_t flow_cotangents(const FlowCotangents* tables, const BackwardRun* run, int64_t first, int64_t last,
                               const int64_t* stop) {
    InterruptCheck interrupts(stop);
    try {
        const bool with_group = run->square > 0;
        if (tables->base.compensated)
            with_group ? run_members<CORRECTED, true>(*tables, *run, first, last, interrupts)
                       : run_members<CORRECTED, false>(*tables, *run, first, last, interrupts);
        else
            with_group ? run_members<PLAIN, true>(*tables, *run, first, last, interrupts)
                       : run_members<PLAIN, false>(*tables, *run, first, last, interrupts);
        return 0;
    } catch (const Interrupted&) {
        return INTERRUPTED;
    } catch (const std::bad_alloc&) {
        return NO_MEMORY;
    }
}

EXPORT int64_t flow_cotangents_coefficients(const FlowCotangents* tables) {
    return CoefficientCotangents<double>::count(tables->base.terms);
}

}  // namespace coadjoint
