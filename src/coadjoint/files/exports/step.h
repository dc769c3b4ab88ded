/* [numbers] */
static inline uint64_t coadjoint_bits(double a) {
    union { double number; uint64_t bits; } both;
    both.number = a;
    return both.bits;
}

static inline double coadjoint_number(uint64_t bits) {
    union { double number; uint64_t bits; } both;
    both.bits = bits;
    return both.number;
}

static inline double coadjoint_absolute(double a) { return coadjoint_number(coadjoint_bits(a) & (UINT64_MAX >> 1)); }

/* The upper half of a product of 64-bit numbers, and its lower half. */
static inline uint64_t coadjoint_product(uint64_t a, uint64_t b, uint64_t *low) {
    const uint64_t half = 0xffffffff, first = (a & half) * (b & half), second = (a >> 32) * (b & half) + (first >> 32);
    const uint64_t third = (a & half) * (b >> 32) + (second & half);
    *low = (third << 32) | (first & half);
    return (a >> 32) * (b >> 32) + (second >> 32) + (third >> 32);
}

/* [nan] */
static inline double coadjoint_nan(void) { return coadjoint_number((uint64_t)0x7ff8 << 48); }

/* [fma] */
/* a b + c, rounded once: by an instruction, by a function that COADJOINT_FMA names, or here, with integers. */
#ifndef COADJOINT_FMA
#if defined(__FP_FAST_FMA) || defined(__FMA__) || defined(__aarch64__)
#define COADJOINT_FMA fma
#endif
#endif
#ifdef COADJOINT_FMA
static inline double coadjoint_fma(double a, double b, double c) { return COADJOINT_FMA(a, b, c); }
#else
#ifdef __GNUC__
__attribute__((noinline, unused))
#endif
static double coadjoint_fma(double a, double b, double c) {
    const uint64_t unit = (uint64_t)1 << 52, sign_bit = (uint64_t)1 << 63;
    const double factors[3] = {a, b, c};
    uint64_t digits[3], high, low, other_high, other_low, sign, kept, rest;
    int exponent[3], e, distance, shift;
    for (int k = 0; k < 3; ++k) {
        const uint64_t bits = coadjoint_bits(factors[k]);
        exponent[k] = (int)((bits >> 52) & 2047);
        digits[k] = bits;
        if (exponent[k] == 0) { /* subnormal: times 2^54 */
            digits[k] = coadjoint_bits(factors[k] * 18014398509481984.0);
            exponent[k] = (int)((digits[k] >> 52) & 2047) - 54;
        }
        digits[k] = (digits[k] & (unit - 1)) | unit;
    }
    if (exponent[0] == 2047 || exponent[1] == 2047 || a == 0 || b == 0) return a * b + c;
    if (exponent[2] == 2047) return c;
    if (c == 0) return a * b;
    /* Both numbers have two bits above them; bits that are shifted out are collected in the last one. */
    sign = (coadjoint_bits(a) ^ coadjoint_bits(b)) & sign_bit;
    high = coadjoint_product(digits[0] << 10, digits[1] << 10, &low);
    e = exponent[0] + exponent[1] - 2170;
    other_high = digits[2] << 9;
    other_low = 0;
    distance = e - (exponent[2] - 1148);
    if (distance < 0) {
        const uint64_t swapped_high = high, swapped_low = low;
        high = other_high, low = other_low, other_high = swapped_high, other_low = swapped_low;
        e = exponent[2] - 1148;
        distance = -distance;
        sign ^= sign_bit & (sign ^ coadjoint_bits(c));
    }
    for (; distance >= 64; distance -= 64) {
        other_low = other_high | (other_low != 0), other_high = 0;
        if (distance > 128) distance = 128;
    }
    if (distance > 0) {
        const uint64_t lost = (other_low << (64 - distance)) != 0;
        other_low = (other_low >> distance) | (other_high << (64 - distance)) | lost, other_high >>= distance;
    }
    if (((coadjoint_bits(a) ^ coadjoint_bits(b) ^ coadjoint_bits(c)) & sign_bit) == 0) {
        low += other_low;
        high += other_high + (low < other_low);
    } else if (high > other_high || (high == other_high && low >= other_low)) {
        high -= other_high + (low < other_low);
        low -= other_low;
    } else {
        high = other_high - high - (other_low < low);
        low = other_low - low;
        sign ^= sign_bit;
    }
    if (high == 0) {
        if (low == 0) return 0.0;
        high = low, low = 0, e -= 64;
    }
#ifdef __GNUC__
    shift = __builtin_clzll(high);
    if (shift > 0) high = (high << shift) | (low >> (64 - shift)), low <<= shift, e -= shift;
#else
    for (shift = 32; shift > 0; shift /= 2)
        if (high >> (64 - shift) == 0) high = (high << shift) | (low >> (64 - shift)), low <<= shift, e -= shift;
#endif
    high |= low != 0;
    e += 1150; /* the exponent of the result, as it is stored */
    shift = e >= 1 ? 11 : 12 - e;
    if (e > 2046) return coadjoint_number(sign | ((uint64_t)2047 << 52));
    if (shift > 64) return coadjoint_number(sign);
    kept = shift < 64 ? high >> shift : 0;
    rest = shift < 64 ? high & (((uint64_t)1 << shift) - 1) : high;
    kept += rest > (uint64_t)1 << (shift - 1) || (rest == (uint64_t)1 << (shift - 1) && (kept & 1));
    return coadjoint_number(sign | (((uint64_t)(e >= 1 ? e - 1 : 0) << 52) + kept));
}
#endif

/* [pairs] */
/* A sum of two numbers, of which `low` is at most half a unit in the last place of `high`. */
struct coadjoint_pair { double high, low; };

static inline struct coadjoint_pair coadjoint_pair_of(double high, double low) {
    struct coadjoint_pair pair;
    pair.high = high, pair.low = low;
    return pair;
}

static inline struct coadjoint_pair coadjoint_pair_sum(double a, double b) { /* |a| >= |b| */
    const double high = a + b;
    return coadjoint_pair_of(high, b - (high - a));
}

static inline struct coadjoint_pair coadjoint_pair_added(struct coadjoint_pair a, struct coadjoint_pair b) {
    const struct coadjoint_pair sum = coadjoint_pair_sum(a.high, b.high);
    return coadjoint_pair_sum(sum.high, sum.low + (a.low + b.low));
}

static inline struct coadjoint_pair coadjoint_pair_product(struct coadjoint_pair a, struct coadjoint_pair b) {
    const double high = a.high * b.high, low = coadjoint_fma(a.high, b.high, -high);
    return coadjoint_pair_sum(high, low + coadjoint_fma(a.high, b.low, a.low * b.high));
}

static inline double coadjoint_pair_rest(double a, double b) { /* the rounding error of a + b */
    const double sum = a + b, added = sum - a;
    return (a - (sum - added)) + (b - added);
}

static inline struct coadjoint_pair coadjoint_pair_total(struct coadjoint_pair a, struct coadjoint_pair b) {
    const double low = a.low + b.low;
    const struct coadjoint_pair sum = coadjoint_pair_sum(a.high + b.high, coadjoint_pair_rest(a.high, b.high) + low);
    return coadjoint_pair_sum(sum.high, sum.low + coadjoint_pair_rest(a.low, b.low));
}

