"""Variables of the dataset of a solution, as name -> (dimensions, values, attributes), and the layout of states."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.datasets.named_axes import unstacked
from coadjoint.files.datasets.writers import CHECKSUM, with_checksum
from coadjoint.files.records.entries import parsed
from coadjoint.files.records.reconstruction import invariants_of
from coadjoint.files.records.records import record_of, safe_name
from coadjoint.labels import COMPLEX_PARTS, STATE_DIMENSIONS
from coadjoint.optional_packages import installed
from coadjoint.runs.events import RecordedEvents
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import are_rotations, rotations_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import differing_numbers
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.matrices.labelled_fields import VELOCITIES

Floats = NDArray[np.float64]
MAX_DEFAULT_BYTES = 1 << 27
"""Size of the fields above which a dataset has them only for a given grid."""


def state_dimensions(states: NDArray[Any], before: int) -> tuple[str, ...]:
    """Return the dimensions of one state, for arrays with `before` leading axes."""
    dimensions = STATE_DIMENSIONS[states.ndim - before - 1]
    return (*dimensions, "part") if np.iscomplexobj(states) else dimensions


def split_complex(states: NDArray[Any]) -> NDArray[np.float64]:
    """Convert complex states to real and imaginary parts along a last axis; return real states unchanged."""
    return np.stack([states.real, states.imag], axis=-1) if np.iscomplexobj(states) else states


def joined_complex(values: NDArray[Any], dims: Sequence[Any]) -> NDArray[Any]:
    """Convert the parts of complex numbers along a last dimension ``part`` to these: the inverse of `split_complex`."""
    return values[..., 0] + 1j * values[..., 1] if dims[-1:] == ("part",) else values


def state_of(dataset: xarray.Dataset, name: str, allowed: tuple[tuple[str, ...], ...]) -> NDArray[Any]:
    """Read an initial variable as float64 or complex128, optionally over members; ValueError unless valid."""
    if name not in dataset:
        raise ValueError(f"the dataset has no variable {name!r}; it is damaged, or was not written by coadjoint")
    variable = dataset[name]
    dims = variable.dims[1:] if variable.dims[:1] == ("member",) else variable.dims
    is_complex = dims[-1:] == ("part",)
    if (dims[:-1] if is_complex else dims) not in allowed or not variable.size:
        expected = " or ".join(map(str, allowed))
        raise ValueError(f"{name} is over {variable.dims}; it must be over {expected}, or members and these")
    if variable.dtype.kind not in "if" or not np.isfinite(variable.values).all():
        raise ValueError(f"{name} contains values that are not finite numbers")
    values = np.asarray(variable.values, dtype=np.float64)
    if is_complex and values.shape[-1] != len(COMPLEX_PARTS):
        raise ValueError(f"{name} has {values.shape[-1]} parts; complex numbers have {len(COMPLEX_PARTS)}")
    return joined_complex(values, variable.dims)


if TYPE_CHECKING:
    import xarray


Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]

CONVENTIONS = "CF-1.11"
TIME = "time"
OBSERVED_NAMES, FORMULAS = "observed", "observed_formulas"
"""Attributes with the observed quantities: their names in the order of the run, and those that are no functions."""
SIZES = "drift_scale"
"""Variable with the sizes of the invariants of a run with functions, which are not stored."""


def formulas_of(attributes: Mapping[Any, Any], system: Any) -> dict[str, Any]:
    """Return the observed formulas of a stored run, in the order of the run."""
    formulas = invariants_of(parsed(attributes[FORMULAS], FORMULAS), system.dim) if FORMULAS in attributes else {}
    names = parsed(attributes.get(OBSERVED_NAMES, "[]"), OBSERVED_NAMES).texts()
    return {name: formulas[name] for name in names if name in formulas}


def cf_attributes(long_name: str) -> dict[str, Any]:
    """Return CF attributes of a quantity, in the units of the system."""
    return {"long_name": long_name, "units": "1"}


def time_coordinate(times: NDArray[np.float64]) -> Variables:
    """Return the time coordinate of the saved points."""
    return {TIME: ((TIME,), times, cf_attributes("time"))}


def time_variables(solution: Solution) -> Variables:
    """Return the variables at the saved points, except the times."""
    dims, x = ("time", *_member(solution)), solution.x
    variables: Variables = {
        "x": ((*dims, *state_dimensions(x, len(dims))), split_complex(x), cf_attributes("momentum")),
        "energy": (dims, solution.energy, cf_attributes("energy")),
    }
    for kind, series in (("casimir", solution.casimirs), ("observed", solution.observed)):
        for label, (name, values) in _labels(kind, series):
            variables[label] = (dims, values, cf_attributes(name))
    if solution.work:
        work = [values for of_force in solution.work.values() for values in of_force.values()]
        long_name = "what a force has changed of an invariant since the start"
        variables["work"] = ((*dims, "account"), np.stack(work, axis=-1), cf_attributes(long_name))
    if solution.attitude is not None:
        variables["attitude"] = ((*dims, "row", "column"), solution.attitude, cf_attributes("group element"))
    return variables


def angular_motion_variables(solution: Solution) -> Variables:
    """Return the motion of bodies: attitudes, angular velocities, momenta, centres, and rotors; else nothing."""
    variables: Variables = {}
    dims, systems = ("time", *_member(solution)), [one.unforced for one in solution.system.distinct]
    if not all(hasattr(one, "angular_velocity") for one in systems):
        return variables

    def add(name: str, values: NDArray[np.float64], axis: str, long_name: str) -> None:
        of_body = ("body",) * (values.ndim - len(dims) - 1)
        variables[name] = ((*dims, *of_body, axis), values, cf_attributes(long_name))

    for name in ("angular_velocity", "angular_momentum"):
        add(name, getattr(solution, name), "axis", f"{name.replace('_', ' ')} in the body frame")
    if all(hasattr(one, "positions") for one in systems):
        add("position", solution.positions, "axis", "position of the centre of mass in space")
        add("velocity", solution.velocities, "axis", "velocity of the centre of mass in space")
    if all(one.has_attitude for one in systems):
        rotations: Any = solution._of_bodies("attitudes", "attitude")
    else:
        rotations = rotations_of(solution.attitude) if solution.carried == "representation" else None
    if rotations is not None:
        part = "component_of_quaternion"
        add("quaternion", _quaternions(rotations), part, "unit quaternion of the attitude, from the body to space")
        variables[part] = ((part,), np.asarray(list("xyzw")), {"long_name": "component of a quaternion"})
    for name, rotors, axis in (("wheel_speed", "wheels", "wheel"), ("gimbal_angle", "gyros", "gyro")):
        if all(len(getattr(one, rotors, ())) for one in systems):
            long_name = f"{name.replace('_', ' ')}s relative to the body [radians]"
            add(name, solution._of_bodies(f"{name}s", name), axis, long_name)
    return variables


def _quaternions(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternions (k, ..., 4) of rotations over time without changes of sign; NaN for other matrices."""
    from scipy.spatial.transform import Rotation

    proper, found = are_rotations(rotations), np.full((*rotations.shape[:-2], 4), np.nan)
    if proper.any():
        found[proper] = Rotation.from_matrix(rotations[proper]).as_quat(canonical=True)
    opposite = (found[1:] * found[:-1]).sum(axis=-1, keepdims=True) < 0.0
    found[1:] *= np.cumprod(np.where(opposite, -1.0, 1.0), axis=0)
    return found


