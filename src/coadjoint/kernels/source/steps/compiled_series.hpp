// Classes that several schemes with a series or a projection use: instantiated once, in compiled_series.cpp. Steps of
// users, which are compiled without that file, include the other headers.
#pragma once

#include "numbers/constants.hpp"
#include "steps/group_series.hpp"
#include "steps/projection.hpp"

namespace coadjoint {

// `declared` is `extern`, or empty in compiled_series.cpp.
#define COMPILED_CLASSES(declared, W)                                                                      \
    declared template SeriesField<W>::SeriesField(const Field&, const MemberConstants&, int64_t);          \
    declared template SeriesRows<W, Lanes<NATIVE>>::SeriesRows(const Field&, const MemberConstants&, int64_t); \
    declared template SeriesRows<W, Lanes<NATIVE>>::SeriesRows(const Field&, const LaneConstants&, int64_t);   \
    declared template GroupSeries<W>::GroupSeries(const GroupField&, const MemberConstants&, int64_t);     \
    declared template struct GroupSeries<W>;                                                               \
    declared template struct InvariantRows<W, MemberConstants>;                                            \
    declared template struct Projection<W, MemberConstants>;

#define COMPILED_SERIES(declared)  \
    COMPILED_CLASSES(declared, 4)  \
    COMPILED_CLASSES(declared, 8)

#if !defined(COMPILES_SERIES)
COMPILED_SERIES(extern)
#endif

}  // namespace coadjoint
