// What Python calls to save the start and to evaluate functions along saved points; the tables as they are laid out.
#include <string>

#include "watching.hpp"

// The members first to last - 1; with a stride their constants stand side by side, those of the first one first.
EXPORT void watch_start(const Watch* watch, const Saves* saves, const Schedule* schedule, const State* state,
                        int64_t first, int64_t last, int64_t stride) {
    std::vector<double> y(watch->longest + 1), room(2 * watch->longest + 2);
    for (int64_t member = first; member < last; ++member) {
        const double* x = state->momenta + member * state->size;
        for (int64_t i = 0; i < watch->size; ++i) {
            const double value =
                stride ? value_of(*watch, Own{stride, member - first}, i, x, schedule->t0, y.data(), room.data())
                       : value_of(*watch, Shared{}, i, x, schedule->t0, y.data(), room.data());
            note_value(*saves, watch->size, i, 0.0, member, 0, 0, 0, value);
        }
        save_state(*saves, member, 0, state->size, x, 0);
        std::copy_n(state->groups + member * state->square, state->square, saves->group + member * state->square);
    }
}

// Fill out (points, members, I) with functions at saved points (points, members, n).
EXPORT void watch_values(const Watch* watch, const double* x, const double* times, int64_t points, int64_t members,
                         int64_t size, double* out) {
    std::vector<double> y(watch->longest + 1), room(2 * watch->longest + 2);
    for (int64_t here = 0; here < points * members; ++here)
        for (int64_t i = 0; i < watch->size; ++i)
            out[here * watch->size + i] = value_of(*watch, Shared{}, i, x + here * size, times[here / members],
                                                   y.data(), room.data());
}

EXPORT const char* table_fields() {
    static const std::string all = std::string(Terms_fields) + Action_fields + FlowTables_fields + Watch_fields +
                                   Saves_fields + Schedule_fields + Report_fields + State_fields + Field_fields +
                                   GroupField_fields + RungeKuttaTables_fields + StepTables_fields + Stepping_fields;
    return all.c_str();
}