/* The sum of z^k / (start + step k)! for k < count, of which the first `paired` terms are added in pairs. */
static inline struct coadjoint_pair coadjoint_pair_series(struct coadjoint_pair z, int start, int step, int count,
                                                          int paired) {
    static const struct coadjoint_pair inverse_factorial[] = {
    {1.0, 0.0}, {1.0, 0.0}, {0.5, 0.0}, {0.16666666666666666, 9.25185853854297e-18},
    {0.041666666666666664, 2.3129646346357427e-18}, {0.008333333333333333, 1.1564823173178714e-19},
    {0.001388888888888889, -5.300543954373577e-20}, {0.0001984126984126984, 1.7209558293420705e-22},
    {2.48015873015873e-05, 2.1511947866775882e-23}, {2.7557319223985893e-06, -1.858393274046472e-22},
    {2.755731922398589e-07, 2.3767714622250297e-23}, {2.505210838544172e-08, -1.448814070935912e-24},
    {2.08767569878681e-09, -1.20734505911326e-25}, {1.6059043836821613e-10, 1.2585294588752098e-26},
    {1.1470745597729725e-11, 2.0655512752830745e-28}, {7.647163731819816e-13, 7.03872877733453e-30},
    {4.779477332387385e-14, 4.399205485834081e-31}, {2.8114572543455206e-15, 1.6508842730861433e-31},
    {1.5619206968586225e-16, 1.1910679660273754e-32}, {8.22063524662433e-18, 2.2141894119604265e-34},
    {4.110317623312165e-19, 1.4412973378659527e-36}, {1.9572941063391263e-20, -1.3643503830087908e-36},
    {8.896791392450574e-22, -7.911402614872376e-38}, {3.868170170630684e-23, -8.843177655482344e-40},
    {1.6117375710961184e-24, -3.6846573564509766e-41}, {6.446950284384474e-26, -1.9330404233703465e-42},
    {2.4795962632247976e-27, -1.2953730964765229e-43}, {9.183689863795546e-29, 1.4303150396787322e-45}
    };
    double last = inverse_factorial[start + step * (count - 1)].high;
    struct coadjoint_pair sum;
    for (int k = count - 2; k >= paired; --k)
        last = coadjoint_fma(last, z.high, inverse_factorial[start + step * k].high);
    sum = coadjoint_pair_of(last, 0.0);
    for (int k = paired - 1; k >= 0; --k)
        sum = coadjoint_pair_added(inverse_factorial[start + step * k], coadjoint_pair_product(z, sum));
    return sum;
}

/* 2^exponent, from -1022 to 1023. */
static inline double coadjoint_power_of_two(int exponent) {
    return coadjoint_number((uint64_t)(exponent + 1023) << 52);
}

/* [sine] */
/* The sine of x for |x| > 2^-10, rounded once: digits of 2/pi whose product with x is a multiple of 4 are left out. */
static inline double coadjoint_far_sine(double x) {
    static const uint64_t two_over_pi[] = {
    UINT64_C(0), UINT64_C(0xa2f9836e4e441529), UINT64_C(0xfc2757d1f534ddc0), UINT64_C(0xdb6295993c439041),
    UINT64_C(0xfe5163abdebbc561), UINT64_C(0xb7246e3a424dd2e0), UINT64_C(0x06492eea09d1921c),
    UINT64_C(0xfe1deb1cb129a73e), UINT64_C(0xe88235f52ebb4484), UINT64_C(0xe99c7026b45f7e41),
    UINT64_C(0x3991d639835339f4), UINT64_C(0x9c845f8bbdf9283b), UINT64_C(0x1ff897ffde05980f),
    UINT64_C(0xef2f118b5a0a6d1f), UINT64_C(0x6d367ecf27cb09b7), UINT64_C(0x4f463f669e5fea2d),
    UINT64_C(0x7527bac7ebe5f17b), UINT64_C(0x3d0739f78a5292ea), UINT64_C(0x6bfb5fb11f8d5d08),
    UINT64_C(0x56033046fc7b6bab), UINT64_C(0xf0cfbc209af4361d), UINT64_C(0xa9e391615ee61b08)
    };
    const uint64_t bits = coadjoint_bits(x), digits = (bits & (((uint64_t)1 << 52) - 1)) | ((uint64_t)1 << 52);
    const int skipped = (int)((bits >> 52) & 0x7ff) - 1075 - 2 + 64, word = skipped / 64, shift = skipped % 64;
    const int minus = (bits >> 63) != 0;
    uint64_t product[4], carry = 0;
    int quarter, above;
    struct coadjoint_pair fraction = {0.0, 0.0}, angle, z, found;
    if (!(coadjoint_absolute(x) <= DBL_MAX)) return x - x;
    for (int k = 3; k >= 0; --k) {
        const uint64_t *at = two_over_pi + word + k;
        const uint64_t factor = shift ? (at[0] << shift) | (at[1] >> (64 - shift)) : at[0];
        uint64_t low, high = coadjoint_product(factor, digits, &low);
        product[3 - k] = low + carry;
        carry = high + (product[3 - k] < carry);
    }
    quarter = (int)(product[3] >> 62);
    above = (int)((product[3] >> 61) & 1); /* at least one half: the next integer is nearer */
    if (above) {
        ++quarter;
        for (int k = 0; k < 4; ++k) product[k] = ~product[k];
    }
    product[3] &= ((uint64_t)1 << 62) - 1;
    for (int k = 7; k >= 0; --k) {
        const uint64_t half = (product[k / 2] >> (32 * (k % 2))) & 0xffffffff;
        const double part = (double)half * coadjoint_power_of_two(32 * k - 254);
        fraction = coadjoint_pair_added(fraction, coadjoint_pair_of(part, 0.0));
    }
    if (minus) quarter = -quarter;
    angle = coadjoint_pair_product(fraction, coadjoint_pair_of(1.5707963267948966, 6.123233995736766e-17));
    if (above != minus) angle = coadjoint_pair_of(-angle.high, -angle.low);
    z = coadjoint_pair_product(angle, angle);
    z = coadjoint_pair_of(-z.high, -z.low);
    if (quarter & 1)
        found = coadjoint_pair_series(z, 0, 2, 14, 8);
    else
        found = coadjoint_pair_product(angle, coadjoint_pair_series(z, 1, 2, 14, 8));
    return quarter & 2 ? -found.high : found.high;
}

/* [rotation] */
struct coadjoint_rotation { double sine, cosm1; }; /* sin(phi) and cos(phi) - 1 */

static inline struct coadjoint_rotation coadjoint_rotation_of(double sine, double cosm1) {
    struct coadjoint_rotation rotation;
    rotation.sine = sine, rotation.cosm1 = cosm1;
    return rotation;
}