def summary_variables(solution: Solution) -> Variables:
    """Return the variables of the whole run: deviations of invariants, and failures of members."""
    member = _member(solution)
    over = "in each tenth of the run, over " + ("every step" if solution.watched else "the saved points")
    changes, about = solution.change(relative=False), f"largest absolute deviation from the start {over}"
    dims = (*member, "invariant", "tenth")
    tenths = np.stack([drift.tenths for drift in changes.values()], axis=-2)
    variables: Variables = {"change" if solution.work else "drift": (dims, tenths, cf_attributes(about))}
    if solution.work:
        about = f"largest absolute deviation of an invariant, less the work of all forces, {over}"
        balances = np.full_like(tenths, np.nan)  # NaN for invariants without a work integral
        for name, drift in solution.balance(relative=False).items():
            balances[..., list(changes).index(name), :] = drift.tenths
        variables["balance"] = (dims, balances, cf_attributes(about))
    if solution.failed is not None:
        variables["failed"] = (
            member,
            solution.failed,
            {"long_name": "whether the member failed; its later states are NaN"},
        )
    return variables


def start_variables(solution: Solution) -> Variables:
    """Return the initial states and group elements, and the sizes of invariants that depend on lost functions."""
    member, x0 = _member(solution), solution.x0
    of_state = state_dimensions(x0, len(member))
    variables: Variables = {"x0": ((*member, *of_state), split_complex(x0), cf_attributes("initial momentum"))}
    if solution.attitude0 is not None:
        variables["attitude0"] = (
            (*member, "row", "column"),
            solution.attitude0,
            cf_attributes("initial group element"),
        )
    if "not_stored" in record_of(solution.system):
        sizes = np.stack(list(solution._scales.values()), axis=-1)
        about = "size of an invariant, to which deviations are relative"
        variables[SIZES] = ((*member, "invariant"), sizes, cf_attributes(about))
    return variables


