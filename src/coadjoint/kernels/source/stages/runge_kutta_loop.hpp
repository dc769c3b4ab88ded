// The loop over steps of Runge-Kutta methods, for one trajectory or members as lanes.
#pragma once

#include "boundary/loop.hpp"
#include "stages/staged_state.hpp"

namespace coadjoint {

typedef Loop<RungeKuttaTables> RungeKuttaLoop;

// Visit every row of a member: its array in the state, and its array in the loop.
template <class V, class Visit>
INLINE void each_row(const Arrays& arrays, V* x, V* dx, V* g, V* dg, Visit visit) {
    visit(arrays.momenta, x, arrays.size);
    visit(arrays.errors, dx, arrays.size);
    visit(arrays.groups, g, arrays.square);
    visit(arrays.group_errors, dg, arrays.square);
}

// Approximate number of multiplications of a step of one member, for a typical number of iterations.
inline int64_t work_of_step(const RungeKuttaLoop& loop) {
    const RungeKuttaTables& tables = loop.tables;
    const int64_t stages = tables.stages, n = tables.field.size, d = tables.group.size, edge = stages * std::max(n, d);
    const int64_t slopes = work_of(tables.field) + stages * n + d * (tables.group.entries + stages * d);
    return work_of_terms(loop.watch.terms, 0, loop.watch.terms.size) +
           tables.substeps * (8 * stages * slopes + (tables.direct ? edge * edge * edge : 0));
}

// If the first correction is NaN, a number overflowed; otherwise the iteration did not converge.
INLINE int64_t failure_of(double residual) { return residual == residual ? NOT_CONVERGED : OVERFLOWED; }

// What moves along with a trajectory: nothing. After each substep with known slopes, and after each step, it is called, and
// may end the run.
struct NothingAlong {
    int64_t work_of_step(int64_t of_trajectory) const { return of_trajectory; }
    void begin(double*, bool) {}
    bool substep(Single&, double, double) { return true; }
    bool after(int64_t) { return true; }
    void end(double*) {}
};

// Its memory is behind that of the trajectory.
template <class Side, class C, class Along = NothingAlong>
void advance_alone(const RungeKuttaLoop& loop, Single& one, int64_t member, const C& constants, Along&& along = Along()) {
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size, square = arrays.square;
    each_row(arrays, one.x, one.dx, one.g, one.dg, [&](const double* from, double* to, int64_t length) {
        std::copy_n(from + member * length, length, to);
    });
    double *memory = loop.memory_of(member), *further = memory + memory_size(loop.tables);
    one.iterations = one.evaluations = 0;
    if (further > memory) {
        one.newton = memory[0];
        one.read_slopes(memory + 1);
    }
    along.begin(further, loop.k0 == 0);
    AlreadyFinished nothing;
    MemberRecorder<Side, C, AlreadyFinished> recorder(loop.watch, arrays, schedule, constants, nothing);
    recorder.begin(member, constants, loop.k0);
    SharedSteps shared_steps(schedule.threads, n);
    const int64_t work = along.work_of_step(work_of_step(loop));
    const double h = length_of(schedule, member);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        shared_steps.begin();
        const double start = start_of(schedule, member, k);
        bool found = true, moved = true;
        for (int64_t part = 0; part < loop.tables.substeps && found && moved; ++part) {
            const double t = start + loop.tables.moment[part] * h, length = loop.tables.fraction[part] * h;
            found = one.solve(t, length, part);
            if (!found) break;
            moved = along.substep(one, t, length);
            one.add();
        }
        if (!found) {
            loop.fail(member, k, failure_of(one.residual), one.residual);
            break;
        }
        if (!(finite(n, one.x) && finite(square, one.g))) {
            loop.overflow(member, k);
            break;
        }
        recorder.after(k, one.x, one.dx, [&](int64_t, double* to) { return std::copy_n(one.g, square, to), true; });
        if (!moved || !along.after(k)) {
            loop.fail(member, k, PARALLEL, std::numeric_limits<double>::quiet_NaN());
            break;
        }
        shared_steps.end();
    }
    recorder.flush();
    along.end(further);
    loop.arrays.iterations[member] += one.iterations;
    loop.arrays.evaluations[member] += one.evaluations;
    each_row(arrays, one.x, one.dx, one.g, one.dg, [&](double* to, const double* from, int64_t length) {
        std::copy_n(from, length, to + member * length);
    });
    if (further > memory) {
        memory[0] = one.newton;
        one.write_slopes(memory + 1);
    }
}

// Members as lanes; the last one fills unused lanes.
template <class A, class C>
struct RungeKuttaLanes {
    static constexpr int lanes = Numbers<A>::lanes;
    typedef typename Numbers<A>::Mask Mask;
    const RungeKuttaLoop& loop;
    const C constants;
    const int64_t *members, count;
    StagedState<MemberLanes<A>, Stages<MemberLanes<A>, C>> lane_group;
    std::unique_ptr<Single> single[lanes];
    int64_t active[lanes] = {}, left = 0;
    double newton[lanes] = {};
    std::vector<double> slopes;

