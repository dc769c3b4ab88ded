"""The model of configuration files: all tables, with the keys, types, defaults, rules and descriptions of the rest."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, WithJsonSchema, model_validator

from coadjoint.files.configuration.tables import (
    CONFIG,
    Algebra,
    Energy,
    Initial,
    Name,
    Polynomial,
    Span,
    SystemTable,
    Table,
    Vector,
    WholeNumber,
    as_written,
)
from coadjoint.runs.times import output_times_of, times_of
from coadjoint.short_repr import short

GRIDS = ("linear", "logarithmic")
DISTRIBUTIONS = ("uniform", "normal", "sphere", "orbit")
SETTING_KINDS = ("values", *GRIDS, *DISTRIBUTIONS, "file")
MAX_SEED = 2**63 - 1

Two = Annotated[list[Any], Field(min_length=2, max_length=2)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
DatasetFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(nc|zarr)(/\.?)*$"})]
FigureFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(png|pdf|svg)(/\.?)*$"})]
MovieFile = Annotated[str, WithJsonSchema({"type": "string", "pattern": r"\.(mp4|gif)(/\.?)*$"})]


class RunTable(Table):
    """The times of the run, and what is saved and watched. Either `step` or `accuracy`."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["step"]}, {"required": ["accuracy"]}]})

    t_span: Span
    """Start and end (time); the run goes backward if the end is the smaller one."""
    step: Positive | None = None
    """Length of a step (time); it divides the span."""
    accuracy: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Instead of `step`: the required error of the momentum at the end, relative to the largest momentum during the run
    (no unit). The step is chosen, and without `method` also the scheme."""
    save_every: WholeNumber = 1
    """Number of steps from one saved state to the next."""
    t_eval: Vector | None = None
    """Times at which states are saved, instead of `save_every` (time)."""
    watch: bool = True
    """Whether the invariants are computed after every step, or only at the saved states."""
    threads: WholeNumber | None = None
    """Number of threads for the members of an ensemble; by default all cores. Results do not depend on it."""
    workers: WholeNumber | None = None
    """Number of processes of this machine that run the members in blocks; by default this process only."""

    @model_validator(mode="after")
    def _check_times(self) -> RunTable:
        if (self.step is None) == (self.accuracy is None):
            problem = "step is missing" if self.step is None else "step and accuracy are both given"
            raise ValueError(f"{problem}; give step, or accuracy to have it chosen")
        if self.step is not None:
            times = times_of(self.t_span, self.step, self.save_every)
            if self.t_eval is not None:
                output_times_of(self.t_eval, times, self.save_every)
        return self

    @property
    def span(self) -> tuple[float, float]:
        """Start and end."""
        return float(self.t_span[0]), float(self.t_span[1])


class EventTable(Table):
    """An event: a function of the state passes through zero."""

    g: Annotated[int | Polynomial, as_written("the number of a coordinate, its name, or a polynomial")]
    """The function: the number of a coordinate, from 0, its name, or a polynomial."""
    direction: Annotated[int, WithJsonSchema({"enum": [-1, 0, 1]})] = 0
    """1 where g rises, -1 where it falls, 0 for both."""
    count: WholeNumber | None = None
    """Number of crossings recorded for each member; by default all."""
    terminal: bool = False
    """Whether the run ends at the last recorded crossing."""


class OutputTable(Table):
    """Paths of the results, relative to the current directory."""

    file: DatasetFile | None = None
    """The solution as a dataset, .nc or .zarr."""
    archive: str | None = None
    """A new folder, such as run.zarr, to which the run is written while it runs; `coadjoint resume` continues it."""
    figure: FigureFile | None = None
    """A figure of the run, .png, .pdf or .svg."""
    movie: MovieFile | None = None
    """A movie of the run, .mp4 or .gif."""


class SettingsTable(Table):
    """The values of one key of the file: listed values, a grid, random numbers, or the rows of an array."""

    values: Annotated[list[Any], Field(min_length=1)] | None = None
    """The values themselves; a plain list means the same."""
    linear: Two | None = None
    """A grid from the first number to the last, in equal steps (unit of the key)."""
    logarithmic: Two | None = None
    """A grid from the first number to the last, in equal ratios (unit of the key)."""
    count: Annotated[int, Field(ge=2)] | None = None
    """Number of values of a grid."""
    uniform: Two | None = None
    """Random numbers between the first and the second (unit of the key)."""
    normal: Two | None = None
    """Random numbers of this mean and this standard deviation (unit of the key)."""
    sphere: Positive | None = None
    """Random vectors of this length (unit of the key)."""
    orbit: Positive | None = None
    """States on the coadjoint orbit of the state in the file, moved by random group elements of this size."""
    file: str | None = None
    """The rows of an array in a file .npy, relative to the folder of this file."""
    column: Annotated[int, Field(ge=0)] | None = None
    """The column of the array, from 0; by default the whole row."""

    @model_validator(mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return {"values": value} if isinstance(value, list) else value

    @model_validator(mode="after")
    def _exactly_one_kind(self) -> SettingsTable:
        kinds = [kind for kind in SETTING_KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            problem = f"has {' and '.join(kinds)}; give one" if kinds else "has none"
            raise ValueError(f"{problem} of {', '.join(SETTING_KINDS)}")
        if (self.count is None) == (kinds[0] in GRIDS):
            raise ValueError(f"count belongs to a grid, {' or '.join(GRIDS)}, and is its number of values")
        if self.column is not None and self.file is None:
            raise ValueError("column belongs to file, and selects a column of the array")
        return self

    @property
    def kind(self) -> str:
        """The kind of settings, one of `SETTING_KINDS`."""
        return next(kind for kind in SETTING_KINDS if getattr(self, kind) is not None)


class SweepTable(Table):
    """The keys of the file that change from member to member, and the number of random members."""

    samples: WholeNumber | None = None
    """Number of random members."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] | None = None
    """The seed of the random numbers."""
    over: Annotated[dict[str, SettingsTable], Field(min_length=1)]
    """Keys of the file, such as "initial.x[0]", and the values of each. Every combination is a member."""

    @model_validator(mode="after")
    def _check_samples(self) -> SweepTable:
        random_keys = [key for key, settings in self.over.items() if settings.kind in DISTRIBUTIONS]
        if random_keys and (self.samples is None or self.seed is None):
            raise ValueError(f"over {short(random_keys[0])} is random; give samples (their number) and seed")
        if not random_keys and (self.samples is not None or self.seed is not None):
            raise ValueError(f"samples and seed belong to random settings, {', '.join(DISTRIBUTIONS)}; there are none")
        return self


