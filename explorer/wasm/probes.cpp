// The fused products for tests of them by themselves.
#include "boundary/tables.hpp"

EXPORT double probe_fma(double a, double b, double c) { return explorer::fused(a, b, c); }

// The first or the second of two numbers side by side, beside ordinary ones.
EXPORT double probe_fma_of_pair(double a, double b, double c, int lane) {
    explorer::Pair one{1.0, 1.0}, two{1.5, 1.5}, three{-2.5, -2.5};
    one[lane] = a, two[lane] = b, three[lane] = c;
    return explorer::fused_pair(one, two, three)[lane];
}
