"""Which keys may the table of a sweep have? Models of `[sweep]`, and of the settings of one place."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from coadjoint.given import is_real
from coadjoint.wording import short

GRIDS = ("linear", "logarithmic")
DRAWN = ("uniform", "normal", "sphere", "orbit")
KINDS = ("values", *GRIDS, *DRAWN, "file")
LARGEST_SEED = 2**63 - 1


def _two(value: Any) -> Any:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"must be a list of two, not {short(value, 60)}")
    return value


def _positive(value: Any) -> Any:
    if not is_real(value) or not 0.0 < value < float("inf"):
        raise ValueError(f"must be a positive number, not {short(value, 60)}")
    return value


Two = Annotated[Any, AfterValidator(_two)]
Positive = Annotated[Any, AfterValidator(_positive)]


class SettingsTable(BaseModel):
    """What one place of the file is set to: listed values, a grid, random numbers, or the rows of an array."""

    model_config = ConfigDict(extra="forbid", strict=True)

    values: list[Any] | None = None
    linear: Two | None = None
    logarithmic: Two | None = None
    count: Annotated[int, Field(ge=1)] | None = None
    uniform: Two | None = None
    normal: Two | None = None
    sphere: Positive | None = None
    orbit: Positive | None = None
    file: str | None = None
    column: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _listed(cls, given: Any) -> Any:
        return {"values": given} if isinstance(given, list) else given

    @model_validator(mode="after")
    def _one_kind(self) -> SettingsTable:
        kinds = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            said = f"has {' and '.join(kinds)}; give one" if kinds else "has none"
            raise ValueError(f"{said} of {', '.join(KINDS)}")
        if (self.count is None) == (kinds[0] in GRIDS):
            raise ValueError(f"count belongs to a grid, {' or '.join(GRIDS)}: how many values it has")
        if self.column is not None and self.file is None:
            raise ValueError("column belongs to file: which column of the array is taken")
        if self.values == []:
            raise ValueError("is an empty list; give at least one value")
        return self

    @property
    def kind(self) -> str:
        """Which of `KINDS` it is."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)


class SweepTable(BaseModel):
    """Which places of the file are other ones for each member, and how many random members there are."""

    model_config = ConfigDict(extra="forbid", strict=True)

    samples: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] | None = None
    over: dict[str, SettingsTable]

    @model_validator(mode="after")
    def _drawn(self) -> SweepTable:
        drawn = [place for place, settings in self.over.items() if settings.kind in DRAWN]
        if not self.over:
            raise ValueError("over is empty; name at least one place of the file, such as 'initial.x[0]'")
        if drawn and (self.samples is None or self.seed is None):
            raise ValueError(f"over {short(drawn[0])} is random; give samples, how many, and seed")
        if not drawn and (self.samples is not None or self.seed is not None):
            raise ValueError(f"samples and seed belong to random settings, {', '.join(DRAWN)}; there are none")
        return self
