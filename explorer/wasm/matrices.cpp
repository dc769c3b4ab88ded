// The isospectral steps of the library, and the products of matrices that they call, with the arguments of BLAS.
#define COMPILES_TRANSFORMS
#include "../../src/coadjoint/methods/isospectral_gauss.cpp"

namespace explorer {

using coadjoint::Complex;
constexpr int VECTORS = 2, COLUMNS = 4;  // of a block of a product, whose sums stay in registers

// Matrices of real numbers: A in panels of rows, of which the last is filled with zeros, B and C by columns, the columns of C
// as long as whole panels.
template <class R>
struct Packed {
    typedef R Vector __attribute__((vector_size(16)));
    static constexpr int ROWS = VECTORS * 16 / int(sizeof(R));
    int rows, inner, columns;
    std::vector<R> A, B, C;

    void resize(int m, int k, int n) {
        rows = (m + ROWS - 1) / ROWS * ROWS, inner = k, columns = (n + COLUMNS - 1) / COLUMNS * COLUMNS;
        A.assign(size_t(rows) * k, R(0.0)), B.assign(size_t(columns) * k, R(0.0)), C.resize(size_t(columns) * rows);
    }
    R& a(int i, int p) { return A[(size_t(i / ROWS) * inner + p) * ROWS + i % ROWS]; }
    R& b(int p, int j) { return B[size_t(j) * inner + p]; }
    R& c(int i, int j) { return C[size_t(j) * rows + i]; }

    void multiply() {
        for (int j = 0; j < columns; j += COLUMNS)
            for (int i = 0; i < rows; i += ROWS) {
                Vector sum[COLUMNS][VECTORS] = {};
                const R *panel = &a(i, 0), *column = &b(0, j);
                for (int p = 0; p < inner; ++p, panel += ROWS)
                    for (int v = 0; v < VECTORS; ++v) {
                        Vector entries;
                        std::memcpy(&entries, panel + v * ROWS / VECTORS, sizeof(entries));
                        for (int q = 0; q < COLUMNS; ++q) sum[q][v] += entries * column[size_t(q) * inner + p];
                    }
                for (int q = 0; q < COLUMNS; ++q) std::memcpy(&c(i, j + q), sum[q], sizeof(sum[q]));
            }
    }
};

// C = alpha op(A) B + beta C, column by column; op is the transpose ('T'), the adjoint ('C') or nothing ('N').
template <class R>
void multiply(const char* transposed, const char*, const int* m, const int* n, const int* k, const R* alpha, const R* A,
              const int* stride_A, const R* B, const int* stride_B, const R* beta, R* C, const int* stride_C) {
    static Packed<R> packed;
    packed.resize(*m, *k, *n);
    for (int p = 0; p < *k; ++p)
        for (int i = 0; i < *m; ++i) packed.a(i, p) = *transposed == 'N' ? A[p * *stride_A + i] : A[i * *stride_A + p];
    for (int j = 0; j < *n; ++j) std::copy_n(B + j * *stride_B, *k, &packed.b(0, j));
    packed.multiply();
    for (int j = 0; j < *n; ++j)
        for (int i = 0; i < *m; ++i) {
            R& to = C[j * *stride_C + i];
            to = *alpha * packed.c(i, j) + (*beta == R(0.0) ? R(0.0) : *beta * to);
        }
}

// The same for complex matrices: (a + ib)(c + id) is (a, b) times the columns (c, -d) and (d, c).
void multiply_complex(const char* transposed, const char*, const int* m, const int* n, const int* k, const Complex* alpha,
                      const Complex* A, const int* stride_A, const Complex* B, const int* stride_B, const Complex* beta,
                      Complex* C, const int* stride_C) {
    static Packed<double> packed;
    packed.resize(*m, 2 * *k, 2 * *n);
    for (int p = 0; p < *k; ++p)
        for (int i = 0; i < *m; ++i) {
            const Complex entry = *transposed == 'N' ? A[p * *stride_A + i] : A[i * *stride_A + p];
            packed.a(i, 2 * p) = entry.real();
            packed.a(i, 2 * p + 1) = *transposed == 'C' ? -entry.imag() : entry.imag();
        }
    for (int j = 0; j < *n; ++j)
        for (int p = 0; p < *k; ++p) {
            const Complex entry = B[j * *stride_B + p];
            packed.b(2 * p, 2 * j) = packed.b(2 * p + 1, 2 * j + 1) = entry.real();
            packed.b(2 * p, 2 * j + 1) = entry.imag(), packed.b(2 * p + 1, 2 * j) = -entry.imag();
        }
    packed.multiply();
    for (int j = 0; j < *n; ++j)
        for (int i = 0; i < *m; ++i) {
            Complex& to = C[j * *stride_C + i];
            const Complex product(packed.c(i, 2 * j), packed.c(i, 2 * j + 1));
            to = coadjoint::times(*alpha, product) + (*beta == 0.0 ? Complex(0.0) : coadjoint::times(*beta, to));
        }
}

}  // namespace explorer

EXPORT void* isospectral_address() { return reinterpret_cast<void*>(&coadjoint::isospectral_gauss_step); }

// Of the products of complex matrices, of real ones and of those of single precision.
EXPORT void* product_address(int number) {
    if (number == 0) return reinterpret_cast<void*>(&explorer::multiply_complex);
    if (number == 1) return reinterpret_cast<void*>(&explorer::multiply<double>);
    return reinterpret_cast<void*>(&explorer::multiply<float>);
}