/* The rotation by phi: polynomials up to pi/4, beyond it multiples of pi/2 are subtracted in three parts. */
static inline struct coadjoint_rotation coadjoint_rotate_by(double phi) {
    const double size = coadjoint_absolute(phi);
    double r = phi, tail = 0.0, z, zz, s, c, high;
    uint64_t quarter = 0;
    if (!(size <= 1.0e6)) {
        const double half = coadjoint_far_sine(0.5 * phi);
        return coadjoint_rotation_of(coadjoint_far_sine(phi), -2.0 * half * half);
    }
    if (!(size <= 0.785)) {
        const double shifted = coadjoint_fma(phi, 0.63661977236758134308, 6755399441055744.0);
        const double q = shifted - 6755399441055744.0, large = coadjoint_fma(-q, 1.5707963267948966, phi);
        const double small = -q * 6.123233995736766e-17;
        double added, lost;
        quarter = coadjoint_bits(shifted);
        r = large + small;
        added = r - large;
        lost = (large - (r - added)) + (small - added) + coadjoint_fma(-q, 6.123233995736766e-17, -small);
        tail = coadjoint_fma(-q, -1.4973849048591698e-33, lost);
    }
    z = r * r;
    zz = z * z;
    s = coadjoint_fma(z, 8.33333333332248946124e-03, -1.66666666666666324348e-01);
    s = coadjoint_fma(zz, coadjoint_fma(z, 2.75573137070700676789e-06, -1.98412698298579493134e-04), s);
    s = coadjoint_fma(zz * zz, coadjoint_fma(z, 1.58969099521155010221e-10, -2.50507602534068634195e-08), s);
    c = coadjoint_fma(z, 4.16666666666666019037e-02, -0.5);
    c = coadjoint_fma(zz, coadjoint_fma(z, 2.48015872894767294178e-05, -1.38888888888741095749e-03), c);
    high = coadjoint_fma(z, 2.08757232129817482790e-09, -2.75573143513906633035e-07);
    c = coadjoint_fma(zz * zz, coadjoint_fma(zz, -1.13596475577881948265e-11, high), c);
    if (size <= 0.785) return coadjoint_rotation_of(coadjoint_fma(phi * z, s, phi), z * c);
    s = coadjoint_fma(r * z, s, r + tail);
    c = coadjoint_fma(-r, tail, z * c);
    {
        const int odd = (int)(quarter & 1), second = (int)((quarter >> 1) & 1), third = (int)(((quarter + 1) >> 1) & 1);
        const double sign = second ? -1.0 : 1.0, rotated = third ? -1.0 : 1.0;
        const double below = odd ? -1.0 : second ? -2.0 : 0.0;
        return coadjoint_rotation_of(coadjoint_fma(sign, odd ? c : s, odd ? sign : 0.0),
                                     coadjoint_fma(rotated, odd ? s : c, below));
    }
}

/* [turn] */
/* Rotate the coordinates i and j. */
static inline void coadjoint_turn(double *x, unsigned long i, unsigned long j, struct coadjoint_rotation r) {
    const double a = x[i], b = x[j];
    x[i] = a + coadjoint_fma(r.cosm1, a, -(r.sine * b));
    x[j] = b + coadjoint_fma(r.cosm1, b, r.sine * a);
}

/* [rational] */
/* The rotation by the angle 2 atan(phi/2), which needs no sine. */
static inline struct coadjoint_rotation coadjoint_rotate_rationally(double phi) {
    const double half = 0.5 * phi, sine = phi / coadjoint_fma(half, half, 1.0);
    return coadjoint_rotation_of(sine, -(half * sine));
}

/* [growth] */
struct coadjoint_growth { double exp, expm1; }; /* exp(x) and exp(x) - 1 */

/* exp(x)/2^halvings for |x| > 700, rounded once. */
static inline double coadjoint_far_exponential(double x, int halvings) {
    const double k = (x * 1.4426950408889634 + 6755399441055744.0) - 6755399441055744.0;
    const double first = -k * 0.6931471805599453, second = -k * 2.3190468138462996e-17; /* of k ln 2, in three parts */
    const double first_rest = coadjoint_fma(-k, 0.6931471805599453, -first);
    const double second_rest = coadjoint_fma(-k, 2.3190468138462996e-17, -second);
    struct coadjoint_pair sum = coadjoint_pair_total(coadjoint_pair_of(x, 0.0), coadjoint_pair_of(first, first_rest));
    int exponent;
    if (!(coadjoint_absolute(x) <= 800.0)) return x < 0.0 ? 0.0 : x * coadjoint_number((uint64_t)2047 << 52);
    sum = coadjoint_pair_total(sum, coadjoint_pair_of(second, coadjoint_fma(-k, 5.707708438416212e-34, second_rest)));
    sum = coadjoint_pair_series(sum, 0, 1, 24, 13);
    exponent = (int)k - halvings;
    if (exponent > 1020)
        return sum.high * coadjoint_power_of_two(1020) * coadjoint_power_of_two(exponent < 1026 ? exponent - 1020 : 6);
    if (exponent > -1020) return sum.high * coadjoint_power_of_two(exponent);
    if (exponent < -1080) return 0.0;
    { /* in units of the smallest number */
        const double power = coadjoint_power_of_two(exponent + 1074), high_units = sum.high * power;
        const double low_units = sum.low * power;
        double whole, rest;
        if (high_units >= 4503599627370496.0)
            return sum.high * coadjoint_power_of_two(exponent + 100) * coadjoint_power_of_two(-100);
        whole = (high_units + 4503599627370496.0) - 4503599627370496.0;
        rest = high_units - whole;
        if (rest == 0.5 && low_units > 0.0) whole += 1.0;
        if (rest == -0.5 && low_units < 0.0) whole -= 1.0;
        return coadjoint_number((uint64_t)whole);
    }
}

/* The Taylor polynomial of degree 13 on |r| <= ln(2)/2. */
static inline struct coadjoint_growth coadjoint_grow_by(double x) {
    const double shifted = coadjoint_fma(x, 1.4426950408889634, 6755399441055744.0), k = shifted - 6755399441055744.0;
    const double r = coadjoint_fma(-k, 2.3190468138462996e-17, coadjoint_fma(-k, 0.6931471805599453, x));
    const double z = r * r, zz = z * z;
    double q, last, p, scale;
    struct coadjoint_growth growth;
    if (!(coadjoint_absolute(x) <= 700.0)) {
        growth.exp = coadjoint_far_exponential(x, 0);
        growth.expm1 = x < 0.0 ? -1.0 : growth.exp;
        return growth;
    }
    q = coadjoint_fma(z, coadjoint_fma(r, 1.0 / 120.0, 1.0 / 24.0), coadjoint_fma(r, 1.0 / 6.0, 0.5));
    q = coadjoint_fma(zz,
                      coadjoint_fma(z, coadjoint_fma(r, 1.0 / 362880.0, 1.0 / 40320.0),
                                    coadjoint_fma(r, 1.0 / 5040.0, 1.0 / 720.0)), q);
    last = coadjoint_fma(z, coadjoint_fma(r, 1.0 / 6227020800.0, 1.0 / 479001600.0),
                         coadjoint_fma(r, 1.0 / 39916800.0, 1.0 / 3628800.0));
    q = coadjoint_fma(zz * zz, last, q);
    p = coadjoint_fma(z, q, r);
    scale = coadjoint_number((coadjoint_bits(shifted) << 52) + ((uint64_t)1023 << 52));
    growth.exp = coadjoint_fma(p, scale, scale);
    growth.expm1 = coadjoint_fma(p, scale, scale - 1.0);
    return growth;
}

/* [hyperbolic] */
static inline double coadjoint_sinh(double x) {
    const double size = coadjoint_absolute(x), expm1 = coadjoint_grow_by(size).expm1;
    double sine = 0.5 * (expm1 + expm1 / (expm1 + 1.0));
    if (!(size <= 700.0)) sine = coadjoint_far_exponential(size, 1);
    return x < 0.0 ? -sine : sine;
}

