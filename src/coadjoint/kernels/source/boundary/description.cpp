// Everything that Python and the kernels share, as text: a line for each table, each kind of arrays, and each list of
// codes.
#include <string>

#include "boundary/arrays.hpp"
#include "boundary/codes.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

EXPORT const char* description() {
    static const std::string all =
        std::string(Terms_fields) + Forms_fields + SharedFunction_fields + CellConvolution_fields + Action_fields + FlowTables_fields + Watch_fields + EventTables_fields + Extent_fields +
        Schedule_fields + WholeRun_fields + Field_fields + GroupField_fields + RungeKuttaTables_fields + StepTables_fields +
        ForceTable_fields + Stepping_fields + Tangents_fields + FlowTangents_fields + RungeKuttaTangents_fields + FlowCotangents_fields + RungeKuttaCotangents_fields + ForwardRun_fields + BackwardRun_fields + ForceDerivatives_fields + ForcedDerivatives_fields + UnshiftTables_fields +
        Unshifted_fields + saved_arrays + state_arrays + Status_codes + Outcome_codes + crossings::Crossing_codes + TermKind_codes + Role_codes +
        Kind_codes + turns::Turn_codes + StreamKind_codes + Solver_codes + ForceKind_codes + derivatives::FlowDerivative_codes + ModeKind_codes + Shape_codes + Limit_codes;
    return all.c_str();
}

}  // namespace coadjoint
