#include "interface/stored_flow.hpp"

#include <algorithm>
#include <cmath>
#include <new>

#include "flows/called_parts.hpp"

namespace coadjoint {

EXPORT int64_t flow_properties(const FlowTables* tables, int64_t parts);

namespace {

constexpr double VERSION = 3.0;
constexpr uint32_t MOST_COORDINATES = uint32_t(1) << 24, MOST_POWER = uint32_t(1) << 16;

void require(bool holds, const std::string& name, const char* wrong) {
    if (!holds) throw WrongTable("the table cannot be run: " + name + " " + wrong);
}

const std::vector<double>& numbers_of(const NamedArrays& arrays, const std::string& name) {
    const auto found = arrays.find(name);
    require(found != arrays.end(), name, "is missing or no array of numbers; write the table by co.export_table");
    return found->second;
}

double number_of(const NamedArrays& arrays, const std::string& name) {
    const std::vector<double>& found = numbers_of(arrays, name);
    require(found.size() == 1, name, "is not one number");
    return found[0];
}

template <class Integer = uint32_t>
std::vector<Integer> integers_of(const NamedArrays& arrays, const std::string& name, double below) {
    const std::vector<double>& found = numbers_of(arrays, name);
    std::vector<Integer> integers(found.size());
    for (size_t k = 0; k < found.size(); ++k) {
        require(found[k] >= 0.0 && found[k] < below && found[k] == std::floor(found[k]), name, "has a wrong number");
        integers[k] = Integer(found[k]);
    }
    return integers;
}

constexpr double ANY = 4294967295.0;

// Where each of `count` rows begins, and the last one ends.
std::vector<uint32_t> starts_of(const NamedArrays& arrays, const std::string& name, size_t count) {
    std::vector<uint32_t> starts = integers_of(arrays, name, ANY);
    require(starts.size() == count + 1, name, "has another length than its rows");
    require(starts[0] == 0 && std::is_sorted(starts.begin(), starts.end()), name, "does not ascend from 0");
    return starts;
}

template <class Array>
void require_length(const Array& array, size_t length, const std::string& name) {
    require(array.size() == length, name, "has another length than the table needs");
}

}  // namespace

StoredFlow::StoredFlow(const NamedArrays& arrays) {
    require(number_of(arrays, "version") == VERSION, "version", "is not 3; write the table by this library");
    require(numbers_of(arrays, "functions").empty(), "functions", "names functions of the user; only polynomials run");
    const double dim = number_of(arrays, "dim");
    require(dim >= 1.0 && dim <= MOST_COORDINATES && dim == std::floor(dim), "dim", "is not from 1 to 2^24");
    step = number_of(arrays, "step");
    require(step != 0.0, "step", "is zero");
    FlowTables& flow = tables.base;
    flow.state.size = int64_t(dim);
    read_terms(arrays);
    read_bodies(arrays);
    const size_t parts = share.size() - 1;
    part = integers_of(arrays, "part", double(parts));
    tau = numbers_of(arrays, "coefficient"), moment = numbers_of(arrays, "moment");
    require_length(tau, part.size(), "coefficient"), require_length(moment, part.size(), "moment");
    for (double& one : tau) one *= step;
    section = integers_of(arrays, "section", double(part.size()) + 1.0);
    require(section.size() == 4 && std::is_sorted(section.begin(), section.end()), "section", "has no four rows");
    const double compensated = number_of(arrays, "compensated");
    read_action(arrays, "state_action", state), read_action(arrays, "dual_action", dual);
    bent.resize(parts), properties.resize(parts), only.resize(parts);
    for (size_t p = 0; p < parts; ++p) {
        const uint32_t first = row[share[p]], last = row[share[p + 1]];
        flow.longest = std::max<int64_t>(flow.longest, last - first);
        only[p] = share[p + 1] == share[p] + 1 && last == first + 1 && kind[share[p]] == LINEAR ? int64_t(first) : -1;
        bent[p] = std::any_of(frequency.begin() + first, frequency.begin() + last, [](double w) { return w != 0.0; });
    }
    flow.longest = std::max<int64_t>(flow.longest, 1);
    flow.only = only.data(), flow.bent = bent.data(), flow.frequency = frequency.data(), flow.part = part.data();
    flow.tau = tau.data(), flow.moment = moment.data(), flow.section = section.data(), flow.share = share.data();
    nothing.resize(kind.size());
    flow.addresses = tables.hessians = nothing.data();
    flow.state = state.view, tables.dual = dual.view;
    flow.compensated = compensated != 0.0, flow.called = called.data();
    flow.body_column = body_column.data(), flow.body = body.data(), flow.properties = properties.data();
    flow.step = step;
    tables.added = -1;
    set_properties();
}

void StoredFlow::read_terms(const NamedArrays& arrays) {
    const double size = double(tables.base.state.size);
    kind = integers_of<uint8_t>(arrays, "term_kind", 2.0);
    const size_t terms = kind.size();
    share = integers_of(arrays, "share", ANY);
    require(!share.empty(), "share", "does not begin at 0");
    require(share[0] == 0 && share.back() == terms, "share", "has other terms than term_kind");
    require(std::adjacent_find(share.begin(), share.end(), [](uint32_t a, uint32_t b) { return a >= b; }) == share.end(),
            "share", "has a part without terms");
    row = starts_of(arrays, "term_row", terms);
    const size_t rows = row.back();
    target = integers_of(arrays, "target", size), offset = numbers_of(arrays, "offset");
    frequency = numbers_of(arrays, "frequency");
    require_length(target, rows, "target"), require_length(offset, rows, "offset");
    require_length(frequency, rows, "frequency");
    entry = starts_of(arrays, "entry", rows);
    column = integers_of(arrays, "column", size), weight = numbers_of(arrays, "weight");
    require_length(column, entry.back(), "column"), require_length(weight, entry.back(), "weight");
    monomial = starts_of(arrays, "monomial", terms);
    coefficient = numbers_of(arrays, "coefficient_of_monomial");
    require_length(coefficient, monomial.back(), "coefficient_of_monomial");
    factor = starts_of(arrays, "factor", monomial.back());
    factor_row = integers_of(arrays, "factor_row", double(rows));
    exponent = integers_of(arrays, "exponent", MOST_POWER);
    require_length(factor_row, factor.back(), "factor_row"), require_length(exponent, factor.back(), "exponent");
    require(std::find(exponent.begin(), exponent.end(), 0u) == exponent.end(), "exponent", "has a zero");
    for (size_t k = 0; k < terms; ++k) {
        require(kind[k] == POLYNOMIAL || monomial[k] == monomial[k + 1], "monomial", "has some of a linear term");
        for (uint32_t f = factor[monomial[k]]; f < factor[monomial[k + 1]]; ++f)
            require(factor_row[f] >= row[k] && factor_row[f] < row[k + 1], "factor_row", "has rows of another term");
    }
    tables.base.terms = {int64_t(terms),  kind.data(),   row.data(),      target.data(),      offset.data(),
                         entry.data(),    column.data(), weight.data(),   monomial.data(),    coefficient.data(),
                         factor.data(),   factor_row.data(), exponent.data(), 0,              nullptr};
}

void StoredFlow::read_bodies(const NamedArrays& arrays) {
    const std::vector<uint32_t> bodies = integers_of(arrays, "bodies", double(kind.size()));
    body_column = integers_of(arrays, "body_column", double(tables.base.state.size));
    body = numbers_of(arrays, "body");
    require_length(body_column, BODY_COLUMNS * bodies.size(), "body_column");
    require_length(body, BODY_CONSTANTS * bodies.size(), "body");
    called.assign(kind.size(), -1);
    for (size_t b = 0; b < bodies.size(); ++b) {
        const uint32_t k = bodies[b];
        require(called[k] < 0, "bodies", "has a term twice");
        require(kind[k] == LINEAR && row[k + 1] - row[k] == BODY_ROTATIONS, "bodies", "has a term that is no body");
        called[k] = int64_t(b);
    }
    for (size_t p = 0; p + 1 < share.size(); ++p)
        for (uint32_t k = share[p]; k < share[p + 1]; ++k)
            require((called[k] < 0) == (called[share[p]] < 0), "bodies", "fills no whole parts");
}

void StoredFlow::read_action(const NamedArrays& arrays, const std::string& name, StoredAction& action) {
    const auto column_of = [&](const char* label) { return integers_of(arrays, name + "." + label, ANY); };
    action.kind = integers_of<uint8_t>(arrays, name + ".kind", double(RATIONAL_CUBIC) + 1.0);
    const size_t runs = action.kind.size(), parts = share.size() - 1;
    action.run = starts_of(arrays, name + ".run", parts);
    require(action.run.back() == runs, name + ".run", "has other runs than kind");
    action.angles = column_of("angles"), action.repeat = column_of("repeat"), action.angle = column_of("angle");
    action.position = column_of("position"), action.constant = column_of("constant");
    action.width = column_of("width"), action.entries = column_of("entries"), action.degree = column_of("degree");
    for (const auto* column : {&action.angles, &action.repeat, &action.angle, &action.position, &action.constant,
                               &action.width, &action.entries, &action.degree})
        require_length(*column, runs, name);
    action.indices = column_of("indices"), action.constants = numbers_of(arrays, name + ".constants");
    for (uint32_t p = 0; p < parts; ++p) check_part(action, name, p);
    action.view = {tables.base.state.size, action.run.data(),      action.kind.data(),     action.angles.data(),
                   action.repeat.data(),   action.angle.data(),    action.position.data(), action.constant.data(),
                   action.width.data(),    action.entries.data(),  action.degree.data(),   action.indices.data(),
                   action.constants.data()};
}

void StoredFlow::check_part(const StoredAction& action, const std::string& name, uint32_t part) const {
    const uint64_t size = uint64_t(tables.base.state.size), known = row[share[part + 1]] - row[share[part]];
    const auto below = [&](uint64_t first, uint64_t count, uint64_t limit) {
        require(first + count <= action.indices.size(), name + ".indices", "is too short");
        for (uint64_t k = first; k < first + count; ++k)
            require(action.indices[k] < limit, name + ".indices", "has an index out of range");
    };
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
        const uint64_t angles = action.angles[run], repeat = action.repeat[run], position = action.position[run];
        const uint64_t width = action.width[run], entries = action.entries[run], blocks = angles * repeat;
        require(angles > 0 && action.angle[run] + angles <= known, name + ".angles", "has more angles than the part");
        require(repeat > 0, name + ".repeat", "has a zero");
        uint64_t constants = angles;
        const int type = action.kind[run];
        if (type == CUBIC || type == RATIONAL_CUBIC || type == SERIES) {
            require(blocks == 1 && width > 0 && width <= size, name + ".width", "is no block of the state");
            require(action.degree[run] < MOST_POWER, name + ".degree", "is too large");
            below(position, width, size);
            below(position + width, width + 1, entries + 1);
            below(position + 2 * width + 1, entries, width);
            const uint32_t* starts = action.indices.data() + position + width;
            require(starts[0] == 0 && starts[width] == entries && std::is_sorted(starts, starts + width + 1),
                    name + ".indices", "has rows that do not ascend");
            constants = type == SERIES ? 1 + entries : CUBIC_HEADER + 3 * entries;
        } else {
            require(type <= SHEAR || type == RATIONAL_ROTATE, name + ".kind", "has an unknown kind");
            require(width == (type == SCALE ? 1 : 2) && entries == 0, name + ".width", "is not that of the kind");
            require(blocks <= action.indices.size(), name + ".indices", "is too short");
            below(position, width * blocks, size);
            constants = type == SHEAR ? blocks : type == PLANE ? 4 * angles : angles;
        }
        require(action.constant[run] + constants <= action.constants.size(), name + ".constants", "is too short");
    }
}

