// Convolutions of vectors on cells with tensors by Fourier transforms: fields and energies of dipoles.
//
// Axis c is transformed first: two real rows are a complex one, and eight of these are lanes. From then on waves of c are
// lanes, of which the first half is enough; axes b and a follow. Where an axis is open, rows beyond its cells are zero and
// not transformed. The third transform, the product with the tensors, and its inverse are done line by line in the cache.
// Of few rows, such as those of a chain, lanes are eight subsequences of a row in place of eight rows.
#include <memory>

#include "boundary/interrupts.hpp"
#include "field/terms.hpp"
#include "matrices/compiled_transforms.hpp"

namespace coadjoint {
namespace {

typedef ComplexNumber<Eight> Waves;
constexpr int64_t WORK_OF_A_WAVE = 64;  // multiplications for the vectors of a site
constexpr int64_t LANES = SIDE_BY_SIDE, ROWS = 2 * LANES;  // rows that are transformed together
constexpr int64_t FEW_ROWS = 6, LEAST_ROW = 64;  // three transforms of a row alone take less than one of sixteen rows

struct Shape {
    int64_t cells[3], lengths[3], fields;  // axes a, b and c
    explicit Shape(const CellConvolution& table) : fields(3 * table.sites) {
        std::copy_n(table.sizes, 3, cells);
        std::copy_n(table.padded, 3, lengths);
    }
    bool operator==(const Shape& other) const {
        return fields == other.fields && std::equal(cells, cells + 3, other.cells) &&
               std::equal(lengths, lengths + 3, other.lengths);
    }
    int64_t groups() const { return lengths[2] / 2 / LANES + 1; }  // of waves of c
    int64_t rows() const { return (cells[1] * fields + ROWS - 1) / ROWS * ROWS; }
    bool alone() const { return cells[1] * fields <= FEW_ROWS && lengths[2] >= LEAST_ROW && lengths[2] % LANES == 0; }
};

// Eight lanes of eight numbers, as eight numbers of eight lanes; the next number is `stride` doubles behind.
INLINE void transpose_numbers(const double* from, int64_t from_stride, double* to, int64_t stride) {
#if defined(__AVX512F__)
    __m512d rows[LANES], pairs[LANES], fours[LANES];
    for (int64_t i = 0; i < LANES; ++i) rows[i] = _mm512_loadu_pd(from + i * from_stride);
    for (int64_t i = 0; i < LANES; i += 2) {
        pairs[i] = _mm512_unpacklo_pd(rows[i], rows[i + 1]);
        pairs[i + 1] = _mm512_unpackhi_pd(rows[i], rows[i + 1]);
    }
    for (int64_t i = 0; i < LANES; i += 4)
        for (int64_t odd = 0; odd < 2; ++odd) {
            fours[i + odd] = _mm512_shuffle_f64x2(pairs[i + odd], pairs[i + 2 + odd], 0x88);
            fours[i + 2 + odd] = _mm512_shuffle_f64x2(pairs[i + odd], pairs[i + 2 + odd], 0xdd);
        }
    for (int64_t i = 0; i < LANES / 2; ++i) {
        _mm512_storeu_pd(to + i * stride, _mm512_shuffle_f64x2(fours[i], fours[i + 4], 0x88));
        _mm512_storeu_pd(to + (i + 4) * stride, _mm512_shuffle_f64x2(fours[i], fours[i + 4], 0xdd));
    }
#else
    for (int64_t i = 0; i < LANES; ++i)
        for (int64_t lane = 0; lane < LANES; ++lane) to[lane * stride + i] = from[i * from_stride + lane];
#endif
}
INLINE void transpose(const Waves* from, int64_t from_stride, Waves* to, int64_t stride) {
    for (int64_t part = 0; part < ROWS; part += LANES)
        transpose_numbers(numbers_of(*from) + part, ROWS * from_stride, numbers_of(*to) + part, ROWS * stride);
}

// The transform of one complex row of a multiple n of eight numbers: lanes are those of every eighth number, whose
// transforms are joined by eight terms each.
struct RowTransform {
    const int64_t n, part;
    Fourier<Eight> subsequences;
    AlignedArray<Waves> roots;
    AlignedArray<double> re, im;  // the numbers, and after the transform its result

