// Entry points of step methods for Python: the loop over steps, of one member after the other or of members as lanes.
#include <atomic>
#include <memory>

#include "boundary/loop.hpp"
#include "numbers/float_mode.hpp"
#include "steps/own_steps.hpp"

namespace coadjoint {

typedef StepScheme* (*MakeScheme)(const StepTables& tables, const MemberConstants& constants);

// Cache of the last steps of small tables in each thread, for many short calls. Tables are identified by a serial
// number, since others may later have the same address. Steps keep numbers, which are computed in the mode of the
// thread (not all of which fegetround sees); in another one they are made again.
struct CachedStep {
    int64_t serial = 0;
    FloatMode mode = STANDARD_MODE;
    std::shared_ptr<StepScheme> scheme;
    std::shared_ptr<LaneStep> lane_step;
    std::shared_ptr<WideStep> wide_step;
};
// Steps that a thread keeps for the next call, and the largest dimension of these, whose set-up costs as a step.
constexpr int64_t CACHE_SIZE = 16, LARGEST_CACHED = 64;
// With fewer members too many lanes would be empty.
constexpr int64_t MIN_FILLED_LANES = 3 * NATIVE / 4;
static thread_local CachedStep cache[CACHE_SIZE];
static std::atomic<int64_t> last_serial{0};

static int64_t serial_of(const Stepping& tables) {
    // The tables belong to Python. Threads that share them agree on the number that was set first.
    auto* serial = const_cast<int64_t*>(&tables.serial);
    int64_t none = 0;
    if (__atomic_load_n(serial, __ATOMIC_ACQUIRE) == 0)
        __atomic_compare_exchange_n(serial, &none, ++last_serial, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    return __atomic_load_n(serial, __ATOMIC_ACQUIRE);
}

static std::unique_ptr<StepScheme> made(const Stepping& tables, const MemberConstants& constants) {
    return std::unique_ptr<StepScheme>(reinterpret_cast<MakeScheme>(tables.step[0])(tables.tables, constants));
}

// The pointer is shared: a step written in Python may run other loops, which replace it here while it is still in use.
static CachedStep cached_step(const Stepping& tables, bool as_lanes) {
    const int64_t serial = serial_of(tables);
    const FloatMode mode = float_mode();
    CachedStep& entry = cache[serial % CACHE_SIZE];
    if (entry.serial != serial || entry.mode != mode) {
        entry = CachedStep{};
        entry.scheme = made(tables, MemberConstants{1, 0});
        entry.serial = serial;
        entry.mode = mode;
    }
    if (as_lanes && !entry.lane_step) entry.lane_step = entry.scheme->lane_step(tables.tables, nullptr);
    if (as_lanes && !entry.wide_step) entry.wide_step = entry.scheme->wide_step(nullptr);
    return entry;
}

// Members as lanes; the last one fills unused lanes.
template <class Number, class C>
static void advance_lanes(const Loop<Stepping>& loop, StepOfLanes<Number>& lane_step, const C& constants,
                          const int64_t* members, int64_t count) {
    typedef Number A;
    constexpr int lanes = Numbers<A>::lanes;
    const Stepping& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size;
    AlignedArray<A> momentum(2 * n);
    A *x = momentum.at, *dx = x + n, h(0.0), t(0.0);
    int64_t active[lanes] = {}, moving[lanes] = {}, left = 0;  // events end the recording, but not the steps
    int64_t evaluations[lanes] = {}, iterations[lanes] = {};
    read_lanes(x, arrays.momenta, n, members, count);
    read_lanes(dx, arrays.errors, n, members, count);
    for (int lane = 0; lane < lanes; ++lane) {
        const int64_t member = members[std::min<int64_t>(lane, count - 1)];
        lane_step.number[lane] = number_of(schedule, member);
        set_lane(h, lane, length_of(schedule, member));
        if (arrays.memory_size) lane_step.read(lane, loop.memory_of(member));
        if (lane < count) left += active[lane] = moving[lane] = arrays.status[member] == DONE;
    }
    LaneRecorder<A, C> recorder(loop.watch, arrays, schedule, loop.k0, constants, members, active, count);
    auto store_lane = [&](int lane) {
        write_lane(x, arrays.momenta, n, members[lane], lane);
        write_lane(dx, arrays.errors, n, members[lane], lane);
        if (arrays.memory_size) lane_step.write(lane, loop.memory_of(members[lane]));
        arrays.evaluations[members[lane]] += evaluations[lane];
        arrays.iterations[members[lane]] += iterations[lane];
    };
    auto stop = [&](int lane, int64_t k, int64_t status, double residual) {
        recorder.store_worst();
        store_lane(lane);
        active[lane] = moving[lane] = 0, --left;
        loop.fail(members[lane], k, status, residual);
    };
    const int64_t work = lanes * work_of_terms(loop.watch.terms, 0, loop.watch.terms.size) + lane_step.work;
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && left > 0; ++k) {
        t = A(start_of(schedule, members[0], k));
        for (int lane = 0; schedule.starts && lane < lanes; ++lane)
            set_lane(t, lane, start_of(schedule, members[std::min<int64_t>(lane, count - 1)], k));
        for (int64_t part = 0; part < tables.substeps && left > 0; ++part) {
            loop.interrupts.after(work);
            lane_step.step(x, dx, t + A(tables.moment[part]) * h, A(tables.fraction[part]) * h, moving);
            int64_t failing = 0;
            for (int lane = 0; lane < lanes; ++lane) {
                evaluations[lane] += lane_step.evaluations[lane], iterations[lane] += lane_step.iterations[lane];
                failing |= moving[lane] * (lane_step.status[lane] ^ DONE);
            }
            for (int lane = 0; failing && lane < count; ++lane)
                if (moving[lane] && lane_step.status[lane] != DONE)
                    stop(lane, k, lane_step.status[lane], lane_step.residual[lane]);
        }
        const auto valid = finite(n, x);
        if (__builtin_expect(!all(valid), 0))
            for (int lane = 0; lane < count; ++lane)
                if (moving[lane] && !at(valid, lane))
                    stop(lane, k, OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
        recorder.after(k, [&](bool) { return FinishedRows<A>{x, nullptr}; });
    }
    for (int lane = 0; lane < count; ++lane)
        if (moving[lane]) store_lane(lane);
}

// Take one step, part after part.
static int64_t take(StepScheme& scheme, const Stepping& tables, double start, double h, double* x, double* dx,
                    double* g, double* dg, InterruptCheck& interrupts, int64_t watched) {
    int64_t status = DONE, evaluations = 0, iterations = 0;
    for (int64_t part = 0; part < tables.substeps && status == DONE; ++part) {
        interrupts.after(watched + scheme.work);
        scheme.evaluations = scheme.iterations = 0;
        status = scheme.step(x, dx, g, dg, start + tables.moment[part] * h, tables.fraction[part] * h);
        evaluations += scheme.evaluations;
        iterations += scheme.iterations;
    }
    scheme.evaluations = evaluations;
    scheme.iterations = iterations;
    return status;
}

// Evaluate a scheme with its own step sizes at the end of step k. If one of its steps fails, `failing` is the step of
// the run in which it begins, independent of the points.
static int64_t reach(OwnSteps& scheme, double t0, int64_t k, double h, double* x, double* dx, double* g, double* dg,
                     InterruptCheck& interrupts, int64_t& failing) {
    interrupts.after(scheme.work);
    scheme.evaluations = scheme.iterations = 0;
    const int64_t status = scheme.reach(x, dx, g, dg, t0, k, h, interrupts);
    failing = std::min(k, 1 + int64_t(scheme.reached / std::fabs(h)));
    return status;
}

typedef MemberRecorder<double, MemberConstants, AlreadyFinished> RecorderAlone;

static void advance(const Loop<Stepping>& loop, const MemberRange& range) {
    const Stepping& tables = loop.tables;
    const Watch& watch = loop.watch;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size, square = arrays.square;
    const int64_t eights = (n + 7) / 8;
    AlignedArray<Lanes<8>> momentum(2 * eights);
    double *x = reinterpret_cast<double*>(momentum.at), *dx = x + 8 * eights;
    const int64_t watched = work_of_terms(watch.terms, 0, watch.terms.size);
    std::unique_ptr<StepScheme> unshared;
    // Events are located by the series of a step, which only single members have.
    const bool several = range.last - range.first >= MIN_FILLED_LANES && !schedule.events;
    const bool as_lanes = several && n <= LARGEST_CACHED;
    const CachedStep shared = range.stride || n > LARGEST_CACHED ? CachedStep{} : cached_step(tables, as_lanes);
    StepScheme* scheme = shared.scheme.get();
    std::shared_ptr<WideStep> wide_step = shared.wide_step;
    if (several && !as_lanes && !range.stride && n <= WIDEST) {
        scheme = (unshared = made(tables, MemberConstants{1, 0})).get();
        wide_step = scheme->wide_step(nullptr);
    }
    if (schedule.starts || schedule.lengths) wide_step.reset();
    bool own_wide = range.stride && n <= WIDEST && !schedule.starts && !schedule.lengths;
    AlreadyFinished nothing;
    RecorderAlone recorder(watch, arrays, schedule, MemberConstants{1, 0}, nothing);
    const auto advance_alone = [&](int64_t position) {
        const int64_t member = range.members[position];
        if (arrays.status[member] != DONE) return;
        const MemberConstants constants{range.stride ? range.stride : 1, range.stride ? position : 0};
        if (range.stride || !scheme) {
            unshared = made(tables, constants);
            scheme = unshared.get();
        }
        scheme->member = number_of(schedule, member);
        scheme->memory = arrays.memory_size ? loop.memory_of(member) : nullptr;
        // Beyond the last coordinate there are zeros, and no data of the previous member.
        std::fill_n(x, 16 * eights, 0.0);
        std::copy_n(arrays.momenta + member * n, n, x);
        std::copy_n(arrays.errors + member * n, n, dx);
        recorder.begin(member, constants, loop.k0);
        double *g = arrays.groups + member * square, *dg = arrays.group_errors + member * square;
        const double h = length_of(schedule, member);
        OwnSteps* const over = dynamic_cast<OwnSteps*>(scheme);
        SharedSteps shared_steps(schedule.threads, n);
        for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
            // Schemes with their own step sizes are evaluated only at recorded states.
            if (over) k = std::min(recorder.next_recorded(k), loop.k1);
            int64_t failing = k;
            const double start = start_of(schedule, member, k);
            int64_t status;
            shared_steps.begin();
            if (over)
                status = reach(*over, start_of(schedule, member, 1), k, h, x, dx, g, dg, loop.interrupts, failing);
            else
                status = take(*scheme, tables, start, h, x, dx, g, dg, loop.interrupts, watched);
            arrays.evaluations[member] += scheme->evaluations;
            arrays.iterations[member] += scheme->iterations;
            if (status == DONE && !(finite(n, x) && finite(square, g))) {
                status = OVERFLOWED;
                scheme->residual = std::numeric_limits<double>::quiet_NaN();
            }
            if (status != DONE) {
                loop.fail(member, failing, status, scheme->residual);
                if (failing < k) recorder.clear_from(failing);
                break;
            }
            if (schedule.events && tables.substeps == 1) recorder.set_series(scheme->series_of_step());
            recorder.after(k, x, dx, [&](int64_t, double* to) { return std::copy_n(g, square, to), true; });
            shared_steps.end();
        }
        std::copy_n(x, n, arrays.momenta + member * n);
        std::copy_n(dx, n, arrays.errors + member * n);
    };
    for (int64_t position = range.first, last; position < range.last; position = last) {
        if (wide_step) {
            last = std::min<int64_t>(position + MEMBER_LANES, range.last);
            advance_lanes(loop, *wide_step, SharedConstants{}, range.members + position, last - position);
            continue;
        }
        if (own_wide) {
            last = std::min<int64_t>(position + MEMBER_LANES, range.last);
            const LaneConstants own{range.stride, position};
            const std::unique_ptr<StepScheme> first = made(tables, own.of_lane(0));
            if (const auto wide = first->wide_step(&own)) {
                advance_lanes(loop, *wide, own, range.members + position, last - position);
                continue;
            }
            own_wide = false;
        }
        last = std::min<int64_t>(position + NATIVE, range.last);
        if (as_lanes && last - position >= MIN_FILLED_LANES) {
            const int64_t* const members = range.members + position;
            if (shared.lane_step) {
                advance_lanes(loop, *shared.lane_step, SharedConstants{}, members, last - position);
                continue;
            }
            const LaneConstants own{range.stride, position};
            if (range.stride && !scheme) scheme = (unshared = made(tables, own.of_lane(0))).get();
            if (const auto lane_step = range.stride ? scheme->lane_step(tables.tables, &own) : nullptr) {
                advance_lanes(loop, *lane_step, own, members, last - position);
                continue;
            }
        }
        for (; position < last; ++position) advance_alone(position);
    }
}

static int64_t memory_size(const Stepping& tables) { return made(tables, MemberConstants{1, 0})->memory_size; }

EXPORT_LOOP(stepping_advance, Stepping, advance, memory_size)

}  // namespace coadjoint
