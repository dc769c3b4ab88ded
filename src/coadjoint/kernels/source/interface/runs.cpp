// The C interface: coadjoint_runs.h.
#include "boundary/tables.hpp"

#if defined(_WIN32)
#define COADJOINT_API __declspec(dllexport)
#else
#define COADJOINT_API __attribute__((visibility("default")))
#endif
#include "interface/coadjoint_runs.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <new>
#include <stdexcept>

#include "boundary/arrays.hpp"
#include "interface/stored_flow.hpp"
#include "numbers/float_mode.hpp"

namespace coadjoint {

EXPORT int64_t flow_advance(const FlowTables* tables, const Watch* watch, const int64_t* members, int64_t first,
                            int64_t last, int64_t stride, const Extent* extent, const Schedule* schedule, double* saved,
                            double* state, int64_t k0, int64_t k1, const int64_t* stop);
EXPORT int64_t flow_directions(const FlowCotangents* tables, const ForwardRun* run, int64_t first, int64_t last,
                               const int64_t* stop);
EXPORT int64_t flow_cotangents(const FlowCotangents* tables, const BackwardRun* run, int64_t first, int64_t last,
                               const int64_t* stop);

namespace {

constexpr int64_t MOST_STEPS = int64_t(1) << 53, POINTS_OF_A_CALL = 64;
constexpr int64_t MOST_NUMBERS = int64_t(1) << 40;  // of the arrays of a derivative; memory ends before
const int64_t never = 0, only_member = 0;
thread_local char message[256] = "";

struct Failure {
    int code;
    const char* text;
};

void require(bool holds, const char* text) {
    if (!holds) throw Failure{COADJOINT_WRONG_ARGUMENT, text};
}

// The standard floating-point mode, until the end of a call.
struct StandardMode {
    const FloatMode caller = float_mode();
    StandardMode() { set_float_mode(STANDARD_MODE); }
    ~StandardMode() { set_float_mode(caller); }
};

// Call a function; what it throws is the code that is returned, and the message.
template <class Function>
int guarded(const Function& function) noexcept {
    const StandardMode mode;
    const auto failed = [](int code, const char* text) {
        std::snprintf(message, sizeof message, "%s", text);
        return code;
    };
    try {
        function();
        return COADJOINT_OK;
    } catch (const Failure& failure) {
        return failed(failure.code, failure.text);
    } catch (const WrongTable& wrong) {
        return failed(COADJOINT_WRONG_TABLE, wrong.what());
    } catch (const std::bad_alloc&) {
        return failed(COADJOINT_NO_MEMORY, "there is not enough memory");
    } catch (const std::length_error&) {
        return failed(COADJOINT_NO_MEMORY, "there is not enough memory");
    }
}

void require_outcome(int64_t outcome) {
    if (outcome == NO_MEMORY) throw std::bad_alloc();
}

bool are_finite(const double* x, size_t count) {
    return std::all_of(x, x + count, [](double one) { return std::isfinite(one); });
}

// A run between two steps: `state` are its arrays, in which the last flow is still to be finished; `x` is the finished
// state.
struct Course {
    int64_t steps = 0;
    bool failed = false;
    std::vector<double> state, x;

    Course(const StoredFlow& flow, const double* start) : state(size_t(2 * flow.size() + 5)), x(size_t(flow.size())) {
        if (start) std::copy_n(start, x.size(), x.begin());
        std::copy(x.begin(), x.end(), state.begin());
    }

    void require_valid() const {
        if (failed) throw Failure{COADJOINT_FAILED, "the run has failed before; set its state"};
    }

    // Take steps, and save the states after each `every` of them, which divide their number.
    std::vector<double> advance(const StoredFlow& flow, int64_t count, int64_t every) {
        require_valid();
        const int64_t size = flow.size(), points = count / every, end = steps + count;
        std::vector<int64_t> marks(static_cast<size_t>(points));
        for (int64_t k = 0; k < points; ++k) marks[k] = steps + (k + 1) * every;
        std::vector<double> saved(size_t(points * size));
        const Extent extent{1, points, size, 0, 0, 0};
        const Schedule schedule{0.0, flow.step, MOST_STEPS + 1, 1, 0, 0, points, marks.data(), nullptr, nullptr, nullptr, 0, 1};
        const Watch watch{};
        const int64_t outcome = flow_advance(&flow.tables.base, &watch, &only_member, 0, 1, 0, &extent, &schedule,
                                             saved.data(), state.data(), steps, end, &never);
        failed = outcome != 0 || !are_finite(saved.data(), saved.size());
        require_outcome(outcome);
        if (failed)
            throw Failure{COADJOINT_FAILED, "the state is no longer finite, or a flow is too long; take shorter steps"};
        steps = end;
        std::copy_n(saved.end() - size, size, x.begin());
        return saved;
    }
};

}  // namespace

}  // namespace coadjoint

struct coadjoint_run {
    const coadjoint::StoredFlow flow;
    coadjoint::Course course;

    explicit coadjoint_run(const coadjoint::NamedArrays& arrays) : flow(arrays), course(flow, nullptr) {}
};

using namespace coadjoint;

int coadjoint_runs_version(void) { return COADJOINT_RUNS_VERSION; }

const char* coadjoint_message(void) { return message; }

int coadjoint_create(const char* table, size_t length, coadjoint_run** run) {
    return guarded([&] {
        require(run, "the place of the run is null");
        *run = nullptr;
        require(table, "the table is null");
        *run = new coadjoint_run(arrays_of_json(table, length));
    });
}

void coadjoint_destroy(coadjoint_run* run) { delete run; }

