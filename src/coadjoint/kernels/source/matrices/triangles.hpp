// Equations with triangular matrices, by the BLAS routines given in the tables. Here a matrix is stored column by
// column, as in Fortran; the columns of a block are `n` apart.
#pragma once

#include <vector>

#include "matrices/products.hpp"

namespace coadjoint {

// Solves with a triangular matrix, in Fortran's convention.
template <class T>
using Trsm = void (*)(const char*, const char*, const char*, const char*, const int*, const int*, const T*, const T*,
                      const int*, T*, const int*);

template <class T>
class Triangles {
  public:
    Triangles(int64_t gemm, int64_t trsm, int64_t size)
        : gemm(reinterpret_cast<Gemm<T>>(gemm)), trsm(reinterpret_cast<Trsm<T>>(trsm)), n(int(size)),
          workspace(2 * (size / 2 + 1) * (size / 2 + 1)) {}

    // Factorize A in place: A = L U, L with a unit diagonal. The Hermitian part of A is positive, so no pivoting is
    // needed.
    void factor(T* A) const { factor(A, n); }

    // X := A^-1 X, with the factors of A.
    void solve(const T* A, T* X) const {
        divide('L', 'L', 'N', 'U', n, n, A, X);
        divide('L', 'U', 'N', 'N', n, n, A, X);
    }

    // H := A^-1 H A^-*, with the factors of A; H is skew-Hermitian.
    void both_sides(const T* A, T* H) {
        congruence(A, H, n, true);
        congruence(A, H, n, false);
    }

    // c = a b.
    void multiply(const T* a, const T* b, T* c) const { product('N', n, n, n, T(1), a, b, n, T(0), c, n); }

  private:
    static constexpr int LEAF = 16, BLOCK = 32;
    const Gemm<T> gemm;
    const Trsm<T> trsm;
    const int n;
    std::vector<T> workspace;

    // c = alpha a op(b) + beta c, with `rows` x `inner` entries of a.
    void product(char op, int rows, int columns, int inner, T alpha, const T* a, const T* b, int ldb, T beta, T* c,
                 int ldc) const {
        const char plain = 'N';
        gemm(&plain, &op, &rows, &columns, &inner, &alpha, a, &n, b, &ldb, &beta, c, &ldc);
    }

    void divide(char side, char part, char op, char ones, int rows, int columns, const T* A, T* X) const {
        const T one(1);
        trsm(&side, &part, &op, &ones, &rows, &columns, &one, A, &n, X, &n);
    }

    void factor(T* A, int size) const {
        if (size <= LEAF) {
            for (int k = 0; k < size; ++k) {
                const T factor = inverse(A[k + int64_t(k) * n]);
                for (int i = k + 1; i < size; ++i) A[i + int64_t(k) * n] = times(A[i + int64_t(k) * n], factor);
                for (int j = k + 1; j < size; ++j) {
                    const T pivot = A[k + int64_t(j) * n];
                    for (int i = k + 1; i < size; ++i) A[i + int64_t(j) * n] -= times(A[i + int64_t(k) * n], pivot);
                }
            }
            return;
        }
        const int half = size / 2, rest = size - half;
        T *right = A + int64_t(half) * n, *below = A + half, *last = right + half;
        factor(A, half);
        divide('L', 'L', 'N', 'U', half, rest, A, right);
        divide('R', 'U', 'N', 'N', rest, half, A, below);
        product('N', rest, rest, half, T(-1), below, right, n, T(1), last, n);
        factor(last, rest);
    }

    // X := F^-1 H F^-* in place of H, F the lower factor or the upper one. With the blocks in the order in which F is
    // solved, 1 and 2: H21 F11^-* = F21 X11 + F22 X21 =: T, E = F21 X11/2, Y = T - E,
    // F22 X22 F22* = H22 - (Y F21* - F21 Y*), and F22 X21 = Y - E.
    void congruence(const T* F, T* H, int size, bool lower) {
        const char part = lower ? 'L' : 'U', ones = lower ? 'U' : 'N';
        if (size <= BLOCK) {
            divide('L', part, 'N', ones, size, size, F, H);
            divide('R', part, 'C', ones, size, size, F, H);
            for (int j = 0; j < size; ++j)
                for (int i = 0; i <= j; ++i) {
                    T& entry = H[i + int64_t(j) * n];
                    entry = i == j ? times(entry - conjugate(entry), T(0.5)) : -conjugate(H[j + int64_t(i) * n]);
                }
            return;
        }
        const int first = size / 2, second = size - first;
        const int64_t at = lower ? 0 : second, to = lower ? first : 0;
        const T *F11 = F + at + at * n, *F21 = F + to + at * n, *F22 = F + to + to * n;
        T *H11 = H + at + at * n, *H21 = H + to + at * n, *H22 = H + to + to * n, *H12 = H + at + to * n;
        T *E = workspace.data(), *G = E + int64_t(second) * first;
        congruence(F11, H11, first, lower);
        divide('R', part, 'C', ones, second, first, F11, H21);
        product('N', second, first, first, T(0.5), F21, H11, n, T(0), E, second);
        subtract(E, H21, second, first);
        product('C', second, second, first, T(1), H21, F21, n, T(0), G, second);
        for (int j = 0; j < second; ++j)
            for (int i = 0; i < second; ++i)
                H22[i + int64_t(j) * n] -= G[i + int64_t(j) * second] - conjugate(G[j + int64_t(i) * second]);
        subtract(E, H21, second, first);
        divide('L', part, 'N', ones, second, first, F22, H21);
        congruence(F22, H22, second, lower);
        for (int j = 0; j < first; ++j)
            for (int i = 0; i < second; ++i) H12[j + int64_t(i) * n] = -conjugate(H21[i + int64_t(j) * n]);
    }

    void subtract(const T* E, T* H, int rows, int columns) const {
        for (int j = 0; j < columns; ++j)
            for (int i = 0; i < rows; ++i) H[i + int64_t(j) * n] -= E[i + int64_t(j) * rows];
    }
};

}  // namespace coadjoint
