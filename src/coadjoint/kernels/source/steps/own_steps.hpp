// Schemes with their own step sizes, evaluated at given points. The state at a point is a partial step, which does not
// affect the own steps: the points change no bit of what follows.
#pragma once

#include "boundary/interrupts.hpp"
#include "steps/step_length.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

// The most own steps within one step of the run, as a power of two. From 2^12 on a motion is abandoned if it has not
// come near the end of the step and does not speed up: at any of these powers, the own steps would have to become eight
// times as long each time their number doubles. So is one whose steps become ever shorter: three times in succession
// a doubled number brought less than SLOWING times the time before, and four times what further doublings would bring
// at this rate does not reach the end.
constexpr int64_t MOST_OWN_STEPS = 24, FIRST_TEST_EXPONENT = 12, EIGHTFOLD = 3, SLOWING_TESTS = 3;
constexpr double MIN_SPEEDUP = 1.125;  // ratio of the longest steps of the second and the first half
constexpr double SLOWING = 1.5, SLOWING_MARGIN = 4.0;

struct OwnSteps : StepScheme {
    // The memory of a member: the end of its last own step, and the length of the next one.
    struct Base {
        double &since, &rest;  // time from the start of the run, as a compensated sum
        double& length;        // signed
        double *x, *dx, *group, *dgroup;
        double* further;  // memory of the scheme itself
    };

    // `further`: size of the memory of the scheme itself.
    OwnSteps(int64_t size, int64_t square, int64_t further) : size(size), square(square) {
        memory_size = HEAD + 2 * (size + square) + further;
    }

    double reached = 0.0;  // the time from the start reached by the last successful own step

    // Compute the state at a point, `number` steps of length h after t0, from the memory of the member; a run begins at
    // the given state. The loop calls this instead of `step`; it returns a status.
    int64_t reach(double* x, double* dx, double* group, double* dgroup, double t0, int64_t number, double h,
                  InterruptCheck& interrupts) {
        const Base base = read(memory);
        held = false;
        if (!(memory[0] == memory[0])) {
            std::fill_n(memory, memory_size, 0.0);
            std::copy_n(x, size, base.x), std::copy_n(dx, size, base.dx);
            std::copy_n(group, square, base.group), std::copy_n(dgroup, square, base.dgroup);
            base.length = h;
            reached = 0.0;
            if (const int64_t status = begin(base, t0)) return status;
        }
        const double there = double(number) * h, product_error = fma(double(number), h, -there);
        StepCount steps(std::fabs(h), base.since);
        while (true) {
            reached = std::fabs(base.since);
            const double ahead = ((there - base.since) - base.rest) + product_error;
            if (std::fabs(ahead) <= std::fabs(base.length)) return part(base, t0, ahead, x, dx, group, dgroup);
            interrupts.after(work);
            const double length = base.length;
            double since, rest;
            two_sum(base.since, base.rest + length, since, rest);
            if (const int64_t status = finish(base, t0)) return status;
            if (!finite(size, base.x) || !finite(square, base.group)) {
                residual = std::numeric_limits<double>::quiet_NaN();
                return OVERFLOWED;
            }
            base.since = since, base.rest = rest;
            reached = std::fabs(since);
            if (const int64_t status = propose(base, t0)) return status;
            if (!(std::fabs(base.length) > UNIT_ROUNDOFF * std::fabs(since))) break;
            if (!steps.count_step(since, length)) break;
        }
        residual = base.length;
        return UNDEFINED;
    }

    // A single step is the motion over it.
    int64_t step(double* x, double* dx, double* group, double* dgroup, double t, double h) override {
        std::vector<double> fresh(memory_size, std::numeric_limits<double>::quiet_NaN());
        memory = fresh.data();
        return reach(x, dx, group, dgroup, t, 1, h, InterruptCheck::of_this_call());
    }

  protected:
    const int64_t size, square;
    bool held = false;  // whether the scheme still has the state of the base, besides the memory

    // Each returns a status. Store the memory at the start, and propose the first step; `length` is signed.
    virtual int64_t begin(const Base& base, double t0) = 0;
    // Set the length of the step from the base.
    virtual int64_t propose(const Base& base, double t0) = 0;
    // Write the state at a time after the base within its step. The base is unchanged.
    virtual int64_t part(const Base& base, double t0, double time, double* x, double* dx, double* group,
                         double* dgroup) = 0;
    // Make the end of the step the base.
    virtual int64_t finish(const Base& base, double t0) = 0;

  private:
    // Numbers before the states in the memory of a member: the time as a compensated sum, and the step.
    static constexpr int64_t HEAD = 3;

    // Number of own steps that end within one step of the run, independent of the points.
    struct StepCount {
        double h, begin, number, longest = 0.0, before = 0.0;  // the longest of the later half, and of the first
        double tested = 0.0, progress = 0.0;                   // time at the last test, and from the one before it
        int64_t count = 0, test_exponent = FIRST_TEST_EXPONENT, slowing = 0;

        StepCount(double h, double since) : h(h), begin(std::fabs(since)), number(std::floor(begin / h)) {}

        // Count a step that ended; return whether the next step of the run is reachable.
        bool count_step(double since, double length) {
            const double there = std::fabs(since);
            if (there >= (number + 1.0) * h) {
                *this = StepCount(h, since);
                return true;
            }
            longest = larger(longest, std::fabs(length));
            if (++count < int64_t(1) << test_exponent) {
                if (2 * count == int64_t(1) << test_exponent) before = longest, longest = 0.0, tested = there;
                return true;
            }
            if (test_exponent == MOST_OWN_STEPS || vanishing(there)) return false;
            const double most =
                (there - begin) * whole_power_of_two(double(EIGHTFOLD * (MOST_OWN_STEPS - test_exponent)));
            const bool unreachable = (number + 1.0) * h - begin > most && longest <= MIN_SPEEDUP * before;
            before = larger(before, longest), longest = 0.0;
            ++test_exponent;
            return !unreachable;
        }

        // Test at a doubled number of steps whether the end is out of reach, since the steps become ever shorter.
        bool vanishing(double there) {
            const double made = there - tested, ratio = made / progress;
            slowing = progress > 0.0 && ratio < SLOWING ? slowing + 1 : 0;
            tested = there, progress = made;
            if (slowing < SLOWING_TESTS) return false;
            double ahead = 0.0, next = made;
            for (int64_t exponent = test_exponent; exponent < MOST_OWN_STEPS; ++exponent) next *= ratio, ahead += next;
            return (number + 1.0) * h - there > SLOWING_MARGIN * ahead;
        }
    };

    Base read(double* at) const {
        double *x = at + HEAD, *dx = x + size, *group = dx + size, *dgroup = group + square;
        return {at[0], at[1], at[2], x, dx, group, dgroup, dgroup + square};
    }
};

}  // namespace coadjoint