size_t coadjoint_size(const coadjoint_run* run) { return run ? size_t(run->flow.size()) : 0; }

double coadjoint_step_length(const coadjoint_run* run) { return run ? run->flow.step : 0.0; }

int64_t coadjoint_steps(const coadjoint_run* run) { return run ? run->course.steps : 0; }

int coadjoint_set_state(coadjoint_run* run, const double* x, size_t size) {
    return guarded([&] {
        require(run && x, "the run or the state is null");
        require(size == coadjoint_size(run), "the state has another size than the run; see coadjoint_size");
        require(are_finite(x, size), "the state is not finite");
        run->course = Course(run->flow, x);
    });
}

int coadjoint_get_state(const coadjoint_run* run, double* x, size_t size) {
    return guarded([&] {
        require(run && x, "the run or the state is null");
        require(size == coadjoint_size(run), "the state has another size than the run; see coadjoint_size");
        run->course.require_valid();
        std::copy_n(run->course.x.begin(), size, x);
    });
}

int coadjoint_step(coadjoint_run* run) { return coadjoint_advance(run, 1); }

int coadjoint_advance(coadjoint_run* run, int64_t steps) {
    return guarded([&] {
        require(run, "the run is null");
        require(steps >= 0 && steps <= MOST_STEPS - run->course.steps, "the steps are negative, or more than 2^53");
        if (steps > 0) run->course.advance(run->flow, steps, steps);
    });
}

int coadjoint_save(coadjoint_run* run, int64_t points, int64_t every, double* saved, size_t capacity) {
    return guarded([&] {
        require(run && (saved || points == 0), "the run or the place of the states is null");
        require(points >= 0 && every > 0, "the points are negative, or their distance is not positive");
        require(points <= (MOST_STEPS - run->course.steps) / every, "the steps are more than 2^53");
        require(uint64_t(points) <= capacity / coadjoint_size(run), "the states do not fit into the capacity");
        for (int64_t now; points > 0; points -= now) {
            now = std::min(points, POINTS_OF_A_CALL);
            const std::vector<double> some = run->course.advance(run->flow, now * every, every);
            saved = std::copy(some.begin(), some.end(), saved);
        }
    });
}

namespace coadjoint {

namespace {

// The arrays of a derivative: vectors, the same after a run, and zeros in place of its other directions.
struct Derived {
    std::vector<double> state, vectors, result, coefficients;

    Derived(const coadjoint_run* run, int64_t steps, const double* x, const double* given, size_t count) {
        require(run && x && (given || count == 0), "the run, the state or the vectors are null");
        require(steps > 0 && steps <= MOST_STEPS, "the steps are not positive, or more than 2^53");
        const size_t size = coadjoint_size(run);
        require(count <= size_t(MOST_NUMBERS) / size, "the vectors are too many");
        require(are_finite(x, size) && are_finite(given, count * size), "the state or a vector is not finite");
        const Terms& terms = run->flow.tables.base.terms;
        const size_t rows = terms.row[terms.size], each = rows + terms.entry[rows] + terms.monomial[terms.size];
        state.assign(x, x + size), state.resize(2 * size);
        vectors.assign(given, given + count * size), result.resize(count * size);
        require(count == 0 || each <= size_t(MOST_NUMBERS) / count, "the vectors are too many");
        coefficients.resize(count * each);
    }

    void require_finite(const std::vector<double>& found, int64_t outcome) const {
        require_outcome(outcome);
        if (!are_finite(found.data(), found.size()))
            throw Failure{COADJOINT_FAILED, "the derivative is not finite; take shorter steps"};
    }
};

}  // namespace

}  // namespace coadjoint

int coadjoint_jvp(const coadjoint_run* run, int64_t steps, double* x, double* vectors, size_t count) {
    return guarded([&] {
        Derived derived(run, steps, x, vectors, count);
        Course course(run->flow, x);
        course.advance(run->flow, steps, steps);
        ForwardRun forward{};
        forward.size = run->flow.size(), forward.members = forward.marked = forward.threads = 1;
        forward.carried = int64_t(count), forward.h = run->flow.step, forward.k1 = steps, forward.marks = &steps;
        forward.momenta = derived.state.data(), forward.errors = forward.momenta + forward.size;
        forward.at_points = derived.result.data(), forward.tangents = derived.vectors.data();
        forward.coefficients = derived.coefficients.data();
        const int64_t outcome = count ? flow_directions(&run->flow.tables, &forward, 0, 1, &never) : 0;
        derived.require_finite(derived.result, outcome);
        std::copy(course.x.begin(), course.x.end(), x);
        std::copy(derived.result.begin(), derived.result.end(), vectors);
    });
}

int coadjoint_vjp(const coadjoint_run* run, int64_t steps, const double* x, double* covector) {
    return guarded([&] {
        Derived derived(run, steps, x, covector, 1);
        require(steps < MOST_NUMBERS / run->flow.size(), "the steps are too many to be stored");
        BackwardRun backward{};
        backward.size = run->flow.size(), backward.members = backward.marked = backward.threads = 1;
        backward.h = run->flow.step, backward.k1 = steps, backward.marks = &steps;
        backward.momenta = derived.state.data(), backward.errors = backward.momenta + backward.size;
        backward.at_points = derived.vectors.data(), backward.cotangents = derived.result.data();
        backward.coefficients = derived.coefficients.data();
        derived.require_finite(derived.result, flow_cotangents(&run->flow.tables, &backward, 0, 1, &never));
        std::copy(derived.result.begin(), derived.result.end(), covector);
    });
}
