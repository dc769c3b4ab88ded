"""Models of the table `[sweep]`, and of the settings of one key."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WithJsonSchema, model_validator

from coadjoint.algebra.exact.numbers import fits
from coadjoint.short_repr import short
from coadjoint.validation import is_real

GRIDS = ("linear", "logarithmic")
DISTRIBUTIONS = ("uniform", "normal", "sphere", "orbit")
SETTING_KINDS = ("values", *GRIDS, *DISTRIBUTIONS, "file")
MAX_SEED = 2**63 - 1


def _two(value: Any) -> Any:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"must be a list of two, not {short(value, 60)}")
    return value


def _positive(value: Any) -> Any:
    if not is_real(value) or not fits(value) or value <= 0:
        raise ValueError(f"must be a positive number, not {short(value, 60)}")
    return value


Two = Annotated[Any, AfterValidator(_two), WithJsonSchema({"type": "array", "minItems": 2, "maxItems": 2})]
Positive = Annotated[Any, AfterValidator(_positive), WithJsonSchema({"type": "number", "exclusiveMinimum": 0})]


class SettingsTable(BaseModel):
    """The values of one key of the file: listed values, a grid, random numbers, or the rows of an array."""

    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)

    values: list[Any] | None = None
    """The values themselves; a plain list means the same."""
    linear: Two | None = None
    """A grid from the first number to the last, in equal steps (unit of the key)."""
    logarithmic: Two | None = None
    """A grid from the first number to the last, in equal ratios (unit of the key)."""
    count: Annotated[int, Field(ge=1)] | None = None
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
        if self.values == []:
            raise ValueError("is an empty list; give at least one value")
        return self

    @property
    def kind(self) -> str:
        """The kind of settings, one of `SETTING_KINDS`."""
        return next(kind for kind in SETTING_KINDS if getattr(self, kind) is not None)


class SweepTable(BaseModel):
    """The keys of the file that change from member to member, and the number of random members."""

    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)

    samples: Annotated[int, Field(ge=1)] | None = None
    """Number of random members."""
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] | None = None
    """The seed of the random numbers."""
    over: dict[str, SettingsTable]
    """Keys of the file, such as "initial.x[0]", and the values of each. Every combination is a member."""

    @model_validator(mode="after")
    def _check_samples(self) -> SweepTable:
        random_keys = [key for key, settings in self.over.items() if settings.kind in DISTRIBUTIONS]
        if not self.over:
            raise ValueError("over is empty; give at least one key of the file, such as 'initial.x[0]'")
        if random_keys and (self.samples is None or self.seed is None):
            raise ValueError(f"over {short(random_keys[0])} is random; give samples (their number) and seed")
        if not random_keys and (self.samples is not None or self.seed is not None):
            raise ValueError(f"samples and seed belong to random settings, {', '.join(DISTRIBUTIONS)}; there are none")
        return self