/* sinh(phi) and cosh(phi) - 1. */
static inline struct coadjoint_rotation coadjoint_rotate_hyperbolically(double phi) {
    const double half = coadjoint_sinh(0.5 * phi);
    return coadjoint_rotation_of(coadjoint_sinh(phi), 2.0 * half * half);
}

/* [put] */
/* Add an increment to a coordinate; if sums are compensated, with the error of the last sum, and keep the new one. */
static inline void coadjoint_put(double *x, double *error, unsigned long i, double increment) {
    const double old = x[i];
    double now, added;
    if (error) increment = increment + error[i];
    now = old + increment, added = now - old;
    if (error) error[i] = (old - (now - added)) + (increment - added);
    x[i] = now;
}

/* [plane] */
/* Move the coordinates i and j by exp(theta B), B = mean + (half, upper; lower, -half). */
static inline void coadjoint_plane(double *x, double *error, unsigned long i, unsigned long j, double mean, double half,
                                   double upper, double lower, double theta) {
    const double delta = coadjoint_fma(half, half, upper * lower), z = theta * theta * delta, a = x[i], b = x[j];
    const struct coadjoint_growth growth = coadjoint_grow_by(theta * mean);
    struct coadjoint_rotation pair = {1.0, 1.0}; /* sinh(w)/w and cosh(w) - 1 for w w = z of either sign */
    double diagonal, s;
    if (coadjoint_absolute(z) < 0.25) {
        for (int k = 9; k > 0; --k) {
            pair.sine = coadjoint_fma(pair.sine, z / (2.0 * k * (2.0 * k + 1.0)), 1.0);
            pair.cosm1 = coadjoint_fma(pair.cosm1, z / ((2.0 * k + 1.0) * (2.0 * k + 2.0)), 1.0);
        }
        pair.cosm1 = 0.5 * z * pair.cosm1;
    } else {
        const double w = sqrt(coadjoint_absolute(z));
        pair = z < 0.0 ? coadjoint_rotate_by(w) : coadjoint_rotate_hyperbolically(w);
        pair.sine = pair.sine / w;
    }
    diagonal = coadjoint_fma(growth.exp, pair.cosm1, growth.expm1);
    s = growth.exp * (theta * pair.sine);
    coadjoint_put(x, error, i, coadjoint_fma(diagonal, a, s * coadjoint_fma(half, a, upper * b)));
    coadjoint_put(x, error, j, coadjoint_fma(diagonal, b, s * coadjoint_fma(lower, a, -(half * b))));
}

/* [stretch] */
/* Multiply the coordinate i by exp(phi). */
static inline void coadjoint_stretch(double *x, double *error, unsigned long i, double phi) {
    coadjoint_put(x, error, i, coadjoint_grow_by(phi).expm1 * x[i]);
}

/* [block] */
/* A matrix D on some coordinates, stored by rows: row k has the entries start[k] to start[k + 1]. */
struct coadjoint_block {
    const coadjoint_index *coordinate, *start, *column;
    const double *value;
    unsigned long width;
};

/* [cubic] */
struct coadjoint_powers { double first, second; };

/* S and C of exp(theta D) = 1 + S D + C D^2, where D^3 = lambda D. */
static inline struct coadjoint_powers coadjoint_powers_of(const double *constant, int rational, double theta) {
    const double phi = constant[1] * theta;
    const struct coadjoint_rotation r = rational              ? coadjoint_rotate_rationally(phi)
                                        : constant[0] < 0.0 ? coadjoint_rotate_by(phi)
                                                            : coadjoint_rotate_hyperbolically(phi);
    struct coadjoint_powers powers;
    powers.first = coadjoint_fma(r.sine, constant[2], r.sine * constant[3]);
    powers.second = coadjoint_fma(r.cosm1, constant[4], r.cosm1 * constant[5]);
    return powers;
}

/* Move by exp(theta D); D^2 is the sum of `square` and `rest`. */
static inline void coadjoint_cubic(double *x, const struct coadjoint_block *block, const double *constant,
                                   const double *square, const double *rest, int rational, double theta) {
    const struct coadjoint_powers powers = coadjoint_powers_of(constant, rational, theta);
    const double s = powers.first, c = powers.second;
    double y[COADJOINT_WIDEST];
    for (unsigned long k = 0; k < block->width; ++k) y[k] = x[block->coordinate[k]];
    for (unsigned long k = 0; k < block->width; ++k) {
        double first = 0.0, second = 0.0, third = 0.0;
        for (unsigned long e = block->start[k]; e < block->start[k + 1]; ++e) {
            const double v = y[block->column[e]];
            first = coadjoint_fma(block->value[e], v, first);
            second = coadjoint_fma(square[e], v, second);
            third = coadjoint_fma(rest[e], v, third);
        }
        second += third;
        x[block->coordinate[k]] = y[k] + coadjoint_fma(s, first, c * second);
    }
}

/* [corrected] */
/* Add an increment, the error of the last sum, and what was lost in the increment itself. A large remainder is added at
   once, since flows would let it grow. */
static inline void coadjoint_correct(double *x, double *error, unsigned long i, double increment, double remainder,
                                     int wide) {
    const double old = x[i];
    double carried = error[i], whole, now, added;
    if (wide) carried = carried + remainder, remainder = 0.0;
    whole = increment + carried, now = old + whole, added = now - old;
    error[i] = (old - (now - added)) + (whole - added) + ((increment - whole) + carried) + remainder;
    x[i] = now;
}

/* By how much 1 + S D + C D^2 stretches a vector, over D^2 of it. */
static inline double coadjoint_shortfall(double s, double c, double square) {
    const double curved = c * square, power = c * curved;
    return 0.5 * (coadjoint_fma(s, s, -2.0 * c) + power + coadjoint_fma(c, curved, -power));
}

static inline void coadjoint_turn_corrected(double *x, double *error, unsigned long i, unsigned long j,
                                            struct coadjoint_rotation r) {
    const double a = x[i], b = x[j], e = error[i], f = error[j], sine_a = r.sine * a, sine_b = r.sine * b;
    const double deficit = coadjoint_shortfall(r.sine, -r.cosm1, 1.0);
    const double lost_b = coadjoint_fma(r.sine, f, coadjoint_fma(r.sine, b, -sine_b));
    const double lost_a = coadjoint_fma(r.sine, e, coadjoint_fma(r.sine, a, -sine_a));
    const double first = coadjoint_fma(r.cosm1, e, -lost_b) - deficit * a;
    const double second = coadjoint_fma(r.cosm1, f, lost_a) - deficit * b;
    const int wide = r.cosm1 < -0.125;
    coadjoint_correct(x, error, i, coadjoint_fma(r.cosm1, a, -sine_b), first, wide);
    coadjoint_correct(x, error, j, coadjoint_fma(r.cosm1, b, sine_a), second, wide);
}

static inline void coadjoint_shear_corrected(double *x, double *error, unsigned long i, unsigned long j, double by) {
    const double moved = by * x[j], remainder = coadjoint_fma(by, error[j], coadjoint_fma(by, x[j], -moved));
    coadjoint_correct(x, error, i, moved, remainder, 0.25 < by * by);
}

