// Runs of mutated tables, by the C interface: `fuzz_tables SEED COUNT TABLE...`. Sanitizers end it at the first defect.
#include "coadjoint_runs.h"

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <random>
#include <sstream>
#include <string>
#include <vector>

static std::mt19937_64 random_bits;

static size_t below(size_t limit) { return limit ? size_t(random_bits() % limit) : 0; }

static std::string drawn_number() {
    static const char* const numbers[] = {
        "0",          "1",          "2",          "3",      "5",    "-1",  "8",     "12",  "255",  "65535",
        "4294967294", "4294967295", "2147483648", "1e300",  "1e999", "-0.0", "0.5",  "NaN", "-2147483649",
        "1e-320",     "-1e300",     "9223372036854775807"};
    return below(3) ? numbers[below(sizeof numbers / sizeof *numbers)] : std::to_string(below(40));
}

// Where a number begins, at or after a random place.
static size_t number_in(const std::string& text) { return text.find_first_of("-0123456789", below(text.size())); }

static void mutate(std::string& text) {
    const size_t kind = below(8), place = below(text.size());
    if (kind < 5) {  // another number
        const size_t first = number_in(text);
        if (first == std::string::npos) return;
        const size_t last = text.find_first_not_of("-+.0123456789e", first);
        text.replace(first, last - first, drawn_number());
    } else if (kind == 5) {  // one number more
        const size_t first = number_in(text);
        if (first != std::string::npos) text.insert(first, drawn_number() + ", ");
    } else if (kind == 6) {  // one number less
        const size_t first = text.find(", ", place), last = text.find_first_of(",]", first + 2);
        if (first != std::string::npos && last != std::string::npos) text.erase(first, last - first);
    } else if (below(4) == 0) {
        text.resize(place);
    } else {
        text[place] = char(random_bits());
    }
}

int main(int count, char** arguments) {
    random_bits.seed(std::strtoull(arguments[1], nullptr, 10));
    std::vector<std::string> tables;
    for (int k = 3; k < count; ++k) {
        std::ostringstream text;
        text << std::ifstream(arguments[k]).rdbuf();
        tables.push_back(text.str());
    }
    long accepted = 0, refused = 0, finished = 0;
    for (long k = 0; k < std::atol(arguments[2]); ++k) {
        std::string table = tables[below(tables.size())];
        if (below(50) == 0) {
            table.resize(below(60));
            for (char& letter : table) letter = char(random_bits());
        }
        for (size_t changes = below(4); changes > 0 && !table.empty(); --changes) mutate(table);
        coadjoint_run* run;
        if (coadjoint_create(table.data(), table.size(), &run)) {
            if (run || !*coadjoint_message()) std::abort();
            ++refused;
            continue;
        }
        ++accepted;
        const size_t size = coadjoint_size(run);
        if (size <= 4096) {
            std::vector<double> x(size), vectors(2 * size, 1.0), saved(3 * size);
            for (double& one : x) one = double(below(2001)) / 1000.0 - 1.0;
            if (coadjoint_set_state(run, x.data(), size)) std::abort();
            finished += coadjoint_step(run) + coadjoint_save(run, 3, 2, saved.data(), saved.size()) == 0;
            (void)coadjoint_vjp(run, 2, x.data(), vectors.data());
            (void)coadjoint_jvp(run, 2, x.data(), vectors.data(), 2);
        }
        coadjoint_destroy(run);
    }
    std::printf("%ld %ld %ld\n", accepted, refused, finished);
    return 0;
}
