// Functions that several loops over steps of programs call: instantiated once, in compiled_rows.cpp. Steps of users, which
// are compiled without that file, include the other headers.
#pragma once

#include "flows/flow_alone.hpp"

namespace coadjoint {

// `declared` is `extern`, or empty in compiled_rows.cpp.
#define COMPILED_ACTIONS(declared, summation, A, V, C)                                                              \
    declared template void act_run<summation>(const Action&, const C&, uint32_t, double, const A*, Vectors<V>);    \
    declared template void act_runs<summation>(const Action&, const C&, uint32_t, double, A, CachedRotation<A>&,   \
                                               Vectors<V>);                                                        \
    declared template void act_apart<summation>(const Action&, const C&, uint32_t, double, const A*,               \
                                                const Vectors<V>&);                                                \
    declared template void act_called<summation>(const Action&, const C&, uint32_t, const Rotations<A>&,           \
                                                 const Vectors<V>&, int64_t);

#define COMPILED_PLANES(declared, summation, A, V)                                                                  \
    declared template void plane<summation>(const A&, const A&, const A&, const A&, const uint32_t*, uint32_t,     \
                                            const A&, const Vectors<V>&);

#define COMPILED_SWEEPS(declared, summation, A, G, C)                                                               \
    declared template void sweep<summation, false>(const FlowTables&, const C&, RowRange,                          \
                                                   const Vectors<A>&, const Vectors<G>&, const A&, double,         \
                                                   AngleWorkspace<A>&);                                            \
    declared template void sweep<summation, true>(const FlowTables&, const C&, RowRange,                           \
                                                  const Vectors<A>&, const Vectors<G>&, const A&, double,          \
                                                  AngleWorkspace<A>&);                                             \
    declared template void rotate_fused<summation>(const FlowTables&, const C&, uint32_t, double,                  \
                                                   const Vectors<A>&, bool);

#define COMPILED_GROUPS(declared, summation, with_group, C)                                                         \
    declared template void sweep_groups<summation, with_group>(                                                    \
        const FlowTables&, const RowsTarget<ManyMembers, ManyMembers, C>* const*, int, RowRange,                   \
        const ManyMembers&, double, AngleWorkspace<ManyMembers>&);

#define COMPILED_ANGLES(declared, A, C)                                                                             \
    declared template void called_rotations(const FlowTables&, const C&, int64_t, const A&, const A*,              \
                                            const Rotations<A>&, int64_t*);                                        \
    declared template void rotate_shares(const FlowTables&, const C&, uint32_t, uint32_t, double, A*);

#define COMPILED_ROWS_OF(declared, A)                                                                               \
    declared template Quaternion<A> CalledBody<A>::rotation(const A*, const A&) const;                             \
    declared template void even_rows(const Terms&, uint32_t, uint32_t, uint32_t, const A*, A*);

#define COMPILED_CHANGES(declared, A, V, C)                                                                         \
    declared template void called_changes(const FlowTables&, const C&, int64_t, double, const A*, const V*,        \
                                          int64_t, V*);

// Members as lanes, of one system or with constants of their own.
#define COMPILED_LANES(declared, C)                                   \
    COMPILED_ACTIONS(declared, PLAIN, ManyMembers, ManyMembers, C)    \
    COMPILED_ACTIONS(declared, CORRECTED, ManyMembers, ManyMembers, C) \
    COMPILED_SWEEPS(declared, PLAIN, ManyMembers, ManyMembers, C)     \
    COMPILED_SWEEPS(declared, CORRECTED, ManyMembers, ManyMembers, C) \
    COMPILED_GROUPS(declared, PLAIN, false, C)                        \
    COMPILED_GROUPS(declared, PLAIN, true, C)                         \
    COMPILED_GROUPS(declared, CORRECTED, false, C)                    \
    COMPILED_GROUPS(declared, CORRECTED, true, C)                     \
    COMPILED_ANGLES(declared, ManyMembers, C)                         \
    COMPILED_CHANGES(declared, ManyMembers, ManyMembers, C)

#define COMPILED_ROWS(declared)                                          \
    COMPILED_PLANES(declared, PLAIN, double, double)                     \
    COMPILED_PLANES(declared, PLAIN, double, GroupRows)                  \
    COMPILED_PLANES(declared, PLAIN, ManyMembers, ManyMembers)           \
    COMPILED_PLANES(declared, CORRECTED, double, double)                 \
    COMPILED_PLANES(declared, CORRECTED, double, GroupRows)              \
    COMPILED_PLANES(declared, CORRECTED, ManyMembers, ManyMembers)       \
    COMPILED_ACTIONS(declared, PLAIN, double, double, SharedConstants)   \
    COMPILED_ACTIONS(declared, PLAIN, double, GroupRows, SharedConstants) \
    COMPILED_ACTIONS(declared, CORRECTED, double, double, SharedConstants) \
    COMPILED_ACTIONS(declared, CORRECTED, double, GroupRows, SharedConstants) \
    COMPILED_SWEEPS(declared, PLAIN, double, GroupRows, SharedConstants) \
    COMPILED_SWEEPS(declared, CORRECTED, double, GroupRows, SharedConstants) \
    COMPILED_ANGLES(declared, double, SharedConstants)                   \
    COMPILED_ROWS_OF(declared, double)                                   \
    COMPILED_ROWS_OF(declared, ManyMembers)                              \
    COMPILED_CHANGES(declared, double, double, SharedConstants)          \
    COMPILED_CHANGES(declared, double, GroupRows, SharedConstants)       \
    COMPILED_LANES(declared, SharedConstants)                            \
    COMPILED_LANES(declared, LaneConstants)                              \
    declared template std::vector<ElementaryFlow<double>> FlowsOfRows<double, SharedConstants>::operator()(RowRange); \
    declared template void derivative_in_registers(const CalledBody<Lanes<NATIVE>>&, double, Lanes<NATIVE>*);

typedef Lanes<MEMBER_LANES> ManyMembers;
#if !defined(COMPILES_ROWS)
COMPILED_ROWS(extern)
#endif

}  // namespace coadjoint