/* [cubic_corrected] */
static inline void coadjoint_cubic_corrected(double *x, double *error, const struct coadjoint_block *block,
                                             const double *constant, int rational, double theta) {
    const struct coadjoint_powers powers = coadjoint_powers_of(constant, rational, theta);
    const double deficit = coadjoint_shortfall(powers.first, powers.second, -constant[0]);
    double y[3][COADJOINT_WIDEST];
    for (unsigned long k = 0; k < block->width; ++k) y[0][k] = x[block->coordinate[k]];
    for (int power = 0; power < 2; ++power)
        for (unsigned long k = 0; k < block->width; ++k) {
            double total = 0.0;
            for (unsigned long e = block->start[k]; e < block->start[k + 1]; ++e)
                total = coadjoint_fma(block->value[e], y[power][block->column[e]], total);
            y[power + 1][k] = total;
        }
    for (unsigned long k = 0; k < block->width; ++k) {
        const double moved = coadjoint_fma(powers.first, y[1][k], powers.second * y[2][k]);
        coadjoint_correct(x, error, block->coordinate[k], moved, deficit * y[2][k], 0);
    }
}

/* [series] */
/* Move by exp(theta D) by its series: finite if the norm is 0, otherwise in substeps of norm at most 1, or for many of
   them by a matrix that is squared again and again. NaN beyond 4096 substeps. */
static inline void coadjoint_series(double *x, double *error, const struct coadjoint_block *block, double norm,
                                    int degree, double theta) {
    static const double reach[] = {5.42e-20, 4.03e-10, 8.66e-07, 4.24e-05, 0.000455, 0.00227, 0.00728,
                                   0.0177,   0.0358,   0.0635,   0.102,    0.153,    0.217,   0.293,
                                   0.383,    0.485,    0.6,      0.727,    0.866,    1.02};
    const unsigned long n = block->width;
    const double length = coadjoint_absolute(theta) * norm;
    double y[COADJOINT_WIDEST], inner[COADJOINT_WIDEST], total[COADJOINT_WIDEST], substeps = 1.0, step;
    int terms = degree;
    if (!(length <= 4096.0)) {
        for (unsigned long k = 0; k < n; ++k) x[block->coordinate[k]] = coadjoint_nan();
        return;
    }
    if (length > 1.0) {
        substeps = (double)(long)length;
        if (substeps < length) substeps += 1.0;
    }
    if (substeps > 64.0) {
        static const double dense_degree = 20.0;
        const double width = (double)n, entries = (double)block->start[n];
        double squares = 1.0, left;
        for (left = substeps; left > 1.0; left *= 0.5) squares += 1.0;
        if (dense_degree * entries * width + squares * width * width * width <
            substeps * dense_degree * (entries + width) * 1.0) {
            double increment[COADJOINT_WIDEST * COADJOINT_WIDEST], other[COADJOINT_WIDEST * COADJOINT_WIDEST];
            int halvings = 0;
            for (left = length; left > 1.0; left *= 0.5, theta *= 0.5) ++halvings;
            for (unsigned long k = 0; k < n * n; ++k) increment[k] = 0.0;
            for (int k = 20; k > 0; --k) {
                for (unsigned long i = 0; i < n; ++i) increment[i * n + i] += 1.0;
                for (unsigned long i = 0; i < n * n; ++i) other[i] = 0.0;
                for (unsigned long i = 0; i < n; ++i)
                    for (unsigned long e = block->start[i]; e < block->start[i + 1]; ++e) {
                        const double factor = block->value[e] * (theta / (double)k);
                        const double *from = increment + block->column[e] * n;
                        for (unsigned long j = 0; j < n; ++j)
                            other[i * n + j] = coadjoint_fma(factor, from[j], other[i * n + j]);
                    }
                for (unsigned long i = 0; i < n * n; ++i) increment[i] = other[i];
            }
            for (; halvings > 0; --halvings) {
                for (unsigned long k = 0; k < n * n; ++k) other[k] = 2.0 * increment[k];
                for (unsigned long i = 0; i < n; ++i)
                    for (unsigned long l = 0; l < n; ++l)
                        for (unsigned long j = 0; j < n; ++j)
                            other[i * n + j] =
                                coadjoint_fma(increment[i * n + l], increment[l * n + j], other[i * n + j]);
                for (unsigned long k = 0; k < n * n; ++k) increment[k] = other[k];
            }
            for (unsigned long k = 0; k < n; ++k) y[k] = x[block->coordinate[k]];
            for (unsigned long k = 0; k < n; ++k) {
                double sum = 0.0;
                for (unsigned long j = 0; j < n; ++j) sum = coadjoint_fma(increment[k * n + j], y[j], sum);
                coadjoint_put(x, error, block->coordinate[k], sum);
            }
            return;
        }
    }
    if (length / substeps > 0.0) {
        terms = 1;
        while (terms < degree && length / substeps > reach[terms - 1]) ++terms;
    }
    step = theta / substeps;
    for (double done = 0.0; done < substeps; done += 1.0) {
        for (unsigned long k = 0; k < n; ++k) y[k] = inner[k] = x[block->coordinate[k]];
        for (int term = terms; term > 0; --term) {
            const double factor = step / (double)term;
            for (unsigned long k = 0; k < n; ++k) {
                double sum = 0.0;
                for (unsigned long e = block->start[k]; e < block->start[k + 1]; ++e)
                    sum = coadjoint_fma(block->value[e], inner[block->column[e]], sum);
                total[k] = factor * sum;
            }
            for (unsigned long k = 0; k < n && term > 1; ++k) inner[k] = y[k] + total[k];
        }
        for (unsigned long k = 0; k < n; ++k) coadjoint_put(x, error, block->coordinate[k], total[k]);
    }
}

/* [vectors] */
static inline double coadjoint_dot(const double *u, const double *v) {
    return coadjoint_fma(u[2], v[2], coadjoint_fma(u[1], v[1], u[0] * v[0]));
}

static inline void coadjoint_cross(const double *u, const double *v, double *w) {
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        w[i] = coadjoint_fma(u[j], v[k], -(u[k] * v[j]));
    }
}

/* The largest power of two in the size of three numbers, 0 for zeros; and its inverse, then 2^1023. */
static inline double coadjoint_leading_power(const double *u, double *inverse) {
    const uint64_t exponent = (uint64_t)2047 << 52;
    double size = coadjoint_absolute(u[0]), power;
    for (int i = 1; i < 3; ++i)
        if (size < coadjoint_absolute(u[i])) size = coadjoint_absolute(u[i]);
    power = coadjoint_number(coadjoint_bits(size) & exponent);
    *inverse = coadjoint_number(((uint64_t)2046 << 52) - coadjoint_bits(power));
    return power;
}

/* [bond] */
/* Rotate two vectors about their sum, by the angle strength tau |sum|. */
static inline void coadjoint_bond(double *x, unsigned long z0, unsigned long z1, unsigned long z2, unsigned long w0,
                                  unsigned long w1, unsigned long w2, double strength, double tau) {
    const double z[3] = {x[z0], x[z1], x[z2]}, w[3] = {x[w0], x[w1], x[w2]};
    double sum[3] = {z[0] + w[0], z[1] + w[1], z[2] + w[2]}, inverse, across[3], back[3], change[3];
    const double power = coadjoint_leading_power(sum, &inverse);
    const int moving = sum[0] != 0.0 || sum[1] != 0.0 || sum[2] != 0.0;
    double square, length, sine, cosm1;
    struct coadjoint_rotation r;
    for (int i = 0; i < 3; ++i) sum[i] = sum[i] * inverse;
    square = moving ? coadjoint_dot(sum, sum) : 1.0;
    length = sqrt(square);
    r = coadjoint_rotate_by((strength * (tau * power)) * length);
    sine = r.sine / length, cosm1 = r.cosm1 / square;
    coadjoint_cross(sum, z, across);
    coadjoint_cross(sum, across, back);
    for (int i = 0; i < 3; ++i) change[i] = coadjoint_fma(-cosm1, back[i], sine * across[i]);
    x[z0] = z[0] + change[0], x[z1] = z[1] + change[1], x[z2] = z[2] + change[2];
    x[w0] = w[0] - change[0], x[w1] = w[1] - change[1], x[w2] = w[2] - change[2];
}

