/// Counts the calls of the C allocator of a whole process. Preloaded (LD_PRELOAD), so that what is counted is measured, not asserted.
///
/// A process asks through noctule_heap_allocations(), which it declares weak: null where nothing is preloaded.
/// glibc only: the calls go on to the allocator's own entry points. Never combined with AddressSanitizer.
#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>

namespace {
std::atomic<std::int64_t> allocations{0};
void count() { allocations.fetch_add(1, std::memory_order_relaxed); }
}  // namespace

extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* old, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

/// Allocations of this process so far: malloc, calloc, realloc and the aligned kin. operator new ends in malloc.
std::int64_t noctule_heap_allocations() { return allocations.load(std::memory_order_relaxed); }

void* malloc(std::size_t size) {
    count();
    return __libc_malloc(size);
}

void* calloc(std::size_t number, std::size_t size) {
    count();
    return __libc_calloc(number, size);
}

void* realloc(void* old, std::size_t size) {
    count();
    return __libc_realloc(old, size);
}

void* memalign(std::size_t alignment, std::size_t size) {
    count();
    return __libc_memalign(alignment, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
    count();
    return __libc_memalign(alignment, size);
}

int posix_memalign(void** out, std::size_t alignment, std::size_t size) {
    count();
    void* block = __libc_memalign(alignment, size);
    if (block == nullptr) { return ENOMEM; }
    *out = block;
    return 0;
}
}
