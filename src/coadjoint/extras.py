"""The extras of the package: which packages each one brings, and the message where one is missing."""

from __future__ import annotations

import importlib.util
import os

EXTRAS = {
    "numba": "functions",
    "xarray": "io",
    "h5netcdf": "io",
    "h5py": "io",
    "zarr": "io",
    "numcodecs": "io",
    "google_crc32c": "io",
    "pydantic": "io",
    "matplotlib": "plot",
    "PIL": "plot",
    "click": "cli",
    "tqdm": "cli",
    "mpmath": "precision",
    "sympy": "algebra",
    "ducc0": "fluids",
    "distributed": "cluster",
    "cryptography": "cluster",
}
"""Package -> the extra that brings it, as pyproject.toml declares it; all others that are imported are requirements."""


class MissingPackageError(ModuleNotFoundError):
    """A package is not installed that only a part of the library needs; the message has the line that installs it."""


def need(what: str, *packages: str) -> None:
    """Refuse what cannot work without a package that is not installed, before anything is computed.

    Nothing is imported: the packages are only looked for.

    Parameters
    ----------
    what : str
        What needs them, as the subject of a sentence.
    *packages : str
        Names of packages, all in `EXTRAS`.

    Raises
    ------
    MissingPackageError
        With all that are missing, and the line that installs them; or Numba's compiler is turned off.

    Examples
    --------
    >>> need("progress=True", "tqdm")
    """
    missing = [name for name in packages if not installed(name)]
    if not missing:
        if "numba" in packages and os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            raise MissingPackageError(
                f"{what} needs the compiler of numba, which the environment variable NUMBA_DISABLE_JIT turns off; "
                "unset it",
                name="numba",
            )
        return
    extras = ",".join(dict.fromkeys(EXTRAS[name] for name in missing))
    named = missing[0] if len(missing) == 1 else f"{', '.join(missing[:-1])} and {missing[-1]}"
    them, are, word = ("it", "is", "package") if len(missing) == 1 else ("them", "are", "packages")
    raise MissingPackageError(
        f"{what} needs the {word} {named}, which {are} not installed; "
        f'install {them} with: pip install "coadjoint[{extras}]"',
        name=missing[0],
    )


def installed(name: str) -> bool:
    """Say whether a package is there; it is not imported.

    Examples
    --------
    >>> installed("numpy")
    True
    """
    try:
        return importlib.util.find_spec(name) is not None
    except ValueError:  # the module was put into sys.modules without a specification
        return True