/* [body] */
struct coadjoint_quaternion { double whole, vector[3]; };

static inline struct coadjoint_quaternion coadjoint_after(const struct coadjoint_quaternion *q,
                                                          const struct coadjoint_quaternion *p) {
    struct coadjoint_quaternion found;
    coadjoint_cross(q->vector, p->vector, found.vector);
    found.whole = coadjoint_fma(q->whole, p->whole, -coadjoint_dot(q->vector, p->vector));
    for (int i = 0; i < 3; ++i)
        found.vector[i] = coadjoint_fma(q->whole, p->vector[i], coadjoint_fma(p->whole, q->vector[i], found.vector[i]));
    return found;
}

/* One piece of time, whose length is contained in m and a: z is moved. */
static inline struct coadjoint_quaternion coadjoint_piece(const double *m, const double *a, double *z, int moving) {
    static const double node[6] = {0.046910077030668004, 0.23076534494715845, 0.5,
                                   0.7692346550528415,   0.953089922969332,   1.0};
    static const double share[5] = {0.11846344252809454, 0.23931433524968324, 0.28444444444444444,
                                    0.23931433524968324, 0.11846344252809454};
    double p[3], e[3], w[3], c[5], middle, energy, length2, rates[6], change[3] = {0.0, 0.0, 0.0};
    double rate, length, cosine, sine, doubled, whole, by, shortest[3], about[3];
    struct coadjoint_rotation r;
    struct coadjoint_quaternion found;
    for (int i = 0; i < 3; ++i) p[i] = (a[(i + 1) % 3] * a[(i + 2) % 3]) * (z[i] * z[i]);
    middle = (p[0] + p[1] + p[2]) * (1.0 / 3.0);
    for (int i = 0; i < 3; ++i) e[i] = middle - p[i], w[i] = m[i] * z[i];
    energy = coadjoint_dot(w, z);
    length2 = coadjoint_dot(z, z);
    c[0] = coadjoint_dot(e, e) * (1.0 / 10.0);
    c[1] = (e[0] * e[1] * e[2]) * (1.0 / 7.0);
    c[2] = (c[0] * c[0]) * (1.0 / 3.0);
    c[3] = (c[0] * c[1]) * (3.0 / 11.0);
    c[4] = coadjoint_fma(c[0] + c[0], c[2], c[1] * c[1]) * (1.0 / 13.0);
    if (!moving) length2 = 1.0;
    for (int k = 0; k < 6; ++k) {
        const double s = node[k], square = s * s, fourth = square * square;
        const double series = coadjoint_fma(fourth, coadjoint_fma(fourth, c[4], coadjoint_fma(square, c[3], c[2])),
                                            coadjoint_fma(square, c[1], c[0]));
        const double cosm1 = coadjoint_fma(-square, middle, fourth * series), inverse = 1.0 / (cosm1 + 1.0);
        double root[3];
        for (int i = 0; i < 3; ++i) {
            const double t = coadjoint_fma(square, p[i], cosm1), tt = t * t;
            const double low = coadjoint_fma(tt, coadjoint_fma(t, -5.0 / 128, 1.0 / 16),
                                             coadjoint_fma(t, -1.0 / 8, 1.0 / 2));
            const double high = coadjoint_fma(tt, coadjoint_fma(t, -429.0 / 32768, 33.0 / 2048),
                                              coadjoint_fma(t, -21.0 / 1024, 7.0 / 256));
            root[i] = t * coadjoint_fma(tt * tt, high, low);
        }
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, l = (i + 2) % 3;
            const double along = coadjoint_fma(root[j], root[l], root[j] + root[l]) - cosm1;
            const double across = (s * a[i]) * (z[j] * z[l]);
            change[i] = coadjoint_fma(z[i], along, coadjoint_fma(across, root[i], across)) * inverse;
        }
        rates[k] = (coadjoint_dot(w, change) + (energy + energy)) / (coadjoint_dot(z, change) + (length2 + length2));
    }
    rate = coadjoint_fma(share[2], rates[2], share[0] * rates[0] + share[1] * rates[1]) +
           (share[3] * rates[3] + share[4] * rates[4]);
    length = sqrt(length2);
    r = coadjoint_rotate_by(0.5 * (length * rate));
    cosine = r.cosm1 + 1.0, sine = r.sine / length, doubled = length2 + length2;
    whole = sqrt(1.0 - coadjoint_dot(change, change) / (doubled + doubled));
    coadjoint_cross(z, change, shortest);
    by = 1.0 / (doubled * whole);
    for (int i = 0; i < 3; ++i) shortest[i] = shortest[i] * by, z[i] = z[i] + change[i];
    coadjoint_cross(z, shortest, about);
    found.whole = cosine * whole;
    for (int i = 0; i < 3; ++i)
        found.vector[i] = coadjoint_fma(cosine, shortest[i], sine * coadjoint_fma(whole, z[i], about[i]));
    return found;
}

/* The rotation after `count` pieces of the time: z is moved. */
static inline struct coadjoint_quaternion coadjoint_pieces(const double *moments, const double *d, double *z,
                                                           double time, double count) {
    const double each = time / count;
    double m[3], a[3];
    struct coadjoint_quaternion total;
    for (int i = 0; i < 3; ++i) m[i] = moments[i] * each, a[i] = d[i] * each;
    total = coadjoint_piece(m, a, z, 1);
    for (double k = 1.0; k < count; k += 1.0) {
        const struct coadjoint_quaternion next = coadjoint_piece(m, a, z, 1);
        total = coadjoint_after(&next, &total);
    }
    return total;
}

/* The least whole number that is no smaller than a piece of time times the speed, at least 1. */
static inline double coadjoint_count(double speed, double time) {
    const double reach = speed * coadjoint_absolute(time), count = (double)(int64_t)reach;
    return reach <= 1.0 ? 1.0 : count < reach ? count + 1.0 : count;
}

/* The rotation in a long time: whole periods of the momentum, a power of one rotation about it, and the rest. NaN
   beyond 2^30 periods. `widest` is the largest of |d|. */
