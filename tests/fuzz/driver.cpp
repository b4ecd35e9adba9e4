/// Runs a fuzz test where the compiler has no libFuzzer: its seeds, then changes of them drawn from a fixed seed, so that every run is the same.
///
///     fuzz.link.bridge [INPUTS [SEED]]     default 1000 1
///     fuzz.link.bridge --corpus FOLDER     writes the seeds as files, for libFuzzer to begin from
///     fuzz.link.bridge FILE                one input, as libFuzzer leaves it after a failure
#include <csignal>
#include <fstream>
#include <iterator>
#include <random>
#include <string>

#include "fuzz/fuzz.hpp"

namespace {

using noctule::fuzz::Bytes;

/// One to eight changes: a byte, four bytes of an extreme, a piece taken out, doubled or taken from another seed, a cut end.
Bytes changed(const std::vector<Bytes>& seeds, std::mt19937& random) {
    const auto draw = [&random](const std::size_t limit) { return limit == 0 ? 0 : static_cast<std::size_t>(random()) % limit; };
    Bytes out = seeds[draw(seeds.size())];
    constexpr std::uint32_t kExtremes[] = {0U, 0xFFFFFFFFU, 0x7F800000U, 0x7FC00000U, 0xFF7FFFFFU, 0x7FFFFFFFU, 0x80000000U, 0x00000001U, 0x3F800000U, 0x0000807FU, 0x0000C07FU};
    for (std::size_t n = 1 + draw(8); n > 0; --n) {
        const auto at = static_cast<std::ptrdiff_t>(draw(out.size() + 1));
        const auto length = static_cast<std::ptrdiff_t>(draw(64));
        const std::ptrdiff_t end = std::min(at + length, static_cast<std::ptrdiff_t>(out.size()));
        switch (draw(6)) {
            case 0:
                if (!out.empty()) { out[draw(out.size())] = static_cast<std::uint8_t>(random()); }
                break;
            case 1: {
                const std::uint32_t value = kExtremes[draw(std::size(kExtremes))];
                if (out.size() >= sizeof value) { std::memcpy(out.data() + draw(out.size() - sizeof value + 1), &value, sizeof value); }
                break;
            }
            case 2: out.erase(out.begin() + at, out.begin() + end); break;
            case 3: {
                const Bytes piece(out.begin() + at, out.begin() + end);
                out.insert(out.begin() + at, piece.begin(), piece.end());
                break;
            }
            case 4: {
                const Bytes& other = seeds[draw(seeds.size())];
                const auto from = static_cast<std::ptrdiff_t>(draw(other.size() + 1));
                out.insert(out.begin() + at, other.begin() + from, other.begin() + std::min(from + length, static_cast<std::ptrdiff_t>(other.size())));
                break;
            }
            default: out.resize(static_cast<std::size_t>(end)); break;
        }
    }
    return out;
}

Bytes last;             // the input under way
std::string keep_path;  // where it goes

/// Left behind beside the program when a promise breaks, to be run again alone.
void keep(int) {
    std::ofstream(keep_path, std::ios::binary).write(reinterpret_cast<const char*>(last.data()), static_cast<std::streamsize>(last.size()));
    std::_Exit(1);
}

void run(const Bytes& input) {
    last = input;
    static_cast<void>(LLVMFuzzerTestOneInput(input.data(), input.size()));
}

}  // namespace

int main(const int argc, char** argv) {
    const std::vector<std::string> words(argv + 1, argv + argc);
    const std::vector<Bytes> seeds = noctule::fuzz::seeds();
    if (words.size() == 2 && words[0] == "--corpus") {
        for (std::size_t i = 0; i < seeds.size(); ++i) {
            std::ofstream(words[1] + "/seed" + std::to_string(i), std::ios::binary).write(reinterpret_cast<const char*>(seeds[i].data()), static_cast<std::streamsize>(seeds[i].size()));
        }
        return 0;
    }
    if (words.size() == 1 && words[0].find_first_not_of("0123456789") != std::string::npos) {
        std::ifstream file(words[0], std::ios::binary);
        run(Bytes{std::istreambuf_iterator<char>(file), {}});
        return 0;
    }
    keep_path = std::string(argv[0]) + ".failed";
    std::signal(SIGABRT, keep);
    const unsigned long inputs = !words.empty() ? std::stoul(words[0]) : 1000;
    std::mt19937 random(words.size() > 1 ? static_cast<unsigned>(std::stoul(words[1])) : 1U);
    for (const Bytes& seed : seeds) { run(seed); }
    for (unsigned long i = 0; i < inputs; ++i) { run(changed(seeds, random)); }
    std::printf("%zu seeds and %lu changes of them\n", seeds.size(), inputs);
    return 0;
}