def coordinates_of(solution: Solution) -> Variables:
    """Return the times, and the labels of the other dimensions."""
    system, of_state = solution.system, state_dimensions(solution.x0, len(_member(solution)))
    coordinates = time_coordinate(solution.t)

    def add(name: str, values: Any, long_name: str) -> None:
        coordinates[name] = ((name,), np.asarray(values), {"long_name": long_name})

    if of_state == ("component",):
        names = coordinate_names(system)
        add("component", list(names), "coordinate")
    elif of_state[-1] == "part":
        add("part", list(COMPLEX_PARTS), "part of a complex number")
    changes = solution.change(relative=False)
    add("invariant", list(changes), "what the motion keeps")
    tenths = next(iter(changes.values())).tenths.shape[-1]
    add("tenth", np.arange(1, tenths + 1), "number of a tenth of the run")
    if solution.work:
        add(
            "account",
            [f"{force}: {name}" for force, name in work_integrals_of_solution(solution)],
            "force, and what it changes",
        )
    return coordinates


def parameters_of(system: Any) -> Variables:
    """Return the numbers in which the systems of a batch differ, over the members, named like those of a sweep."""
    return over_members(differing_numbers(system)) if system.is_batch else {}


def over_members(values: Mapping[str, Any]) -> Variables:
    """Return the settings of a sweep, key -> values, as coordinates over the members."""
    return {name: (("member",), numbers, {"long_name": key}) for name, (key, numbers) in as_coordinates(values).items()}


def as_coordinates(values: Mapping[str, Any]) -> dict[str, tuple[str, NDArray[Any]]]:
    """Return the settings of a sweep as coordinates along the members: name -> key, and a value for each member."""
    # Whole states are omitted, since a dataset has them as ``x0``.
    coordinates: dict[str, tuple[str, NDArray[Any]]] = {}
    for key, settings in values.items():
        if key == "initial.x":
            continue
        array = np.array(settings)
        if array.dtype.kind not in "iufbU":
            array = np.array([str(setting) for setting in settings])
        columns = (
            {key: array}
            if array.ndim == 1
            else {
                f"{key}{''.join(f'[{k}]' for k in indices)}": array[(slice(None), *indices)]
                for indices in np.ndindex(*array.shape[1:])
            }
        )
        for full_key, column in columns.items():
            last = full_key
            for table in ("system.parameters.", "algebra.parameters.", "initial."):
                last = last.removeprefix(table)
            coordinates[_unused(f"swept_{safe_name(last)}", coordinates)] = (full_key, column)
    return coordinates


def work_integrals_of_solution(solution: Solution) -> list[tuple[str, str]]:
    """Return the pairs of force and invariant for which work is recorded."""
    return [(force, name) for force, of_force in solution.work.items() for name in of_force]


def _member(solution: Solution) -> tuple[str, ...]:
    return () if solution.failed is None else ("member",)


