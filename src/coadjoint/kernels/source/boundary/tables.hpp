// The tables that the loops read. Their fields, in this order, are told to Python, which fills them by name.
#pragma once

#include <cstdint>

namespace coadjoint {

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

// A function of logarithms, angles and quotients of polynomials: see `field/forms.hpp`.
#define FORMS_FIELDS(_)                                                                                              \
    _(integer, size) _(integers, role) _(numbers, weight) _(integers, first) _(numbers, coefficient)                \
    _(integers, begin) _(integers, coordinate)
TABLE(Forms, FORMS_FIELDS)

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

#define EXTENT_FIELDS(_)                                                                                             \
    _(integer, members) _(integer, points) _(integer, size) _(integer, square) _(integer, invariants)               \
    _(integer, remembered)
TABLE(Extent, EXTENT_FIELDS)

#define SCHEDULE_FIELDS(_) _(number, t0) _(number, h) _(integer, steps) _(integer, save_every) _(flag, watching)
TABLE(Schedule, SCHEDULE_FIELDS)

#define FIELD_FIELDS(_)                                                                                              \
    _(integer, size) _(number, sign) _(indices, first) _(indices, column) _(indices, state) _(numbers, constant)     \
    _(flag, nonlinear) _(integers, structure) _(Terms, terms) _(integers, addresses) _(integer, longest)
TABLE(Field, FIELD_FIELDS)

#define GROUP_FIELD_FIELDS(_)                                                                                        \
    _(integer, size) _(integer, entries) _(indices, element) _(indices, row) _(indices, column) _(numbers, value)
TABLE(GroupField, GROUP_FIELD_FIELDS)

#define RUNGE_KUTTA_FIELDS(_)                                                                                        \
    _(Field, field) _(GroupField, group) _(integer, stages) _(integer, substeps) _(integer, solver)                  \
    _(integer, iterations) _(flag, direct) _(numbers, node) _(numbers, scale) _(numbers, mix) _(numbers, out)        \
    _(numbers, forecast) _(numbers, quadratic) _(integer, band) _(indices, position) _(numbers, fraction)            \
    _(numbers, moment)
TABLE(RungeKuttaTables, RUNGE_KUTTA_FIELDS)

#define STEP_FIELDS(_)                                                                                               \
    _(Field, field) _(integers, values) _(GroupField, group) _(Watch, kept) _(integers, whole) _(numbers, coefficients)
TABLE(StepTables, STEP_FIELDS)

#define STEPPING_FIELDS(_)                                                                                           \
    _(integers, step) _(integer, substeps) _(numbers, fraction) _(numbers, moment) _(StepTables, tables)            \
    _(integer, serial)
TABLE(Stepping, STEPPING_FIELDS)

}  // namespace coadjoint