    RungeKuttaLanes(const RungeKuttaLoop& loop, const C& constants, const int64_t* members, int64_t count)
        : loop(loop), constants(constants), members(members), count(count), lane_group(loop.tables, constants),
          slopes(std::max<int64_t>(loop.arrays.memory_size, 1)) {
        each_row(loop.arrays, lane_group.x, lane_group.dx, lane_group.g, lane_group.dg,
                 [&](const double* from, A* to, int64_t length) { read_lanes(to, from, length, members, count); });
        for (int64_t lane = 0; lane < count; ++lane) left += active[lane] = loop.arrays.status[members[lane]] == DONE;
        if (loop.arrays.memory_size == 0) return;
        for (int lane = 0; lane < lanes; ++lane) {
            const double* memory = loop.memory_of(members[std::min<int64_t>(lane, count - 1)]);
            newton[lane] = memory[0];
            lane_group.read_slopes(memory + 1, lane);
        }
    }

    ~RungeKuttaLanes() {
        for (int64_t lane = 0; lane < count; ++lane)
            if (active[lane]) write(int(lane));
    }

    void write(int lane) {
        const int64_t member = members[lane];
        each_row(loop.arrays, lane_group.x, lane_group.dx, lane_group.g, lane_group.dg,
                 [&](double* to, const A* from, int64_t length) { write_lane(from, to, length, member, lane); });
        if (loop.arrays.memory_size == 0) return;
        loop.memory_of(member)[0] = newton[lane];
        lane_group.write_slopes(false, loop.memory_of(member) + 1, lane);
    }

    // Solve alone for one member that failed as a lane.
    NOINLINE bool alone(int lane, double t, double h, int64_t part) {
        if (!single[lane]) single[lane] = single_of(loop.tables, constants.of_lane(lane));
        Single& one = *single[lane];
        auto take = [&](double* to, const A* from, int64_t length) {
            for (int64_t i = 0; i < length; ++i) to[i] = lane_of(from[i], lane);
        };
        take(one.x, lane_group.x, loop.arrays.size), take(one.dx, lane_group.dx, loop.arrays.size);
        take(one.g, lane_group.g, loop.arrays.square), take(one.dg, lane_group.dg, loop.arrays.square);
        one.newton = newton[lane];
        one.iterations = one.evaluations = 0;
        transfer_slopes(lane, one);
        const bool found = one.solve(t, h, part);
        newton[lane] = one.newton;
        loop.arrays.iterations[members[lane]] += one.iterations;
        loop.arrays.evaluations[members[lane]] += one.evaluations;
        slopes.resize(slope_memory_size(loop.tables));
        one.write_slopes(slopes.data());
        lane_group.read_slopes(slopes.data(), lane);
        return found;
    }

    void transfer_slopes(int lane, Single& one) {
        if (loop.arrays.memory_size == 0) return;
        lane_group.write_slopes(true, slopes.data(), lane);
        one.read_slopes(slopes.data());
    }

    void stop(LaneRecorder<A, C>& recorder, int64_t lane, int64_t k, int64_t status, double residual) {
        recorder.store_worst();
        write(int(lane));
        active[lane] = 0;
        --left;
        loop.fail(members[lane], k, status, residual);
    }

    void advance() {
        const RungeKuttaTables& tables = loop.tables;
        const Schedule& schedule = loop.schedule;
        LaneRecorder<A, C> recorder(loop.watch, loop.arrays, schedule, loop.k0, constants, members, active, count);
        const int64_t work = lanes * work_of_step(loop);
        for (int64_t k = loop.k0 + 1; k <= loop.k1 && left > 0; ++k) {
            loop.interrupts.after(work);
            const double start = schedule.t0 + double(k - 1) * schedule.h;
            for (int64_t part = 0; part < tables.substeps && left > 0; ++part)
                substep(recorder, k, start + tables.moment[part] * schedule.h, tables.fraction[part] * schedule.h, part);
            const auto valid = finite(lane_group.n, lane_group.x) & finite(loop.arrays.square, lane_group.g);
            if (__builtin_expect(!all(valid), 0))
                for (int64_t lane = 0; lane < count; ++lane)
                    if (active[lane] && !at(valid, int(lane)))
                        stop(recorder, lane, k, OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
            recorder.after(k, [&](bool) { return FinishedRows<A>{lane_group.x, lane_group.g}; });
        }
    }

    void substep(LaneRecorder<A, C>& recorder, int64_t k, double t, double h, int64_t part) {
        A selected(0.0);
        bool any_selected = false;
        for (int64_t lane = 0; lane < count; ++lane)
            if (active[lane] && !(newton[lane] >= 1.0)) set_lane(selected, int(lane), 1.0), any_selected = true;
        auto& stages = lane_group.stages;
        stages.iterations = A(0.0);
        auto found = selected < A(0.0);
        if (any_selected)
            found = (selected > A(0.0)) & stages.solve(t, h, part, selected > A(0.0));
        else
            stages.save_slopes();
        const A iterations = stages.iterations, evaluations = stages.evaluations();
        for (int64_t lane = 0; lane < count; ++lane) {
            if (!active[lane]) continue;
            if (at(found, int(lane))) {
                newton[lane] = 0.0;
                loop.arrays.iterations[members[lane]] += int64_t(iterations[lane]);
                loop.arrays.evaluations[members[lane]] += int64_t(evaluations[lane]);
            } else if (!alone(int(lane), t, h, part)) {
                const double residual = single[lane]->residual;
                stop(recorder, lane, k, failure_of(residual), residual);
            }
        }
        lane_group.add();
    }
};

}  // namespace coadjoint