class File(BaseModel):
    """A run: the system, the initial state, the scheme, the times, and the paths of the results."""

    model_config = CONFIG | ConfigDict(validate_assignment=True)

    name: Name | None = None
    """The name of the system, for pictures and messages."""
    sign: Annotated[int, WithJsonSchema({"enum": [1, -1]})] | None = None
    """1: x' = J grad H, the default. -1: x' = -J grad H, the convention of the body."""
    system: SystemTable | None = None
    """A ready-made system; `coadjoint systems` lists them."""
    algebra: Algebra | None = None
    """In place of `system`: an algebra of the catalogue, or one given by brackets or matrices."""
    hamiltonian: Energy | None = None
    """The energy H on the dual of `algebra`: x.Mx/2 + linear.x + constant, or a formula or polynomial."""
    casimirs: dict[Name, Polynomial] | None = None
    """Polynomials by name, checked to be Casimirs and recorded during the run."""
    forces: list[dict[str, Any]] = []
    """Forces in addition to H, one table for each: its name and its parameters."""
    initial: Initial
    """The initial state, or several; or a kind of state, with its parameters as further keys."""
    sweep: SweepTable | None = None
    """The keys of the file that change from member to member, and the number of random members."""
    method: dict[str, Any] | None = None
    """The scheme: its name and its parameters. `coadjoint methods` lists them."""
    run: RunTable
    """The times of the run, and what is saved and watched."""
    observe: dict[Name, Polynomial] = {}
    """Polynomials by name, evaluated at the saved states."""
    events: dict[Name, EventTable] = {}
    """Events by name."""
    output: OutputTable = Field(default_factory=OutputTable)
    """Paths of the results, relative to the current directory."""