    explicit RowTransform(int64_t n)
        : n(n), part(n / LANES), subsequences(std::max<int64_t>(part, 1)), roots(part), re(n), im(n) {
        const auto all = roots_of_unity(std::max<int64_t>(n, 1));
        for (int64_t k = 0; k < part; ++k)
            for (int64_t lane = 0; lane < LANES; ++lane) {
                const ComplexNumber<double>& root = all[lane * k % n];
                numbers_of(roots.at[k])[lane] = root.re;
                numbers_of(roots.at[k])[LANES + lane] = -root.im;
            }
    }
    RowTransform(const RowTransform& other)
        : n(other.n), part(other.part), subsequences(other.subsequences), roots(part), re(n), im(n) {
        std::copy_n(other.roots.at, part, roots.at);
    }

    void transform() {
        Waves* x = subsequences.input();
        for (int64_t k = 0; k < part; ++k) x[k] = {load<Eight>(re.at + k * LANES), load<Eight>(im.at + k * LANES)};
        x = subsequences.transform(x);
        for (int64_t first = 0; first < part; first += LANES) {
            Waves turned[LANES], terms[LANES], sums[LANES];
            for (int64_t j = 0; j < LANES; ++j) {
                const Waves &z = x[std::min(first + j, part - 1)], &root = roots.at[std::min(first + j, part - 1)];
                turned[j] = z.times(root.re, root.im);
            }
            transpose(turned, 1, terms, 1);
            sum_of_eight(terms, sums);
            const int64_t count = std::min(LANES, part - first);
            for (int64_t p = 0; p < LANES; ++p) {
                double *const real = re.at + first + p * part, *const imaginary = im.at + first + p * part;
                if (count == LANES) {
                    store(real, sums[p].re);
                    store(imaginary, sums[p].im);
                } else {
                    std::copy_n(numbers_of(sums[p]), count, real);
                    std::copy_n(numbers_of(sums[p]) + LANES, count, imaginary);
                }
            }
        }
    }

  private:
    // x - i y
    static INLINE Waves turned_back(const Waves& x, const Waves& y) { return {x.re + y.im, x.im - y.re}; }
    static INLINE void sum_of_four(const Waves& a, const Waves& b, const Waves& c, const Waves& d, Waves* y) {
        const Waves even = a + c, odd = b + d, e = a - c, o = b - d;
        y[0] = even + odd;
        y[1] = turned_back(e, o);
        y[2] = even - odd;
        y[3] = {e.re - o.im, e.im + o.re};
    }
    static INLINE void sum_of_eight(const Waves* x, Waves* y) {
        const Eight half(0x1.6a09e667f3bcdp-1);  // the root of 1/2
        Waves even[4], odd[4];
        sum_of_four(x[0], x[2], x[4], x[6], even);
        sum_of_four(x[1], x[3], x[5], x[7], odd);
        odd[1] = {half * (odd[1].re + odd[1].im), half * (odd[1].im - odd[1].re)};
        odd[2] = {odd[2].im, -odd[2].re};
        odd[3] = {half * (odd[3].im - odd[3].re), -(half * (odd[3].re + odd[3].im))};
        for (int64_t p = 0; p < 4; ++p) {
            y[p] = even[p] + odd[p];
            y[p + 4] = even[p] - odd[p];
        }
    }
};

// The transforms of one thread. `slab` holds the rows of one a, (b, field), by groups of waves of c; `lines` and `spare`
// those of a for every field, `products` one wave of each.
struct LineTransforms {
    const Shape shape;
    Fourier<Eight> a, b, c;
    RowTransform row;
    AlignedArray<Waves> slab, lines, spare, products;
    std::vector<Waves*> transformed;

