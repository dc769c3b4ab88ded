"""Constructors accept values at the edges of documented domains, and name the parameter outside them."""

import inspect
import re

import pytest

import coadjoint as co
from coadjoint.algebra import catalogue
from coadjoint.algebra.families.low_dimensional import entries
from coadjoint.methods import registry
from coadjoint.short_repr import short
from domains.of_algebras import ALGEBRAS, CATALOGUE, FAMILIES
from domains.of_parts import FORCES, HAMILTONIANS, OWN_SYSTEMS
from domains.of_schemes import EVENTS, SCHEMES
from domains.of_states import SPHERE, STATES, TORUS
from domains.of_systems import SYSTEMS

PARTS = {**HAMILTONIANS, **OWN_SYSTEMS, **FORCES, **SCHEMES, **EVENTS}
CASES = {**SYSTEMS, **STATES, **ALGEBRAS, **CATALOGUE, **PARTS}
PARAMETERS = [(name, parameter) for name, case in CASES.items() for parameter in case.domains]
# Created by the library, or without parameters of their own.
RESULTS = {"Certificate", "Choice", "Corrector", "Frequencies", "IntegrationError", "LargeStepWarning",
           "LongWait", "Equilibrium", "ThermalStates",
           "LyapunovExponents", "ModifiedField", "ModifiedHamiltonian", "PhaseDrift", "PreparedRun",
           "RecordedEvents", "RoundingWarning", "Section", "Solution"}  # fmt: skip
# Functions of existing systems and schemes; their arguments are in tests/test_hostile_input.py.
USES = {"certify", "choose", "equilibrium", "fit", "frequencies", "identify", "integrate", "integrate_ensemble", "load",
        "lyapunov", "make_corrector", "modified_field", "modified_hamiltonian", "open_archive", "phase_drift",
        "poincare_section", "predicted_drift", "prepare", "resume", "stepper", "suggest_step",
        "thermal_states"}  # fmt: skip
# Base classes of schemes, and parts that are checked only when a scheme is used.
BASES = {"Coefficients", "CompiledStepMethod", "FlowMethod", "Method", "Operations", "RungeKuttaMethod", "StepMethod",
         "Sweep", "Work", "begin", "compile_step", "gauss_tableau", "iterate_to_stagnation", "register"}  # fmt: skip
# Examples of a scheme, and a form whose arrays are not checked.
UNCHECKED = {"examples", "from_entries"}
LOOKED_UP = {"get", "names"}


@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_values_inside_the_domain_are_accepted(name, parameter):
    case = CASES[name]
    for value in case.domains[parameter].inside:
        case(**{**case.arguments(), parameter: value})


@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_values_outside_the_domain_are_refused(name, parameter):
    case = CASES[name]
    domain = case.domains[parameter]
    called = domain.called or rf"\b{parameter}\b"
    wrong = []
    for value in domain.outside:
        try:
            case(**{**case.arguments(), parameter: value})
        except (ValueError, TypeError) as refusal:
            if not re.search(called, str(refusal)):
                wrong.append(f"{short(value)}: its message does not name {parameter}: {refusal}")
        except Exception as error:
            wrong.append(f"{short(value)}: {type(error).__name__}: {error}")
        else:
            wrong.append(f"{short(value)} is accepted")
    assert not wrong, "\n".join(wrong)


def parameters(function):
    named = inspect.signature(function).parameters.items()
    return {key for key, parameter in named if parameter.kind is not parameter.VAR_KEYWORD}


def constructors(owner):
    """Return the names of public class methods that return an object of the class."""
    return {
        name for name, value in vars(owner).items() if isinstance(value, classmethod) and name[0] != "_"
    } - UNCHECKED


def test_constructors_and_parameters_are_listed():
    public = {name: getattr(co, name) for name in dir(co) if name[0] != "_" and callable(getattr(co, name))}
    public = {value.__name__: value for value in public.values()}  # former names are the same objects
    public |= {name: getattr(co.methods, name) for name in co.methods.__all__}
    public = {name: value for name, value in public.items() if name not in RESULTS | USES | BASES | LOOKED_UP}
    assert set(registry.names()) <= set(public)
    blocks = {block.__name__ for block in co.systems.BUILDING_BLOCKS}
    for space in (co.systems, co.forces, co.algebras):
        names = set(space.__all__) - LOOKED_UP - blocks - {"Force", "low_dimensional"}
        public |= {name: getattr(space, name) for name in names}
    for name, owner in list(public.items()):
        if isinstance(owner, type):
            public |= {f"{name}.{one}": getattr(owner, one) for one in constructors(owner)}
    listed = SYSTEMS | ALGEBRAS | PARTS
    assert {name: parameters(value) for name, value in public.items()} == {
        name: set(case.domains) for name, case in listed.items()
    }


def test_initial_states_are_listed():
    for surface, system in (("sphere", SPHERE), ("torus", TORUS)):
        states = {
            f"{surface}, {name}": parameters(getattr(system, name))
            for name in system.states_by_name
            if name != "from_file"
        }
        assert states == {name: set(case.domains) for name, case in STATES.items() if name.startswith(surface)}


def test_algebras_with_parameters_are_listed():
    with_parameters = {name: set(entry["parameters"]) for name, entry in entries().items() if entry.get("parameters")}
    assert with_parameters == {name: set(case.domains) for name, case in CATALOGUE.items() if name in entries()}
    assert {name for name in catalogue.names() if re.search(r"[a-z]\)", name)} == {*FAMILIES, "so(p,q)"}
