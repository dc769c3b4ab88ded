// Single trajectories with member constants: copied into tables, these are shared constants.
#include <deque>
#include <vector>

#include "boundary/codes.hpp"
#include "stages/single.hpp"

namespace coadjoint {

namespace {

class MemberTables {
  public:
    RungeKuttaTables tables;

    MemberTables(const RungeKuttaTables& all, const MemberConstants& constants) : tables(all), constants(constants) {
        Field& field = tables.field;
        Terms& terms = field.terms;
        const int64_t n = field.size, rows = terms.row[terms.size];
        take(numbers, field.constant, field.first[n]);
        take(numbers, field.own_constant, field.separated ? field.own_first[n] : 0);
        take(addresses, field.structure, field.nonlinear ? 1 : 0);
        take(addresses, field.addresses, terms.size);
        take(numbers, terms.offset, rows);
        take(numbers, terms.weight, terms.entry[rows]);
        take(numbers, terms.coefficient, terms.monomial[terms.size]);
        take(numbers, tables.group.value, tables.group.entries);
        take(numbers, tables.quadratic, tables.direct && tables.solver == STRUCTURE ? n * n : 0);
    }

  private:
    const MemberConstants constants;
    std::deque<std::vector<double>> numbers;
    std::deque<std::vector<int64_t>> addresses;

    template <class T>
    void take(std::deque<std::vector<T>>& copies, T*& table, int64_t count) {
        std::vector<T>& own = copies.emplace_back(count);
        for (int64_t i = 0; i < count; ++i) own[i] = table[i * constants.stride + constants.first];
        table = own.data();
    }
};

}  // namespace

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const MemberConstants& constants) {
    const auto own = std::make_shared<const MemberTables>(tables, constants);
    std::unique_ptr<Single> single = single_of(own->tables, SharedConstants{});
    single->own_tables = own;
    return single;
}

}  // namespace coadjoint
