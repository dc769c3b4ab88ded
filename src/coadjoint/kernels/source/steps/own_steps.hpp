// Schemes that take steps of their own, over the points at which one looks. What is seen at a point is a part of such a
// step, and nothing of it goes back: where and how often one looks changes no bit of what follows.
#pragma once

#include "boundary/hearing.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

constexpr int64_t MOST_OWN_STEPS = int64_t(1) << 24;  // between two looks

struct OwnSteps : StepScheme {
    // What is remembered of a member: where its last step of its own ended, and the length of the one from there.
    struct Base {
        double &since, &rest;  // time from the start of the run, as a sum
        double& length;        // signed
        double *x, *dx, *group, *dgroup;
        double* further;  // what the scheme itself remembers
    };

    // `further`: how many numbers the scheme itself remembers.
    OwnSteps(int64_t size, int64_t square, int64_t further) : size(size), square(square) {
        remembered = HEAD + 2 * (size + square) + further;
    }

    double reached = 0.0;  // how far from the start the last of its steps came

    // Find the state at a point at which one looks, `number` steps of length h after t0, from what is remembered of the
    // member; a run begins at the given state. The loop calls this in place of `step`; it returns a status.
    int64_t reach(double* x, double* dx, double* group, double* dgroup, double t0, int64_t number, double h,
                  Hearing& hearing) {
        const Base base = read(memory);
        if (!(memory[0] == memory[0])) {
            std::fill_n(memory, remembered, 0.0);
            std::copy_n(x, size, base.x), std::copy_n(dx, size, base.dx);
            std::copy_n(group, square, base.group), std::copy_n(dgroup, square, base.dgroup);
            base.length = h;
            if (const int64_t status = begin(base, t0)) return status;
        }
        const double there = double(number) * h, left_out = fma(double(number), h, -there);
        for (int64_t count = 0; count < MOST_OWN_STEPS; ++count) {
            const double ahead = ((there - base.since) - base.rest) + left_out;
            if (std::fabs(ahead) <= std::fabs(base.length)) {
                reached = std::fabs(there);
                return part(base, t0, ahead, x, dx, group, dgroup);
            }
            hearing.after(work);
            // The step is over, whatever comes of it.
            const double length = base.length;
            double since, rest;
            add_owing_rest(base.since, base.rest + length, since, rest);
            reached = std::fabs(since);
            if (const int64_t status = finish(base, t0)) return status;
            base.since = since, base.rest = rest;
            if (const int64_t status = propose(base, t0)) return status;
            if (!(std::fabs(base.length) > UNIT_ROUNDOFF * std::fabs(since))) break;
        }
        residual = base.length;
        return UNDEFINED;
    }

    // One step alone is the motion over it.
    int64_t step(double* x, double* dx, double* group, double* dgroup, double t, double h) override {
        std::vector<double> fresh(remembered, std::numeric_limits<double>::quiet_NaN());
        memory = fresh.data();
        return reach(x, dx, group, dgroup, t, 1, h, Hearing::of_this_call());
    }

  protected:
    const int64_t size, square;

    // Each returns a status. Note what is remembered at the start, and propose the first step; `length` has its sign.
    virtual int64_t begin(const Base& base, double t0) = 0;
    // Set the length of the step from the base.
    virtual int64_t propose(const Base& base, double t0) = 0;
    // Write what the motion is at a time after the base that lies within its step. The base stays as it is.
    virtual int64_t part(const Base& base, double t0, double time, double* x, double* dx, double* group,
                         double* dgroup) = 0;
    // Make the end of the step the base.
    virtual int64_t finish(const Base& base, double t0) = 0;

  private:
    static constexpr int64_t HEAD = 3;

    Base read(double* at) const {
        double *x = at + HEAD, *dx = x + size, *group = dx + size, *dgroup = group + square;
        return {at[0], at[1], at[2], x, dx, group, dgroup, dgroup + square};
    }
};

}  // namespace coadjoint
