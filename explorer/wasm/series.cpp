// The Taylor series with all numbers of rows and products read from the tables: the operations of the unrolled cases of
// the library, a tenth of their size.
#include "steps/series.hpp"

namespace coadjoint {

template <int W>
void Series<W>::expand(double h) {
    ProductCache<0> cached(field.products, factors.at, order);
    Newest<0, W> newest(x.at);
    for (int64_t k = 0; k < order; ++k)
        if (field.written_out)
            coefficient<0, true, 0>(cached, newest, k, h);
        else
            coefficient<0, false, 0>(cached, newest, k, h);
}

template void Series<4>::expand(double);
template void Series<8>::expand(double);

}  // namespace coadjoint
