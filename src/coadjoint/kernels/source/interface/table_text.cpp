#include "interface/table_text.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>

namespace coadjoint {

namespace {

constexpr int DEEPEST = 16, MOST_DIGITS = 19;
constexpr size_t MOST_BYTES = size_t(1) << 30;

// digits 10^power, rounded once; infinite if it is too large. A text without a decimal point has the same meaning in
// every locale.
double rounded(uint64_t digits, int power) {
    return std::strtod((std::to_string(digits) + "e" + std::to_string(power)).c_str(), nullptr);
}

class JsonText {
  public:
    JsonText(const char* text, size_t length) : start(text), at(text), end(text + length) {}

    NamedArrays arrays() {
        skip_blanks();
        if (!next_is('{')) fail("it is no JSON object");
        object("", true, 0);
        skip_blanks();
        if (at != end) fail("something follows the object");
        return std::move(found);
    }

  private:
    const char *const start, *at, *const end;
    NamedArrays found;

    [[noreturn]] void fail(const std::string& why) const {
        throw WrongTable("the table cannot be read at byte " + std::to_string(at - start) + ": " + why);
    }
    void skip_blanks() {
        while (at != end && (*at == ' ' || *at == '\n' || *at == '\r' || *at == '\t')) ++at;
    }
    bool next_is(char sign) const { return at != end && *at == sign; }
    bool take(char sign) {
        skip_blanks();
        return next_is(sign) && (++at, true);
    }
    bool take_word(const char* word) {
        const size_t length = std::strlen(word);
        return size_t(end - at) >= length && std::memcmp(at, word, length) == 0 && (at += length, true);
    }
    bool digit() const { return at != end && *at >= '0' && *at <= '9'; }

    double number() {
        const bool minus = next_is('-') && (++at, true);
        uint64_t digits = 0;
        int count = 0, power = 0, exponent = 0;
        const auto digits_of = [&](int shift) {
            if (!digit()) fail("a number has no digits");
            for (; digit(); ++at, power -= shift)
                if (count > 0 || *at != '0') {
                    if (++count > MOST_DIGITS) fail("a number has more than 19 digits");
                    digits = 10 * digits + uint64_t(*at - '0');
                }
        };
        digits_of(0);
        if (next_is('.')) ++at, digits_of(1);
        if (next_is('e') || next_is('E')) {
            ++at;
            const bool negative = next_is('-');
            if (negative || next_is('+')) ++at;
            if (!digit()) fail("an exponent has no digits");
            for (; digit(); ++at) exponent = std::min(10 * exponent + (*at - '0'), 1 << 20);
            if (negative) exponent = -exponent;
        }
        const double size = rounded(digits, std::clamp(power, -(1 << 20), 0) + exponent);
        if (!(size <= 1.7976931348623157e308)) fail("a number is too large");
        return minus ? -size : size;
    }

    std::string text() {
        const char* first = ++at;
        for (; !next_is('"'); ++at) {
            if (at == end || static_cast<unsigned char>(*at) < ' ') fail("a text does not end");
            if (*at == '\\' && ++at == end) fail("a text does not end");
        }
        return std::string(first, at++);
    }

    void store(const std::string& name, std::vector<double> numbers) {
        if (!found.emplace(name, std::move(numbers)).second) fail("it has " + name.substr(0, 80) + " twice");
    }

    void value(const std::string& name, bool named, int depth) {
        if (depth > DEEPEST) fail("it is nested too deeply");
        skip_blanks();
        if (next_is('{')) return object(named ? name + "." : "", named, depth);
        if (next_is('[')) return array(name, named, depth);
        if (next_is('"')) return void(text());
        if (take_word("null")) return;
        const bool yes = take_word("true"), no = !yes && take_word("false");
        const double found_number = yes ? 1.0 : no ? 0.0 : number();
        if (named) store(name, {found_number});
    }

    void object(const std::string& prefix, bool named, int depth) {
        ++at;
        if (take('}')) return;
        do {
            skip_blanks();
            if (!next_is('"')) fail("a name is missing");
            const std::string name = prefix + text();
            if (!take(':')) fail("a colon is missing");
            value(name, named, depth + 1);
        } while (take(','));
        if (!take('}')) fail("an object does not end");
    }

    void array(const std::string& name, bool named, int depth) {
        ++at;
        std::vector<double> numbers;
        bool plain = true;
        if (!take(']')) {
            do {
                skip_blanks();
                if (next_is('-') || digit())
                    numbers.push_back(number());
                else
                    plain = false, value("", false, depth + 1);
            } while (take(','));
            if (!take(']')) fail("an array does not end");
        }
        if (named && plain) store(name, std::move(numbers));
    }
};

}  // namespace

NamedArrays arrays_of_json(const char* text, size_t length) {
    if (length > MOST_BYTES) throw WrongTable("the table has more than a gibibyte; give a smaller one");
    return JsonText(text, length).arrays();
}

}  // namespace coadjoint