    explicit LineTransforms(const Shape& shape)
        : LineTransforms(shape, Fourier<Eight>(shape.lengths[0]), Fourier<Eight>(shape.lengths[1]),
                         Fourier<Eight>(shape.alone() ? 1 : shape.lengths[2]),
                         RowTransform(shape.alone() ? shape.lengths[2] : 0)) {}
    LineTransforms(const LineTransforms& other) : LineTransforms(other.shape, other.a, other.b, other.c, other.row) {}

  private:
    LineTransforms(const Shape& shape, const Fourier<Eight>& a, const Fourier<Eight>& b, const Fourier<Eight>& c,
                   const RowTransform& row)
        : shape(shape), a(a), b(b), c(c), row(row), slab(shape.rows() * shape.groups()), lines(shape.fields * shape.lengths[0]),
          spare(shape.fields * shape.lengths[0]), products(shape.fields), transformed(shape.fields) {}
};

class CellTransforms {
  public:
    explicit CellTransforms(const CellConvolution& table)
        : shape(table), groups(shape.groups()), lines(shape),
          waves(shape.lengths[1] * shape.cells[0] * shape.fields * groups),
          cells(shape.cells[0] * shape.cells[1] * shape.cells[2] * shape.fields) {}

    bool fits(const CellConvolution& table) const { return shape == Shape(table); }

    void convolve(const CellConvolution& table, const double* y, double* out) {
        const bool direct = !table.placed && !table.scaled;
        if (!direct) place(table, y);
        const double* from = direct ? y : cells.at;
        each(shape.cells[0], [&](LineTransforms& own, int64_t a) { forward(table, from, a, own); });
        each(shape.lengths[1] * groups, [&](LineTransforms& own, int64_t line) { multiply(table, line, own); });
        double* const to = direct && !table.summed ? out : cells.at;
        each(shape.cells[0], [&](LineTransforms& own, int64_t a) { backward(table, a, own, to); });
        if (table.summed)
            *out = half_product(table, y);
        else if (!direct)
            for (int64_t i = 0; i < table.vectors; ++i)
                for (int64_t k = 0; k < 3; ++k) out[3 * i + k] = value_of(table, i, k);
    }

  private:
    const Shape shape;
    const int64_t groups;
    LineTransforms lines;
    AlignedArray<Waves> waves;  // (waves of b, groups of waves of c, a, field)
    AlignedArray<double> cells;

    template <class Visit>
    void each(int64_t count, const Visit& visit) {
        if (shape.cells[0] * shape.cells[1] * shape.cells[2] * shape.fields >= LEAST_SHARED)
            return share_with_copies(lines, count, visit);
        for (int64_t i = 0; i < count; ++i) visit(lines, i);
    }

    // Those of row i of a slab: of a field and a group.
    INLINE Waves* wave(int64_t b, int64_t i, int64_t a) const {
        return waves.at + ((b * groups + i % groups) * shape.cells[0] + a) * shape.fields + i / groups;
    }
    static int64_t place_of(const CellConvolution& table, int64_t i) { return table.placed ? table.place[i] : i; }
    double value_of(const CellConvolution& table, int64_t i, int64_t k) const {
        const double value = cells.at[3 * place_of(table, i) + k];
        return table.scaled ? table.factor[i] * value : value;
    }

    // Vectors that are not there are zero.
    void place(const CellConvolution& table, const double* y) {
        std::fill_n(cells.at, shape.cells[0] * shape.cells[1] * shape.cells[2] * shape.fields, 0.0);
        for (int64_t i = 0; i < table.vectors; ++i)
            for (int64_t k = 0; k < 3; ++k)
                cells.at[3 * place_of(table, i) + k] = table.scaled ? table.factor[i] * y[3 * i + k] : y[3 * i + k];
    }