def _unused(name: str, used: Collection[str]) -> str:
    """Return a name, with a number if it is used already."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(label for label in itertools.chain([name], numbered) if label not in used)


def _labels(kind: str, series: Mapping[str, Any]) -> Iterable[tuple[str, tuple[str, Any]]]:
    """Assign unique variable names, since `safe_name` may map several names to one."""
    labels: dict[str, tuple[str, Any]] = {}
    for name, values in series.items():
        labels[_unused(f"{kind}_{safe_name(name)}", labels)] = (name, values)
    return labels.items()


def vorticity_variables(solution: Solution, grid: Any) -> tuple[Variables, Variables]:
    """Return variables and coordinates of vorticity on a grid (None: if not large); empty without a fluid."""
    fluid = _fluid_of(solution.system)
    if fluid is None:
        if grid is None or grid is False:
            return {}, {}
        raise TypeError(f"grid is {short(grid)}, and {solution.system.name} has no vorticity on a grid; omit it")
    on_sphere = fluid.surface == "sphere"
    if grid is False or (grid is None and on_sphere and not installed("ducc0")):
        return {}, {}
    shape = None if grid is None or grid is True else grid
    rows, columns = fluid.grid(shape)
    dims: tuple[str, ...] = ("time", *_member(solution))
    system: Any = solution.system.unforced
    layered = system.independent_layers
    owner = system if layered else fluid
    shown: dict[str, Any] = owner.shown_fields
    two = solution.x.ndim == len(dims) + 3 and not layered
    dims = (*dims, "layer") if layered else dims
    if two:
        carried, long_name = system.carried_field
        shown = {carried: (long_name, fluid.matrices, 0.0), **shown}
    size = 8 * int(np.prod(solution.x.shape[: len(dims)])) * len(rows) * len(columns) * len(shown)
    if grid is None and size > MAX_DEFAULT_BYTES:
        return {}, {}
    axes = ("latitude", "longitude") if on_sphere else ("eastward", "northward")
    found: Variables = {}
    for name, (long_name, matrices_of, mean) in shown.items():
        if two:
            W = solution.x[..., 0, :, :] if name == carried else system.fluid_state(solution.x)
        else:
            W = owner.matrices(solution.x)
        values = _on_grid(matrices_of(W), lambda finite: fluid.to_grid(finite, shape, absolute=True))
        found[name] = ((*dims, *axes), values + mean, cf_attributes(long_name))
    if grid is not None:
        W = system.relative(solution.x) if layered else system.fluid_state(solution.x)
        both = _on_grid(W, lambda finite: np.stack(fluid.velocity(finite, shape), axis=1))
        for k, (name, (long_name, _)) in enumerate(VELOCITIES.items()):
            found[name] = ((*dims, *axes), both[..., k, :, :], cf_attributes(long_name))
    return found, _coordinates(on_sphere, rows, columns)


def _fluid_of(system: Any) -> Any:
    """Return the fluid of a system; None for other systems."""
    return None if system.is_batch or not system.has_matrices else system.unforced.fluid


def with_vorticity(dataset: xarray.Dataset, solution: Solution, grid: Any) -> xarray.Dataset:
    """Return the dataset of a stored run with the fields on a grid, in place of those that it has."""
    import xarray

    fluid = _fluid_of(solution.system)
    system: Any = solution.system
    shown = () if fluid is None else (system.unforced if system.unforced.independent_layers else fluid).shown_fields
    names = (*shown, *VELOCITIES, "carried", "buoyancy", "latitude", "longitude", "eastward", "northward")
    rest = dataset.drop_vars(names, errors="ignore")
    found, coordinates = vorticity_variables(solution, grid)
    of_run = xarray.Dataset(found, coordinates, dict(dataset.attrs))
    fields = unstacked(of_run)
    result = rest.assign(fields.data_vars).assign_coords({name: fields[name] for name in coordinates})
    return with_checksum(result) if CHECKSUM in dataset.attrs else result


def _on_grid(W: NDArray[Any], values_of: Callable[[NDArray[Any]], Floats]) -> Floats:
    """Return the values on a grid of matrices (..., N, N), by a function of (k, N, N); NaN after a failure."""
    finite = np.isfinite(W).all(axis=(-2, -1))
    values = values_of(W[finite])
    result = np.full((*finite.shape, *values.shape[1:]), np.nan)
    result[finite] = values
    return result


def _coordinates(on_sphere: bool, rows: Floats, columns: Floats) -> Variables:
    if not on_sphere:
        units = {"units": "radian"}
        return {
            "eastward": (("eastward",), rows, {"long_name": "position x, to the right", **units}),
            "northward": (("northward",), columns, {"long_name": "position y, up", **units}),
        }
    named = (("latitude", rows, "degrees_north"), ("longitude", columns, "degrees_east"))
    return {
        # Rounded, so that whole degrees are found by their labels.
        name: ((name,), np.round(np.degrees(values), 12), {"standard_name": name, "long_name": name, "units": units})
        for name, values, units in named
    }


def event_variables(events: RecordedEvents) -> dict[str, Any]:
    """Return crossings as variables of a dataset, over ``crossing``."""
    dims = ("crossing",)
    variables: dict[str, Any] = {
        "event_time": (dims, events.t, cf_attributes("time of a crossing")),
        "event_x": ((*dims, *state_dimensions(events.x, 1)), split_complex(events.x), cf_attributes("momentum there")),
        "event_which": (dims, events.which, {"long_name": "number of the event"}),
        "event_member": (dims, events.member, {"long_name": "member that crosses"}),
        "event_direction": (dims, events.direction, {"long_name": "1 where g rises, -1 where it falls"}),
    }
    if events.attitude is not None:
        variables["event_attitude"] = ((*dims, "row", "column"), events.attitude, cf_attributes("group element there"))
    return variables
