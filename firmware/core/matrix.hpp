/// Small dense matrices of fixed size: what the planar filters need and no more.
///
/// Row-major, no storage beyond the values, no heap. Sizes are in the type, so a wrong product does not compile.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace noctule {

template <class T, std::size_t Rows, std::size_t Cols>
struct Matrix {
    std::array<T, Rows * Cols> values{};

    [[nodiscard]] T& operator()(const std::size_t i, const std::size_t j) { return values[i * Cols + j]; }
    [[nodiscard]] const T& operator()(const std::size_t i, const std::size_t j) const { return values[i * Cols + j]; }

    Matrix& operator+=(const Matrix& other) {
        for (std::size_t i = 0; i < values.size(); ++i) { values[i] += other.values[i]; }
        return *this;
    }
    Matrix& operator-=(const Matrix& other) {
        for (std::size_t i = 0; i < values.size(); ++i) { values[i] -= other.values[i]; }
        return *this;
    }
    [[nodiscard]] friend Matrix operator+(Matrix a, const Matrix& b) { return a += b; }
    [[nodiscard]] friend Matrix operator-(Matrix a, const Matrix& b) { return a -= b; }
    [[nodiscard]] friend Matrix operator*(const T scale, Matrix a) {
        for (T& value : a.values) { value *= scale; }
        return a;
    }

    [[nodiscard]] static Matrix identity() {
        static_assert(Rows == Cols);
        Matrix a;
        for (std::size_t i = 0; i < Rows; ++i) { a(i, i) = T{1}; }
        return a;
    }
};

template <class T, std::size_t Rows, std::size_t Inner, std::size_t Cols>
[[nodiscard]] Matrix<T, Rows, Cols> operator*(const Matrix<T, Rows, Inner>& a, const Matrix<T, Inner, Cols>& b) {
    Matrix<T, Rows, Cols> c;
    for (std::size_t i = 0; i < Rows; ++i) {
        for (std::size_t k = 0; k < Inner; ++k) {
            const T aik = a(i, k);
            for (std::size_t j = 0; j < Cols; ++j) { c(i, j) += aik * b(k, j); }
        }
    }
    return c;
}

template <class T, std::size_t Rows, std::size_t Cols>
[[nodiscard]] Matrix<T, Cols, Rows> transpose(const Matrix<T, Rows, Cols>& a) {
    Matrix<T, Cols, Rows> b;
    for (std::size_t i = 0; i < Rows; ++i) {
        for (std::size_t j = 0; j < Cols; ++j) { b(j, i) = a(i, j); }
    }
    return b;
}

/// Makes rounding harmless: (a + a^T) / 2.
template <class T, std::size_t N>
void symmetrise(Matrix<T, N, N>& a) {
    for (std::size_t i = 0; i < N; ++i) {
        for (std::size_t j = i + 1; j < N; ++j) {
            const T mean = T{0.5} * (a(i, j) + a(j, i));
            a(i, j) = mean;
            a(j, i) = mean;
        }
    }
}

/// Inverse of a 2x2 matrix. False: singular, out unchanged.
template <class T>
[[nodiscard]] bool invert(const Matrix<T, 2, 2>& a, Matrix<T, 2, 2>& out) {
    const T determinant = a(0, 0) * a(1, 1) - a(0, 1) * a(1, 0);
    if (!(std::abs(determinant) > T{0})) { return false; }
    const T scale = T{1} / determinant;
    out.values = {scale * a(1, 1), -scale * a(0, 1), -scale * a(1, 0), scale * a(0, 0)};
    return true;
}

/// Inverse of a 3x3 matrix by cofactors. False: singular, out unchanged.
template <class T>
[[nodiscard]] bool invert(const Matrix<T, 3, 3>& a, Matrix<T, 3, 3>& out) {
    const T c00 = a(1, 1) * a(2, 2) - a(1, 2) * a(2, 1);
    const T c01 = a(1, 2) * a(2, 0) - a(1, 0) * a(2, 2);
    const T c02 = a(1, 0) * a(2, 1) - a(1, 1) * a(2, 0);
    const T determinant = a(0, 0) * c00 + a(0, 1) * c01 + a(0, 2) * c02;
    if (!(std::abs(determinant) > T{0})) { return false; }
    const T scale = T{1} / determinant;
    out.values = {scale * c00, scale * (a(0, 2) * a(2, 1) - a(0, 1) * a(2, 2)), scale * (a(0, 1) * a(1, 2) - a(0, 2) * a(1, 1)),
                  scale * c01, scale * (a(0, 0) * a(2, 2) - a(0, 2) * a(2, 0)), scale * (a(0, 2) * a(1, 0) - a(0, 0) * a(1, 2)),
                  scale * c02, scale * (a(0, 1) * a(2, 0) - a(0, 0) * a(2, 1)), scale * (a(0, 0) * a(1, 1) - a(0, 1) * a(1, 0))};
    return true;
}

/// Lower factor L of a positive semi-definite matrix, a = L L^T. A pivot lost to rounding gives a zero column.
template <class T, std::size_t N>
[[nodiscard]] Matrix<T, N, N> cholesky(const Matrix<T, N, N>& a) {
    Matrix<T, N, N> lower;
    for (std::size_t j = 0; j < N; ++j) {
        T pivot = a(j, j);
        for (std::size_t k = 0; k < j; ++k) { pivot -= lower(j, k) * lower(j, k); }
        if (!(pivot > T{0})) { continue; }
        lower(j, j) = std::sqrt(pivot);
        for (std::size_t i = j + 1; i < N; ++i) {
            T sum = a(i, j);
            for (std::size_t k = 0; k < j; ++k) { sum -= lower(i, k) * lower(j, k); }
            lower(i, j) = sum / lower(j, j);
        }
    }
    return lower;
}

/// Eigenvalues (falling) and the direction of the first of a symmetric 2x2 matrix [[a, b], [b, c]].
template <class T>
struct Eigen2 {
    T large{};
    T small{};
    T direction_rad{};  ///< of the eigenvector of `large`, in (-pi/2, pi/2]
};

template <class T>
[[nodiscard]] Eigen2<T> eigen_symmetric(const T a, const T b, const T c) {
    const T mean = T{0.5} * (a + c);
    const T half = T{0.5} * (a - c);
    const T radius = std::sqrt(half * half + b * b);
    return {mean + radius, mean - radius, T{0.5} * std::atan2(b, half)};
}

}  // namespace noctule
