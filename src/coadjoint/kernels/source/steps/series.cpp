#include "steps/series.hpp"

namespace coadjoint {

// In `series_with_gradient.cpp`, so that two processors compile them.
extern template void Series<4>::expand_written<false>(int64_t, double);
extern template void Series<8>::expand_written<false>(int64_t, double);

template <int W>
void Series<W>::expand(double h) {
    const int64_t blocks = V == W && field.extended == field.blocks && (W == 8 || field.blocks == 1) ? field.blocks : 0;
    if (field.factored)
        expand_factored(blocks, h);
    else if (field.written_out)
        expand_written<true>(blocks, h);
    else
        expand_written<false>(blocks, h);
}

template void Series<4>::expand(double);
template void Series<8>::expand(double);

}  // namespace coadjoint