    double half_product(const CellConvolution& table, const double* y) const {
        return 0.5 * shared_sum<double>(table.vectors, [&](int64_t first, int64_t last) {
            double sum = 0.0;
            for (int64_t i = first; i < last; ++i)
                for (int64_t k = 0; k < 3; ++k) sum = fma(y[3 * i + k], value_of(table, i, k), sum);
            return sum;
        });
    }

    // Where the first number of sixteen rows of one a is, of row `first` and the next ones; the last one fills the others.
    void find_rows(const CellConvolution& table, int64_t a, int64_t first, int64_t* at) const {
        for (int64_t lane = 0; lane < ROWS; ++lane) {
            const int64_t row = std::min(first + lane, shape.cells[1] * shape.fields - 1);
            at[lane] = a * table.steps[0] + row / shape.fields * table.steps[1] + row % shape.fields;
        }
    }

    // Two real rows are a complex one; the last one may be alone.
    void forward_alone(const CellConvolution& table, const double* from, int64_t a, LineTransforms& own) {
        const int64_t n = shape.cells[2], length = shape.lengths[2], rows = shape.cells[1] * shape.fields;
        double *const re = own.row.re.at, *const im = own.row.im.at;
        int64_t at[ROWS];
        find_rows(table, a, 0, at);
        for (int64_t row = 0; row < rows; row += 2) {
            const bool both = row + 1 < rows;
            for (int64_t k = 0; k < n; ++k) {
                re[k] = from[at[row] + k * table.steps[2]];
                im[k] = both ? from[at[row + 1] + k * table.steps[2]] : 0.0;
            }
            std::fill(re + n, re + length, 0.0);
            std::fill(im + n, im + length, 0.0);
            own.row.transform();
            double* const first = numbers_of(own.slab.at[row * groups]);
            double* const second = numbers_of(own.slab.at[(row + both) * groups]);
            for (int64_t g = 0; g < groups; ++g)
                for (int64_t j = 0; j < LANES; ++j) {
                    const int64_t k = std::min(g * LANES + j, length / 2), mirrored = k ? length - k : 0, w = g * ROWS + j;
                    second[w] = im[k] + im[mirrored];
                    second[w + LANES] = re[mirrored] - re[k];
                    first[w] = re[k] + re[mirrored];
                    first[w + LANES] = im[k] - im[mirrored];
                }
        }
    }

    void backward_alone(const CellConvolution& table, int64_t a, LineTransforms& own, double* to) {
        const int64_t n = shape.cells[2], length = shape.lengths[2], rows = shape.cells[1] * shape.fields;
        double *const re = own.row.re.at, *const im = own.row.im.at;
        int64_t at[ROWS];
        find_rows(table, a, 0, at);
        for (int64_t row = 0; row < rows; row += 2) {
            const bool both = row + 1 < rows;
            const double* const first = numbers_of(own.slab.at[row * groups]);
            const double* const second = numbers_of(own.slab.at[(row + both) * groups]);
            const double part = both ? 1.0 : 0.0;
            for (int64_t k = 0; 2 * k <= length; ++k) {
                const int64_t w = k / LANES * ROWS + k % LANES, mirrored = k ? length - k : 0;
                const double real = part * second[w], imaginary = part * second[w + LANES];
                re[mirrored] = imaginary - first[w];
                im[mirrored] = first[w + LANES] + real;
                re[k] = first[w] + imaginary;
                im[k] = first[w + LANES] - real;
            }
            own.row.transform();
            for (int64_t k = 0; k < n; ++k) {
                to[at[row] + k * table.steps[2]] = table.strength * im[k];
                if (both) to[at[row + 1] + k * table.steps[2]] = table.strength * re[k];
            }
        }
    }

