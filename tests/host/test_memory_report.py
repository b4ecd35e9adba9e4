"""Stack bounds are read rightly from machine code, and hold for the built noctule-nav."""

import shutil
import subprocess

import pytest

from noctule import memory_report, stack_report
from noctule.processes import find_program

CODE = r"""
extern "C" {
__attribute__((noinline)) void leaf(volatile char* p) { *p = 1; asm volatile("" ::: "memory"); }
__attribute__((noinline)) void big() { volatile char room[5000]; leaf(room); asm volatile("" ::: "memory"); }
__attribute__((noinline)) void small() { volatile char room[100]; leaf(room); asm volatile("" ::: "memory"); }
__attribute__((noinline)) int down(int n) { volatile char room[64]; leaf(room); return n > 0 ? down(n - 1) + room[0] : 0; }
__attribute__((noinline)) void variable(int n) { volatile char room[n]; leaf(room); asm volatile("" ::: "memory"); }
void (*volatile pointer)() = small;
__attribute__((noinline)) void through() { pointer(); asm volatile("" ::: "memory"); }
}
int main(int argc, char**) { big(); small(); through(); variable(argc); return down(argc); }
"""

pytestmark = pytest.mark.skipif(shutil.which("objdump") is None or shutil.which("g++") is None, reason="no binutils")


@pytest.fixture(scope="module")
def functions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stack")
    (folder / "a.cpp").write_text(CODE)
    subprocess.run(["g++", "-O2", "-fno-optimize-sibling-calls", str(folder / "a.cpp"), "-o", str(folder / "a")], check=True)
    return stack_report.disassemble(folder / "a")


def test_frames_add_up_along_the_deepest_path(functions):
    big, small = stack_report.deepest(functions, "big"), stack_report.deepest(functions, "small")
    assert 5000 <= big.bytes <= 5100 and big.path == ["big", "leaf"] and big.problems == []
    assert 100 <= small.bytes <= 160


def test_what_has_no_bound_is_named(functions):
    assert stack_report.deepest(functions, "down").problems == ["recursion: down"]
    assert stack_report.deepest(functions, "variable").problems == ["frame of variable size: variable"]
    assert stack_report.deepest(functions, "through").problems == ["call through a pointer: through"]
    assert len(stack_report.deepest(functions, "main").problems) == 3


def test_a_pointer_that_is_resolved_counts(functions):
    depth = stack_report.deepest(functions, "through", {"^through$": "^(small|big)$"})
    assert depth.problems == [] and depth.path[1] == "big" and depth.bytes > 5000


def test_capacities_are_read_with_what_happens_when_full():
    text = "inline constexpr std::size_t kA = 128;   ///< samples; the newest are refused\ninline constexpr std::size_t kB = kA + 8;  ///< poses\n"
    assert memory_report.capacities(text) == [("kA", 128, "samples", "the newest are refused"), ("kB", 136, "poses", "-")]


@pytest.mark.skipif(find_program("noctule-nav") is None, reason="not built")
@pytest.mark.parametrize("program", memory_report.ROOTS)
def test_the_flights_loop_needs_a_proved_and_small_stack(program):
    for label, depth in memory_report.stacks(program).items():
        assert depth.problems == [], label
        assert depth.bytes <= memory_report.MUST_STACK, label
    parts = memory_report.sections(find_program(program))
    assert parts["data"] + parts["bss"] <= memory_report.MUST_BYTES
