// Fourier transforms and maps by them that several schemes use: instantiated once, in compiled_transforms.cpp. Steps of
// users, which are compiled without that file, include the other headers.
#pragma once

#include "matrices/stream.hpp"

namespace coadjoint {

// `declared` is `extern`, or empty in compiled_transforms.cpp.
#define COMPILED_TRANSFORMS(declared)           \
    declared template class Fourier<double>;    \
    declared template class Fourier<Eight>;     \
    declared template class Rader<double>;      \
    declared template class Rader<Eight>;       \
    declared template class Circulants<double>; \
    declared template class Circulants<Complex>; \
    declared template class DiagonalMap<double>; \
    declared template class DiagonalMap<Complex>;

#if !defined(COMPILES_TRANSFORMS)
COMPILED_TRANSFORMS(extern)
#endif

}  // namespace coadjoint
