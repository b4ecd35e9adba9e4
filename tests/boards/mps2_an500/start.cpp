/// Start-up of a bare Cortex-M7 on qemu's mps2-an500: vectors, FPU, constructors; console, files and exit code go to the host by semihosting.
#include <cstddef>
#include <cstdint>
#include <cstring>

extern "C" {

// Of mps2-an500.ld.
extern std::uint8_t bss_begin[];
extern std::uint8_t bss_end[];
extern std::uint8_t stack_begin[];
extern std::uint8_t stack_end[];
extern std::uint8_t heap_begin[];
extern std::uint8_t heap_end[];

void initialise_monitor_handles();
void __libc_init_array();
[[noreturn]] void exit(int code);
[[noreturn]] void _exit(int code);
int program() __asm("main");   // ISO C++ lets nobody call main
void* _sbrk(std::ptrdiff_t bytes);
void reset();
void fault();
void* __dso_handle = nullptr;   // of what is destroyed at exit; gcc's own start-up files, which are left out, hold it
void _init() {}
void _fini() {}

/// The heap of the tests and of the C library, in the slow RAM; the firmware itself asks for none (tests/house).
void* _sbrk(const std::ptrdiff_t bytes) {
    static std::uint8_t* top = heap_begin;
    if (bytes > heap_end - top) { return reinterpret_cast<void*>(-1); }
    std::uint8_t* const old = top;
    top += bytes;
    return old;
}

void fault() { _exit(70); }

void reset() {
    *reinterpret_cast<volatile std::uint32_t*>(0xE000ED88U) |= 0xFU << 20U;   // CPACR: the FPU is for everybody
    __asm volatile("dsb\n isb" ::: "memory");
    std::memset(bss_begin, 0, static_cast<std::size_t>(bss_end - bss_begin));
    initialise_monitor_handles();
    __libc_init_array();
    exit(program());
}

}  // extern "C"

namespace {

using Handler = void (*)();

struct Vectors {
    void* stack;
    Handler reset;
    Handler faults[14];
};

[[gnu::section(".vectors"), gnu::used]] const Vectors kVectors{
    stack_end, reset, {fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault}};

}  // namespace
