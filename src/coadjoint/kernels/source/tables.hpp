// The tables that the loops read. Their fields, in this order, are told to Python, which fills them by name.
#pragma once

#include <cstdint>

#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

typedef int64_t integer;
typedef double number;
typedef int64_t flag;
typedef uint8_t* bytes;
typedef uint32_t* indices;
typedef int64_t* integers;
typedef double* numbers;

#define DECLARE_FIELD(type, name) type name;
#define DESCRIBE_FIELD(type, name) #type " " #name ";"
#define TABLE(Name, FIELDS)    \
    struct Name {              \
        FIELDS(DECLARE_FIELD)  \
    };                         \
    constexpr char Name##_fields[] = #Name ":" FIELDS(DESCRIBE_FIELD) "\n";

#define TERMS_FIELDS(_)                                                                                              \
    _(integer, size) _(bytes, kind) _(indices, row) _(indices, target) _(numbers, offset) _(indices, entry)         \
    _(indices, column) _(numbers, weight) _(indices, monomial) _(numbers, coefficient) _(indices, factor)           \
    _(indices, factor_row) _(indices, exponent)
TABLE(Terms, TERMS_FIELDS)

#define ACTION_FIELDS(_)                                                                                             \
    _(integer, size) _(indices, run) _(bytes, kind) _(indices, angles) _(indices, repeat) _(indices, angle)          \
    _(indices, place) _(indices, constant) _(indices, width) _(indices, entries) _(indices, degree)                 \
    _(indices, indices) _(numbers, constants)
// The field `indices` has the name of its type.
struct Action {
    integer size;
    uint32_t* run;
    uint8_t* kind;
    uint32_t *angles, *repeat, *angle, *place, *constant, *width, *entries, *degree, *indices;
    double* constants;
};
constexpr char Action_fields[] = "Action:" ACTION_FIELDS(DESCRIBE_FIELD) "\n";

#define FLOW_FIELDS(_)                                                                                               \
    _(integer, longest) _(integers, only) _(bytes, bent) _(numbers, frequency) _(indices, part) _(numbers, tau)      \
    _(numbers, moment) _(indices, section) _(indices, share) _(Terms, terms) _(integers, addresses)                 \
    _(Action, state) _(Action, group) _(flag, compensated)
TABLE(FlowTables, FLOW_FIELDS)

#define WATCH_FIELDS(_)                                                                                              \
    _(integer, size) _(Terms, terms) _(integers, addresses) _(indices, first) _(numbers, constant)                  \
    _(numbers, period) _(integer, longest)
TABLE(Watch, WATCH_FIELDS)

#define SAVES_FIELDS(_)                                                                                              \
    _(integer, members) _(numbers, x) _(numbers, group) _(numbers, values) _(numbers, worst) _(numbers, first)       \
    _(numbers, last)
TABLE(Saves, SAVES_FIELDS)

#define SCHEDULE_FIELDS(_) _(number, t0) _(number, h) _(integer, steps) _(integer, save_every) _(flag, watching)
TABLE(Schedule, SCHEDULE_FIELDS)

#define REPORT_FIELDS(_)                                                                                             \
    _(integers, status) _(integers, step) _(numbers, residual) _(integers, evaluations) _(integers, iterations)
TABLE(Report, REPORT_FIELDS)

#define STATE_FIELDS(_)                                                                                              \
    _(integer, size) _(integer, square) _(numbers, momenta) _(numbers, errors) _(numbers, groups)                   \
    _(numbers, group_errors)
TABLE(State, STATE_FIELDS)

// Where the constants of a table stand: one for all lanes, or one for each member side by side.
struct Shared {
    template <class A>
    static inline __attribute__((always_inline)) A number_at(const double* from, int64_t place) {
        return A(from[place]);
    }
    static inline __attribute__((always_inline)) int64_t address(const int64_t* from, int64_t place, int) {
        return from[place];
    }
};
