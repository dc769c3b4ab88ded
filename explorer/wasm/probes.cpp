// The fused product for tests of it by itself: of the arrays a, b and c, by the function of this folder.
#include "boundary/tables.hpp"

EXPORT double probe_fma(double a, double b, double c) { return explorer::fused(a, b, c); }
