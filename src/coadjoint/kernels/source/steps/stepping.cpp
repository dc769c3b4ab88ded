// Entry points of step methods for Python: the loop over steps, of one member after the other or of members side by
// side.
#include <atomic>
#include <memory>

#include "boundary/crew.hpp"
#include "steps/own_steps.hpp"

namespace coadjoint {

typedef StepScheme* (*MakeScheme)(const StepTables& tables, const Own& constants);

// The steps of small tables that a thread used last, cached for many short calls. Tables are identified by a serial
// number, since others may later have the same address.
struct Remembered {
    int64_t serial = 0;
    std::shared_ptr<StepScheme> scheme;
    std::shared_ptr<CrowdStep> crowd;
};
constexpr int64_t REMEMBERED = 16, SMALL = 64;
// With fewer members too many lanes would be empty.
constexpr int64_t MEMBERS_TOGETHER = 3 * NATIVE / 4;
static thread_local Remembered remembered[REMEMBERED];
static std::atomic<int64_t> numbered{0};

static int64_t serial_of(const Stepping& tables) {
    // The tables belong to Python. Threads that share them agree on the number that was set first.
    auto* serial = const_cast<int64_t*>(&tables.serial);
    int64_t none = 0;
    if (__atomic_load_n(serial, __ATOMIC_ACQUIRE) == 0)
        __atomic_compare_exchange_n(serial, &none, ++numbered, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    return __atomic_load_n(serial, __ATOMIC_ACQUIRE);
}

static std::unique_ptr<StepScheme> made(const Stepping& tables, const Own& constants) {
    return std::unique_ptr<StepScheme>(reinterpret_cast<MakeScheme>(tables.step[0])(tables.tables, constants));
}

// The pointer is shared: a step written in Python may run other loops, which replace it here while it is still in use.
static Remembered remembered_step(const Stepping& tables, bool together) {
    const int64_t serial = serial_of(tables);
    Remembered& place = remembered[serial % REMEMBERED];
    if (place.serial != serial) {
        place = Remembered{};
        place.scheme = made(tables, Own{1, 0});
        place.serial = serial;
    }
    if (together && !place.crowd) place.crowd = place.scheme->crowd();
    return place;
}

// Members as lanes; the last one fills unused lanes.
static void follow_together(const Loop<Stepping>& loop, CrowdStep& crowd, const int64_t* members, int64_t count) {
    typedef CrowdStep::A A;
    const Stepping& tables = loop.tables;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size;
    const Shared constants;
    Room<A> momentum(2 * n);
    A *x = momentum.at, *dx = x + n, h(0.0);
    int64_t going[NATIVE] = {}, moving[NATIVE] = {}, left = 0;  // events end the recording, but not the steps
    read_lanes(x, arrays.momenta, n, members, count);
    read_lanes(dx, arrays.errors, n, members, count);
    for (int lane = 0; lane < NATIVE; ++lane) {
        const int64_t member = members[std::min<int64_t>(lane, count - 1)];
        set_lane(h, lane, length_of(schedule, member));
        if (arrays.remembered) crowd.read(lane, loop.memory_of(member));
        if (lane < count) left += going[lane] = moving[lane] = arrays.status[member] == DONE;
    }
    CrowdRecorder<A, Shared> recorder(loop.watch, arrays, schedule, loop.k0, constants, members, going, count);
    auto leave = [&](int lane) {
        write_lane(x, arrays.momenta, n, members[lane], lane);
        write_lane(dx, arrays.errors, n, members[lane], lane);
        if (arrays.remembered) crowd.write(lane, loop.memory_of(members[lane]));
    };
    auto stop = [&](int lane, int64_t k, int64_t status, double residual) {
        recorder.keep_worst();
        leave(lane);
        going[lane] = moving[lane] = 0, --left;
        loop.fail(members[lane], k, status, residual);
    };
    const int64_t work = NATIVE * work_of_terms(loop.watch.terms, 0, loop.watch.terms.size) + crowd.work;
    for (int64_t k = loop.k0 + 1; k <= loop.k1 && left > 0; ++k) {
        for (int64_t part = 0; part < tables.substeps && left > 0; ++part) {
            loop.hearing.after(work);
            crowd.step(x, dx, A(tables.fraction[part]) * h, moving);
            for (int lane = 0; lane < count; ++lane) {
                if (!moving[lane]) continue;
                arrays.evaluations[members[lane]] += crowd.evaluations[lane];
                arrays.iterations[members[lane]] += crowd.iterations[lane];
                if (crowd.status[lane] != DONE) stop(lane, k, crowd.status[lane], crowd.residual[lane]);
            }
        }
        const auto sound = finite(n, x);
        if (__builtin_expect(!all(sound), 0))
            for (int lane = 0; lane < count; ++lane)
                if (moving[lane] && !at(sound, lane)) stop(lane, k, OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
        recorder.after(k, [&](bool) { return FinishedRows<A>{x, nullptr}; });
    }
    for (int lane = 0; lane < count; ++lane)
        if (moving[lane]) leave(lane);
}

// Take one step, part after part.
static int64_t take(StepScheme& scheme, const Stepping& tables, double start, double h, double* x, double* dx, double* g,
                    double* dg, Hearing& hearing, int64_t watched) {
    int64_t status = DONE, evaluations = 0, iterations = 0;
    for (int64_t part = 0; part < tables.substeps && status == DONE; ++part) {
        hearing.after(watched + scheme.work);
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
                     Hearing& hearing, int64_t& failing) {
    hearing.after(scheme.work);
    scheme.evaluations = scheme.iterations = 0;
    const int64_t status = scheme.reach(x, dx, g, dg, t0, k, h, hearing);
    failing = std::min(k, 1 + int64_t(scheme.reached / std::fabs(h)));
    return status;
}

static void follow(const Loop<Stepping>& loop, const Crew& crew) {
    const Stepping& tables = loop.tables;
    const Watch& watch = loop.watch;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size, square = arrays.square;
    const int64_t eights = (n + 7) / 8;
    Room<Lanes<8>> momentum(2 * eights);
    double *x = reinterpret_cast<double*>(momentum.at), *dx = x + 8 * eights;
    const int64_t watched = work_of_terms(watch.terms, 0, watch.terms.size);
    std::unique_ptr<StepScheme> own;
    // Events are located by the series of a step, which is available for members one after the other.
    const bool together = crew.last - crew.first >= MEMBERS_TOGETHER && !schedule.events;
    const Remembered shared = crew.stride || n > SMALL ? Remembered{} : remembered_step(tables, together);
    StepScheme* scheme = shared.scheme.get();
    AlreadyFinished nothing;
    MemberRecorder<double, Own, AlreadyFinished> recorder(watch, arrays, schedule, Own{1, 0}, nothing);
    int64_t place = crew.first;
    if (together && shared.crowd)
        for (int64_t count; crew.last - place >= MEMBERS_TOGETHER; place += count) {
            count = std::min<int64_t>(NATIVE, crew.last - place);
            follow_together(loop, *shared.crowd, crew.members + place, count);
        }
    for (; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (arrays.status[member] != DONE) continue;
        const Own constants{crew.stride ? crew.stride : 1, crew.stride ? place : 0};
        if (crew.stride || !scheme) {
            own = made(tables, constants);
            scheme = own.get();
        }
        scheme->member = member;
        scheme->memory = arrays.remembered ? loop.memory_of(member) : nullptr;
        // Beyond the last coordinate there are zeros, and no data of the previous member.
        std::fill_n(x, 16 * eights, 0.0);
        std::copy_n(arrays.momenta + member * n, n, x);
        std::copy_n(arrays.errors + member * n, n, dx);
        recorder.begin(member, constants, loop.k0);
        double *g = arrays.groups + member * square, *dg = arrays.group_errors + member * square;
        const double h = length_of(schedule, member);
        OwnSteps* const over = dynamic_cast<OwnSteps*>(scheme);
        for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
            // Schemes with their own step sizes are evaluated only at recorded states.
            if (over) k = std::min(recorder.next_look(k), loop.k1);
            int64_t failing = k;
            const double start = start_of(schedule, member, k);
            int64_t status;
            if (over)
                status = reach(*over, start_of(schedule, member, 1), k, h, x, dx, g, dg, loop.hearing, failing);
            else
                status = take(*scheme, tables, start, h, x, dx, g, dg, loop.hearing, watched);
            arrays.evaluations[member] += scheme->evaluations;
            arrays.iterations[member] += scheme->iterations;
            if (status == DONE && !(finite(n, x) && finite(square, g))) {
                status = OVERFLOWED;
                scheme->residual = std::numeric_limits<double>::quiet_NaN();
            }
            if (status != DONE) {
                loop.fail(member, failing, status, scheme->residual);
                if (failing < k) recorder.take_back(failing);
                break;
            }
            if (schedule.events && tables.substeps == 1) recorder.between(scheme->series_of_step());
            recorder.after(k, x, dx, [&](int64_t, double* to) { return std::copy_n(g, square, to), true; });
        }
        std::copy_n(x, n, arrays.momenta + member * n);
        std::copy_n(dx, n, arrays.errors + member * n);
    }
}

static int64_t remembered_by(const Stepping& tables) { return made(tables, Own{1, 0})->remembered; }

EXPORT_LOOP(stepping_advance, Stepping, follow, remembered_by)

}  // namespace coadjoint
