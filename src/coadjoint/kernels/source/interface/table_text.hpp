// Reading of JSON: the arrays of numbers in a text by name. Any text is accepted or refused, in time proportional to it.
#pragma once

#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace coadjoint {

struct WrongTable : std::runtime_error {
    using std::runtime_error::runtime_error;
};

typedef std::map<std::string, std::vector<double>> NamedArrays;

// The arrays of a JSON object, those of an object inside of it as "outer.inner", a number as an array of one and a truth
// value as 0 or 1. Text, nulls, and arrays of other values are left out. Throws WrongTable.
NamedArrays arrays_of_json(const char* text, size_t length);

}  // namespace coadjoint