    void forward(const CellConvolution& table, const double* from, int64_t a, LineTransforms& own) {
        const int64_t n = shape.cells[2], length = shape.lengths[2], fields = shape.fields;
        if (shape.alone()) forward_alone(table, from, a, own);
        for (int64_t row = 0; row < shape.rows() && !shape.alone(); row += ROWS) {
            int64_t at[ROWS];
            find_rows(table, a, row, at);
            Waves* x = own.c.input();
            if (at[ROWS - 1] == at[0] + ROWS - 1)
                for (int64_t k = 0; k < n; ++k) {
                    const double* here = from + at[0] + k * table.steps[2];
                    x[k] = {load<Eight>(here), load<Eight>(here + LANES)};
                }
            else
                for (int64_t k = 0; k < n; ++k)
                    for (int64_t lane = 0; lane < ROWS; ++lane)
                        numbers_of(x[k])[lane] = from[at[lane] + k * table.steps[2]];
            for (int64_t k = n; k < length; ++k) x[k] = {Eight(0.0), Eight(0.0)};
            x = own.c.transform(x);
            for (int64_t g = 0; g < groups; ++g) {
                Waves first[LANES], second[LANES];
                for (int64_t j = 0; j < LANES; ++j) {
                    const int64_t k = std::min(g * LANES + j, length / 2);
                    const Waves &z = x[k], &mirrored = x[k ? length - k : 0];
                    first[j] = {z.re + mirrored.re, z.im - mirrored.im};
                    second[j] = {z.im + mirrored.im, mirrored.re - z.re};
                }
                transpose(first, 1, own.slab.at + row * groups + g, groups);
                transpose(second, 1, own.slab.at + (row + LANES) * groups + g, groups);
            }
        }
        const int64_t stride = fields * groups;
        for (int64_t i = 0; i < stride; ++i) {
            Waves* x = own.b.input();
            for (int64_t b = 0; b < shape.cells[1]; ++b) x[b] = own.slab.at[b * stride + i];
            for (int64_t b = shape.cells[1]; b < shape.lengths[1]; ++b) x[b] = {Eight(0.0), Eight(0.0)};
            x = own.b.transform(x);
            for (int64_t b = 0; b < shape.lengths[1]; ++b) *wave(b, i, a) = x[b];
        }
    }

    // From here on real and imaginary parts are exchanged: forward transforms are then inverse ones.
    void multiply(const CellConvolution& table, int64_t line, LineTransforms& own) {
        const int64_t n = shape.cells[0], length = shape.lengths[0], fields = shape.fields;
        Waves* const at = waves.at + line * n * fields;
        Waves** const transformed = own.transformed.data();
        for (int64_t f = 0; f < fields; ++f) {
            Waves* x = own.lines.at + f * length;
            for (int64_t a = 0; a < n; ++a) x[a] = at[a * fields + f];
            for (int64_t a = n; a < length; ++a) x[a] = {Eight(0.0), Eight(0.0)};
            transformed[f] = own.a.transform(x, own.spare.at + f * length);
        }
        const int64_t entries = fields * (fields + 1) / 2 * (table.sites > 1 ? 2 : 1);
        const double* tensor = table.tensors + line * length * entries * LANES;
        for (int64_t k = 0; k < length; ++k, tensor += entries * LANES)
            if (table.sites > 1)
                hermitian_product(tensor, transformed, k, own.products.at);
            else
                symmetric_product(tensor, transformed, k);
        for (int64_t f = 0; f < fields; ++f) {
            Waves* const x = transformed[f];
            Waves* const spare = (x == own.lines.at + f * length ? own.spare.at : own.lines.at) + f * length;
            const Waves* const found = own.a.transform(x, spare);
            for (int64_t a = 0; a < n; ++a) at[a * fields + f] = found[a];
        }
    }

    static INLINE void symmetric_product(const double* tensor, Waves* const* waves, int64_t k) {
        Waves &x = waves[0][k], &y = waves[1][k], &z = waves[2][k];
        Eight entry[6];
        for (int64_t e = 0; e < 6; ++e) entry[e] = load<Eight>(tensor + e * LANES);
        const auto row = [&](const Eight& p, const Eight& q, const Eight& r) __attribute__((always_inline)) {
            return Waves{fma(p, x.im, fma(q, y.im, r * z.im)), fma(p, x.re, fma(q, y.re, r * z.re))};
        };
        const Waves first = row(entry[0], entry[1], entry[2]), second = row(entry[1], entry[3], entry[4]);
        z = row(entry[2], entry[4], entry[5]);
        x = first;
        y = second;
    }

