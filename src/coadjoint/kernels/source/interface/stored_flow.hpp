// The tables of a splitting that were read from text: every index is checked, so that no loop leaves its arrays.
#pragma once

#include <vector>

#include "boundary/tables.hpp"
#include "interface/table_text.hpp"

namespace coadjoint {

// An action with the memory of its columns.
struct StoredAction {
    std::vector<uint8_t> kind;
    std::vector<uint32_t> run, angles, repeat, angle, position, constant, width, entries, degree, indices;
    std::vector<double> constants;
    Action view{};
};

// Tables with their memory; those of derivatives contain those of a run.
class StoredFlow {
  public:
    double step;
    FlowCotangents tables{};

    explicit StoredFlow(const NamedArrays& arrays);
    StoredFlow(const StoredFlow&) = delete;
    StoredFlow& operator=(const StoredFlow&) = delete;
    int64_t size() const { return tables.base.state.size; }

  private:
    std::vector<uint8_t> kind, bent, properties;
    std::vector<uint32_t> part, section, share, row, target, entry, column, monomial, factor, factor_row, exponent;
    std::vector<uint32_t> body_column;
    std::vector<int64_t> only, called, nothing;
    std::vector<double> frequency, tau, moment, offset, weight, coefficient, body;
    StoredAction state, dual;

    void read_terms(const NamedArrays& arrays);
    void read_bodies(const NamedArrays& arrays);
    void read_action(const NamedArrays& arrays, const std::string& name, StoredAction& action);
    void check_part(const StoredAction& action, const std::string& name, uint32_t part) const;
    bool turns_directly(const StoredAction& action, uint32_t part) const;
    void set_properties();
};

}  // namespace coadjoint