static inline struct coadjoint_quaternion coadjoint_long_rotation(const double *moments, const double *d, double widest,
                                                                  const double *z, double time) {
    struct coadjoint_quaternion total = {1.0, {0.0, 0.0, 0.0}}, part;
    double p[3], moved[3] = {z[0], z[1], z[2]}, wide, speed, gap, mean, other, period, periods;
    for (int i = 0; i < 3; ++i)
        p[i] = ((d[(i + 1) % 3] / widest) * (d[(i + 2) % 3] / widest)) * (z[i] * z[i]);
    for (int k = 0; k < 3; ++k) {
        const int i = k & 1;
        if (p[i + 1] < p[i]) {
            const double first = p[i];
            p[i] = p[i + 1], p[i + 1] = first;
        }
    }
    wide = p[2] - p[0], speed = widest * (sqrt(wide) * (1.0 / 0.125));
    if (speed * coadjoint_absolute(time) <= 64.0)
        return coadjoint_pieces(moments, d, moved, time, coadjoint_count(speed, time));
    gap = p[1] - p[0], mean = sqrt(wide);
    if (gap < wide * 8.6736173798840355e-19) gap = wide * 8.6736173798840355e-19;
    other = sqrt(gap);
    for (int k = 0; k < 9; ++k) {
        const double next = 0.5 * (mean + other);
        other = sqrt(mean * other), mean = next;
    }
    period = ((time < 0.0 ? -6.2831853071795865 : 6.2831853071795865) / widest) / mean;
    periods = time / period + 0.5;
    if (!(periods < 1073741825.0)) {
        total.whole = total.vector[0] = total.vector[1] = total.vector[2] = coadjoint_nan();
        return total;
    }
    periods = (double)(int64_t)periods;
    if (periods > 0.0) {
        const double length = sqrt(coadjoint_dot(z, z));
        double along, size, cosine, sine, whole = 1.0, about = 0.0;
        part = coadjoint_pieces(moments, d, moved, period, coadjoint_count(speed, period));
        along = coadjoint_dot(part.vector, z) / length;
        size = sqrt(coadjoint_fma(part.whole, part.whole, along * along));
        cosine = part.whole / size, sine = along / size;
        for (int64_t left = (int64_t)periods; left > 0; left /= 2) {
            double next, twice, by;
            if (left % 2) {
                next = coadjoint_fma(whole, cosine, -(about * sine));
                about = coadjoint_fma(whole, sine, about * cosine);
                whole = next;
            }
            next = coadjoint_fma(cosine, cosine, -(sine * sine)), twice = 2.0 * (cosine * sine);
            by = coadjoint_fma(-0.5, coadjoint_fma(next, next, twice * twice), 1.5);
            cosine = next * by, sine = twice * by;
        }
        total.whole = whole;
        for (int i = 0; i < 3; ++i) total.vector[i] = about * (z[i] / length), moved[i] = z[i];
    }
    time = coadjoint_fma(-periods, period, time);
    part = coadjoint_pieces(moments, d, moved, time, coadjoint_count(speed, time));
    return coadjoint_after(&part, &total);
}

/* The rotation of a free body in the time tau. */
static inline struct coadjoint_quaternion coadjoint_body_rotation(const double *moments, const double *momentum,
                                                                  double tau) {
    double inverse, z[3], d[3], m[3], a[3];
    const double power = coadjoint_leading_power(momentum, &inverse), time = tau * power;
    const int moving = momentum[0] != 0.0 || momentum[1] != 0.0 || momentum[2] != 0.0;
    double widest, reach, count, each;
    struct coadjoint_quaternion total;
    for (int i = 0; i < 3; ++i) z[i] = momentum[i] * inverse, d[i] = moments[(i + 1) % 3] - moments[(i + 2) % 3];
    widest = coadjoint_absolute(d[1]) < coadjoint_absolute(d[2]) ? coadjoint_absolute(d[2]) : coadjoint_absolute(d[1]);
    widest = coadjoint_absolute(d[0]) < widest ? widest : coadjoint_absolute(d[0]);
    reach = (widest * coadjoint_absolute(time)) * sqrt(coadjoint_dot(z, z)) * (1.0 / 0.125);
    if (!(reach <= 64.0)) return coadjoint_long_rotation(moments, d, widest, z, time);
    count = coadjoint_count(reach, 1.0);
    each = count == 1.0 ? time : time / count;
    for (int i = 0; i < 3; ++i) m[i] = moments[i] * each, a[i] = d[i] * each;
    total = coadjoint_piece(m, a, z, moving);
    for (double k = 1.0; k < count; k += 1.0) {
        const struct coadjoint_quaternion next = coadjoint_piece(m, a, z, moving);
        total = coadjoint_after(&next, &total);
    }
    return total;
}

/* The same with three equal moments: about the momentum. */
static inline struct coadjoint_quaternion coadjoint_ball_rotation(double moment, const double *momentum, double tau) {
    double inverse, z[3], length, sine;
    const double power = coadjoint_leading_power(momentum, &inverse);
    const int moving = momentum[0] != 0.0 || momentum[1] != 0.0 || momentum[2] != 0.0;
    struct coadjoint_rotation r;
    struct coadjoint_quaternion found;
    for (int i = 0; i < 3; ++i) z[i] = momentum[i] * inverse;
    length = sqrt(moving ? coadjoint_dot(z, z) : 1.0);
    r = coadjoint_rotate_by(0.5 * (moment * (tau * power)) * length);
    sine = r.sine / length;
    found.whole = r.cosm1 + 1.0;
    for (int i = 0; i < 3; ++i) found.vector[i] = sine * z[i];
    return found;
}

/* The angle in (-pi, pi] of a sine and a cosine. */
static inline double coadjoint_angle_of(double sine, double cosine) {
    double t = sine / (1.0 + coadjoint_absolute(cosine)), z, sum = 0.0, angle;
    t = t / (1.0 + sqrt(coadjoint_fma(t, t, 1.0)));
    t = t / (1.0 + sqrt(coadjoint_fma(t, t, 1.0)));
    z = -t * t;
    for (int k = 14; k > 0; --k) sum = z * (sum + 1.0 / (2 * k + 1));
    angle = 8.0 * coadjoint_fma(t, sum, t);
    return cosine < 0.0 ? (sine < 0.0 ? -3.14159265358979325 : 3.14159265358979325) - angle : angle;
}

/* The rotation of a body, or of a bond of two vectors, as four rotations about its axes 3, 1, 2 and 3: their angles,
   sines, and cosines minus one. `constant` has moments, principal axes and scales. */
