"""Solutions as tables of pandas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.optional_packages import require_packages
from coadjoint.systems.coordinates import coordinate_names

if TYPE_CHECKING:
    import pandas as pd

    from coadjoint.runs.results.solution import Solution


def table_of(solution: Solution) -> pd.DataFrame:
    """Return a solution as a table; see `Solution.to_pandas`."""
    require_packages("a table of a solution", "pandas")
    import pandas as pd

    system: Any = solution.system.of_member(0).unforced
    k, members = len(solution.t), None if solution.failed is None else len(solution.failed)
    shape = system.shape
    count = int(np.prod(shape))
    states = solution.x.reshape(k, -1, count)
    columns: dict[str, Any] = {name: states[..., i] for i, name in enumerate(_names(system, shape, count))}
    observed = {name: np.asarray(values) for name, values in solution.observed.items()}
    numbers = {name: values for name, values in observed.items() if values.ndim == (1 if members is None else 2)}
    invariants = {"energy": solution.energy, **solution.casimirs}
    for what, series in (("invariant", invariants), ("observed", numbers)):
        for name, values in series.items():
            # Names of coordinates, invariants and observed quantities may be equal.
            columns[f"{what} {name}" if name in columns else name] = values.reshape(k, -1)
    if members is None:
        return pd.DataFrame({name: values[:, 0] for name, values in columns.items()}, index=_times(solution))
    index = pd.MultiIndex.from_product([range(members), solution.t], names=["member", "time"])
    return pd.DataFrame({name: values.T.ravel() for name, values in columns.items()}, index=index)


def _names(system: Any, shape: tuple[int, ...], count: int) -> tuple[str, ...]:
    if system.has_matrices:
        return tuple("W" + ",".join(str(i + 1) for i in entry) for entry in np.ndindex(*shape))
    return coordinate_names(system, count)


def _times(solution: Solution) -> Any:
    import pandas as pd

    return pd.Index(solution.t, name="time")
