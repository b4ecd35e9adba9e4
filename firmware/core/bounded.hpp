/// Array with a length, a hard capacity, a high-water mark and a count of refusals. Never allocates.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace noctule {

template <class T, std::size_t Capacity>
class Bounded {
public:
    /// False: full, the value was not stored (and the refusal is counted).
    [[nodiscard]] bool push(const T& value) {
        if (size_ == Capacity) {
            ++refused_;
            return false;
        }
        data_[size_++] = value;
        if (size_ > peak_) { peak_ = size_; }
        return true;
    }

    /// Drops the entries, keeps peak and refusals.
    void clear() { size_ = 0; }

    /// Removes entry i by moving the last one into its place. i < size().
    void remove_unordered(const std::size_t i) {
        data_[i] = data_[size_ - 1];
        --size_;
    }

    /// Removes the first n entries, n <= size(); the others keep their order.
    void drop_front(const std::size_t n) {
        for (std::size_t i = n; i < size_; ++i) { data_[i - n] = data_[i]; }
        size_ -= n;
    }

    /// Keeps the first n entries, n <= size().
    void keep_front(const std::size_t n) { size_ = n; }

    [[nodiscard]] static constexpr std::size_t capacity() { return Capacity; }
    [[nodiscard]] std::size_t size() const { return size_; }
    [[nodiscard]] bool empty() const { return size_ == 0; }
    [[nodiscard]] bool full() const { return size_ == Capacity; }
    [[nodiscard]] std::size_t peak() const { return peak_; }
    [[nodiscard]] std::uint32_t refused() const { return refused_; }

    [[nodiscard]] T& operator[](const std::size_t i) { return data_[i]; }
    [[nodiscard]] const T& operator[](const std::size_t i) const { return data_[i]; }
    [[nodiscard]] T& back() { return data_[size_ - 1]; }
    [[nodiscard]] const T& back() const { return data_[size_ - 1]; }
    [[nodiscard]] T* begin() { return data_.data(); }
    [[nodiscard]] T* end() { return data_.data() + size_; }
    [[nodiscard]] const T* begin() const { return data_.data(); }
    [[nodiscard]] const T* end() const { return data_.data() + size_; }

private:
    std::array<T, Capacity> data_{};
    std::size_t size_ = 0;
    std::size_t peak_ = 0;
    std::uint32_t refused_ = 0;
};

}  // namespace noctule