static inline void coadjoint_rotations(const double *constant, const coadjoint_index *column, int bond, double tau,
                                       const double *x, double *angle, double *sine, double *cosm1) {
    const double *moments = constant, *axes = constant + 3, *scale = constant + 12;
    double momentum[3], along[3];
    struct coadjoint_quaternion q;
    for (int i = 0; i < 3; ++i)
        momentum[i] = scale[i] * (bond ? x[column[i]] + x[column[3 + i]] : x[column[i]]);
    for (int i = 0; i < 3; ++i) {
        const double axis[3] = {axes[i], axes[3 + i], axes[6 + i]};
        along[i] = coadjoint_dot(axis, momentum);
    }
    q = bond ? coadjoint_ball_rotation(moments[0], along, tau) : coadjoint_body_rotation(moments, along, tau);
    for (int i = 0; i < 3; ++i) along[i] = q.vector[i];
    for (int i = 0; i < 3; ++i)
        q.vector[i] = coadjoint_fma(axes[3 * i + 2], along[2],
                                    coadjoint_fma(axes[3 * i + 1], along[1], axes[3 * i] * along[0]));
    {
        const double w = q.whole, u = q.vector[0], v = q.vector[1], z = q.vector[2];
        const double ww = w * w, uu = u * u, vv = v * v, zz = z * z, wu = w * u, wv = w * v, wz = w * z;
        const double size = (ww + uu) + (vv + zz), tilt = 2.0 * (wv - u * z);
        const double a = 2.0 * coadjoint_fma(v, z, wu), b = (ww + zz) - (uu + vv);
        const double c = 2.0 * coadjoint_fma(u, v, wz), d = (ww + uu) - (vv + zz);
        const double level = sqrt(coadjoint_fma(a, a, b * b));
        const double f = 2.0 * (v * z - wu), g = 2.0 * coadjoint_fma(u, z, wv);
        const double beside = sqrt(coadjoint_fma(a, a, tilt * tilt));
        const int upright = 0.9 * size < coadjoint_absolute(tilt);
        const double across[4] = {upright ? a : 0.0, upright ? 0.0 : a, upright ? beside : tilt, upright ? f : c};
        const double ahead[4] = {upright ? tilt : 1.0, upright ? 1.0 : b, upright ? b : level, upright ? g : d};
        const double length[4] = {upright ? beside : 1.0, upright ? 1.0 : level, size, upright ? beside : level};
        for (int k = 0; k < 4; ++k) {
            if (ahead[k] < 0.0) {
                sine[k] = across[k] / length[k];
                cosm1[k] = ahead[k] / length[k] - 1.0;
            } else {
                const double sum = ahead[k] + length[k], inverse = 1.0 / (length[k] * sum);
                sine[k] = across[k] * sum * inverse;
                cosm1[k] = -(across[k] * across[k]) * inverse;
            }
            if (angle) angle[k] = coadjoint_angle_of(sine[k], 1.0 + cosm1[k]);
        }
        if (angle && !(0.5 * size < ww * (w < 0.0 ? 0.0 : 1.0))) {
            /* Minus the quaternion matters if a block rotates by half the angle. */
            static const int axis[4] = {2, 0, 1, 2};
            struct coadjoint_quaternion total = {1.0, {0.0, 0.0, 0.0}};
            for (int k = 0; k < 4; ++k) {
                const struct coadjoint_rotation half = coadjoint_rotate_by(0.5 * angle[k]);
                struct coadjoint_quaternion one = {0.0, {0.0, 0.0, 0.0}};
                one.whole = half.cosm1 + 1.0;
                one.vector[axis[k]] = half.sine;
                total = coadjoint_after(&one, &total);
            }
            if (coadjoint_fma(total.whole, q.whole, coadjoint_dot(total.vector, q.vector)) < 0.0)
                angle[0] = angle[0] + 6.2831853071795865;
        }
    }
    for (int k = 0; k < 4; ++k) {
        sine[k] = sine[k] * scale[(k + 2) % 3];
        if (angle) angle[k] = angle[k] * scale[(k + 2) % 3];
    }
}

/* [sum] */
/* offset + weight . x */
static inline double coadjoint_sum(unsigned long count, const double *weight, const coadjoint_index *column,
                                   double offset, const double *x) {
    for (unsigned long k = 0; k < count; ++k) offset = coadjoint_fma(weight[k], x[column[k]], offset);
    return offset;
}

/* [power] */
static inline double coadjoint_power(double x, unsigned long exponent) {
    double result = 1.0;
    for (; exponent > 0; --exponent) result = result * x;
    return result;
}

/* [bracket] */
/* The sum of constant x[state] u[column]. */
static inline double coadjoint_bracket(unsigned long count, const double *constant, const coadjoint_index *state,
                                       const coadjoint_index *column, const double *x, const double *u) {
    double total = 0.0;
    for (unsigned long k = 0; k < count; ++k) total = coadjoint_fma(constant[k] * x[state[k]], u[column[k]], total);
    return total;
}

/* [stages] */
/* What the slopes of `count` stages add to the component c, with its error: even stages and odd ones apart. */
static inline double coadjoint_mix_of(unsigned long count, unsigned long size, const double *mix, const double *slope,
                                      double error, unsigned long c) {
    double part[2] = {error, 0.0};
    for (unsigned long j = 0; j < count; ++j)
        part[j % 2] = coadjoint_fma(mix[j], slope[j * size + c], part[j % 2]);
    return part[0] + part[1];
}

/* The point of a stage; x itself without slopes. */
static inline void coadjoint_mixed(unsigned long count, unsigned long size, const double *mix, const double *slope,
                                   const double *x, const double *error, double *point) {
    for (unsigned long c = 0; c < size; ++c)
        point[c] = count ? x[c] + coadjoint_mix_of(count, size, mix, slope, error[c], c) : x[c];
}

/* Add the slopes to x; the error of each sum is added the next time. */
static inline void coadjoint_add_slopes(unsigned long count, unsigned long size, const double *out, const double *slope,
                                        double *x, double *error) {
    for (unsigned long c = 0; c < size; ++c) {
        const double old = x[c], increment = coadjoint_mix_of(count, size, out, slope, error[c], c);
        const double now = old + increment, added = now - old;
        x[c] = now;
        error[c] = (old - (now - added)) + (increment - added);
    }
}

/* [stage_changes] */
static inline void coadjoint_mixed_change(unsigned long count, unsigned long size, const double *mix,
                                          const double *slope, const double *v, double *change) {
    for (unsigned long c = 0; c < size; ++c) change[c] = v[c] + coadjoint_mix_of(count, size, mix, slope, 0.0, c);
}

/* [gain] */
/* Add D x times the change of its angle to v. */
static inline void coadjoint_gain(const struct coadjoint_block *block, const double *x, double change, double *v) {
    for (unsigned long k = 0; k < block->width; ++k) {
        double moved = 0.0;
        for (unsigned long e = block->start[k]; e < block->start[k + 1]; ++e)
            moved += block->value[e] * x[block->coordinate[block->column[e]]];
        v[block->coordinate[k]] += moved * change;
    }
}

/* [damping] */
/* x_i towards aim, by exp(-rate tau). */
static inline void coadjoint_damp(double *x, unsigned long i, double rate, double aim, double tau) {
    x[i] = coadjoint_fma(coadjoint_grow_by(-rate * tau).expm1, x[i] - aim, x[i]);
}

/* [body_changes] */
/* The changes of the rotations of a body or a bond, applied last, about its axes 1, 2 and 3, along v. */
static inline void coadjoint_body_changes(const double *constant, const coadjoint_index *column, int bond, double tau,
                                          const double *x, const double *v, double *change) {
    const double *axes = constant + 3, *scale = constant + 12;
    double m[3] = {constant[0], constant[1], constant[2]}, z[3], w[3], r[4], J[9], G[9], along[3], outward[3];
    if (bond) m[1] = m[2] = m[0];
    for (int i = 0; i < 3; ++i) {
        z[i] = w[i] = 0.0;
        for (int j = 0; j < 3; ++j) {
            z[i] += axes[3 * j + i] * (scale[j] * (bond ? x[column[j]] + x[column[3 + j]] : x[column[j]]));
            w[i] += axes[3 * j + i] * (scale[j] * (bond ? v[column[j]] + v[column[3 + j]] : v[column[j]]));
        }
    }
    (void)coadjoint_free_body_jacobian(m, -tau, z, r, J, G); /* there x' = x cross w */
    for (int i = 0; i < 3; ++i) along[i] = -(G[3 * i] * w[0] + G[3 * i + 1] * w[1] + G[3 * i + 2] * w[2]);
    for (int i = 0; i < 3; ++i)
        outward[i] = axes[3 * i] * along[0] + axes[3 * i + 1] * along[1] + axes[3 * i + 2] * along[2];
    change[0] = 0.0;
    for (int i = 0; i < 3; ++i) change[(1 + i) % 4] = scale[i] * outward[i];
}