bool StoredFlow::turns_directly(const StoredAction& action, uint32_t part) const {
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
        const double* constants = action.constants.data() + action.constant[run];
        const bool unit = std::all_of(constants, constants + (action.kind[run] == ROTATE ? action.angles[run] : 0),
                                      [](double w) { return std::fabs(w) == 1.0; });
        if (action.kind[run] != ROTATE || !unit) return false;
    }
    return true;
}

void StoredFlow::set_properties() {
    for (uint32_t p = 0; p < properties.size(); ++p) {
        if (called[share[p]] < 0) continue;
        bool bonds = true, unit = true;
        for (uint32_t k = share[p]; k < share[p + 1]; ++k) {
            const double* scale = body.data() + BODY_CONSTANTS * called[k] + 12;
            const uint32_t* columns = body_column.data() + BODY_COLUMNS * called[k];
            bonds = bonds && columns[3] != columns[0] && scale[0] == 1.0 && scale[1] == 1.0 && scale[2] == 1.0;
            for (int i = 0; i < 3; ++i) unit = unit && std::fabs(scale[i]) == 1.0;
        }
        const bool direct = unit && turns_directly(state, p);
        require(!direct || turns_directly(dual, p), "dual_action", "rotates otherwise than state_action");
        properties[p] = uint8_t((direct ? DIRECT : 0) | (bonds ? BONDS : 0));
    }
    if (flow_properties(&tables.base, int64_t(properties.size()))) throw std::bad_alloc();
}

}  // namespace coadjoint