    void hermitian_product(const double* tensor, Waves* const* waves, int64_t k, Waves* sums) const {
        for (int64_t f = 0; f < shape.fields; ++f) sums[f] = {Eight(0.0), Eight(0.0)};
        for (int64_t i = 0; i < shape.fields; ++i)
            for (int64_t j = i; j < shape.fields; ++j, tensor += 2 * LANES) {
                const Eight c = load<Eight>(tensor), s = load<Eight>(tensor + LANES);
                sums[i] = sums[i] + waves[j][k].times(c, s);
                if (j > i) sums[j] = sums[j] + waves[i][k].times(c, -s);
            }
        for (int64_t f = 0; f < shape.fields; ++f) waves[f][k] = {sums[f].im, sums[f].re};
    }

    void backward(const CellConvolution& table, int64_t a, LineTransforms& own, double* to) {
        const int64_t n = shape.cells[2], length = shape.lengths[2], stride = shape.fields * groups;
        for (int64_t i = 0; i < stride; ++i) {
            Waves* x = own.b.input();
            for (int64_t b = 0; b < shape.lengths[1]; ++b) x[b] = *wave(b, i, a);
            x = own.b.transform(x);
            for (int64_t b = 0; b < shape.cells[1]; ++b) own.slab.at[b * stride + i] = x[b];
        }
        std::fill(own.slab.at + shape.cells[1] * stride, own.slab.at + shape.rows() * groups,
                  Waves{Eight(0.0), Eight(0.0)});
        if (shape.alone()) return backward_alone(table, a, own, to);
        const Eight strength(table.strength);
        for (int64_t row = 0; row < shape.rows(); row += ROWS) {
            int64_t at[ROWS];
            find_rows(table, a, row, at);
            Waves* x = own.c.input();
            for (int64_t g = 0; g < groups; ++g) {
                Waves first[LANES], second[LANES];
                transpose(own.slab.at + row * groups + g, groups, first, 1);
                transpose(own.slab.at + (row + LANES) * groups + g, groups, second, 1);
                for (int64_t j = 0; j < LANES && g * LANES + j <= length / 2; ++j) {
                    const int64_t k = g * LANES + j;
                    x[k] = {first[j].re + second[j].im, first[j].im - second[j].re};
                    if (k && 2 * k < length) x[length - k] = {second[j].im - first[j].re, first[j].im + second[j].re};
                }
            }
            x = own.c.transform(x);
            const int64_t rows = std::min(ROWS, shape.cells[1] * shape.fields - row);
            for (int64_t k = 0; k < n; ++k) {
                const Waves exchanged{strength * x[k].im, strength * x[k].re};
                if (at[ROWS - 1] == at[0] + ROWS - 1)
                    std::copy_n(numbers_of(exchanged), ROWS, to + at[0] + k * table.steps[2]);
                else
                    for (int64_t lane = 0; lane < rows; ++lane)
                        to[at[lane] + k * table.steps[2]] = numbers_of(exchanged)[lane];
            }
        }
    }
};

}  // namespace

EXPORT void convolve_cells(const TableFunction& function, const double* y, double* out) {
    const CellConvolution& table = reinterpret_cast<const CellConvolution&>(function);
    InterruptCheck::of_this_call().after(WORK_OF_A_WAVE * table.padded[0] * table.padded[1] * table.padded[2] * table.sites);
    // Kept for the next call, by each thread.
    static thread_local std::unique_ptr<CellTransforms> known;
    if (!known || !known->fits(table)) {
        known.reset();
        known = std::make_unique<CellTransforms>(table);
    }
    known->convolve(table, y, out);
}

}  // namespace coadjoint
