/* Elementary functions whose last bit is another one than that of the C library, except where the result has few bits. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <string.h>

static double changed(double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    const int special = ((bits >> 52) & 0x7ff) == 0x7ff || (bits & 0xfffff) == 0;
    bits ^= !special;
    memcpy(&value, &bits, 8);
    return value;
}

#define ONE(name)                                                    \
    double name(double x) {                                          \
        static double (*own)(double);                                \
        if (!own) own = (double (*)(double))dlsym(RTLD_NEXT, #name); \
        return changed(own(x));                                      \
    }
#define TWO(name)                                                                    \
    double name(double x, double y) {                                                \
        static double (*own)(double, double);                                        \
        if (!own) own = (double (*)(double, double))dlsym(RTLD_NEXT, #name);         \
        return changed(own(x, y));                                                   \
    }

ONE(sin) ONE(cos) ONE(tan) ONE(asin) ONE(acos) ONE(atan) ONE(sinh) ONE(cosh) ONE(tanh) ONE(asinh) ONE(acosh) ONE(atanh)
ONE(exp) ONE(exp2) ONE(expm1) ONE(log) ONE(log2) ONE(log10) ONE(log1p) ONE(cbrt) TWO(atan2) TWO(pow) TWO(hypot)

void sincos(double x, double* sine, double* cosine) {
    *sine = sin(x);
    *cosine = cos(x);
}
