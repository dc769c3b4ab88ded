// Saved steps of a run: every save_every-th and the last, or the marked ones.
#pragma once

#include <algorithm>
#include <limits>

#include "boundary/tables.hpp"

namespace coadjoint {

// The step of a saved point.
inline int64_t step_of(const Schedule& schedule, int64_t slot) {
    const int64_t position = slot + schedule.passed;
    return schedule.marks ? schedule.marks[position] : std::min(position * schedule.save_every, schedule.steps);
}

// Iterator over the saved steps after step k: the next of them, and its index among the saved points.
class SavedSteps {
  public:
    int64_t next, slot;

    SavedSteps(const Schedule& schedule, int64_t k) : schedule(&schedule) {
        const int64_t* marks = schedule.marks;
        slot = (marks ? std::upper_bound(marks, marks + schedule.marked, k) - marks : k / schedule.save_every + 1) -
               schedule.passed;
        find();
    }

    // Return the index of the next one, and advance.
    int64_t take() {
        const int64_t here = slot++;
        find();
        return here;
    }

  private:
    const Schedule* schedule;

    // After the last one, a step that no loop reaches.
    void find() {
        const bool none = schedule->marks && slot + schedule->passed >= schedule->marked;
        next = none ? std::numeric_limits<int64_t>::max() : step_of(*schedule, slot);
    }
};

}  // namespace coadjoint
