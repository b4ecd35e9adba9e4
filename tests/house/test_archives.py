"""From core to command the firmware asks for no heap, throws nothing and reads no clock: seen in its archive's symbols."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ARCHIVE = ROOT / "build" / "release" / "lib" / "libnoctule_firmware.a"

FORBIDDEN = {
    "heap": r"malloc|calloc|realloc|aligned_alloc|posix_memalign|memalign|valloc|strdup|_Zn[wa][mj].*",
    "exception": r"__cxa_throw|__cxa_rethrow|__cxa_allocate_exception|__cxa_begin_catch|__cxa_end_catch|__cxa_bad_cast|_ZSt\d+__throw_\w+",
    "unwinder": r"_Unwind_\w+|__gxx_personality_\w+",
    "clock": r"time|clock|gettimeofday|clock_gettime|timespec_get|_ZNSt6chrono\w*3nowEv",
    "console or file": r"printf|fprintf|puts|putchar|fopen|open|write|_ZSt4cout|_ZSt4cerr|getenv",
    "random device": r"rand|random|srand|_ZNSt13random_device\w+",
}


def undefined_symbols(path):
    """Symbols that an object file or archive needs from outside: member -> set of names."""
    text = subprocess.run(["nm", "--undefined-only", "--no-sort", str(path)], capture_output=True, text=True, check=True).stdout
    wanted, member = {}, path.name
    for line in text.splitlines():
        if line.endswith(":"):
            member = line[:-1]
        elif (words := line.split()) and words[-2:-1] in (["U"], ["w"]):
            wanted.setdefault(member, set()).add(words[-1].split("@")[0])
    return wanted


def violations(path):
    """One line for each forbidden symbol that a file needs."""
    return sorted(
        f"{member}: {symbol} ({kind})"
        for member, symbols in undefined_symbols(path).items()
        for symbol in symbols
        for kind, pattern in FORBIDDEN.items()
        if re.fullmatch(pattern, symbol)
    )


@pytest.mark.skipif(not ARCHIVE.exists(), reason="build/release is not built")
def test_the_firmware_needs_no_heap_exception_clock_or_console():
    assert undefined_symbols(ARCHIVE), "nm saw nothing"
    assert violations(ARCHIVE) == []


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
@pytest.mark.parametrize(
    "kind, code",
    [
        ("heap", "#include <vector>\nvoid f(std::vector<int>& v) { v.push_back(1); }"),
        ("heap", "#include <cstdlib>\nvoid* f() { return std::malloc(8); }"),
        ("exception", "void f() { throw 1; }"),
        ("exception", "#include <array>\nint f(std::array<int, 2>& a, unsigned i) { return a.at(i); }"),
        ("unwinder", "struct A { ~A(); }; void g(); void f() { A a; g(); }"),
        ("clock", "#include <chrono>\nlong f() { return std::chrono::steady_clock::now().time_since_epoch().count(); }"),
        ("console or file", "#include <cstdio>\nvoid f(int i) { std::printf(\"%d\", i); }"),
    ],
)
def test_the_check_sees_what_it_forbids(tmp_path, kind, code):
    source, compiled = tmp_path / "sample.cpp", tmp_path / "sample.o"
    source.write_text(code + "\n", encoding="utf-8")
    subprocess.run(["g++", "-std=c++20", "-O2", "-c", str(source), "-o", str(compiled)], check=True)
    assert any(f"({kind})" in line for line in violations(compiled))
