"""Optional dependencies: the extra that provides each package, and the error if one is missing."""

from __future__ import annotations

import importlib.util
import os

EXTRAS = {
    "numba": "functions",
    "xarray": "io",
    "pandas": "io",
    "h5netcdf": "io",
    "h5py": "io",
    "zarr": "io",
    "numcodecs": "io",
    "google_crc32c": "io",
    "pydantic": "io",
    "pyarrow": "parquet",
    "matplotlib": "plot",
    "PIL": "plot",
    "click": "cli",
    "tqdm": "cli",
    "mpmath": "precision",
    "sympy": "algebra",
    "ducc0": "fluids",
    "distributed": "cluster",
    "cryptography": "cluster",
    "fsspec": "remote",
    "trimesh": "bodies",
    "mujoco": "mujoco",
    "sgp4": "orbits",
    "ppigrf": "orbits",
    "spiceypy": "spice",
    "gemmi": "crystals",
    "spglib": "crystals",
    "periodictable": "crystals",
    "jax": "jax",
    "torch": "torch",
}
"""Package -> the extra that provides it, as declared in pyproject.toml; other imported packages are requirements."""


class MissingPackageError(ModuleNotFoundError):
    """An optional package is not installed; the message has the command that installs it."""


def require_packages(what: str, *packages: str) -> None:
    """Raise a MissingPackageError about `what` if a package is not installed, or the compiler of Numba is disabled."""
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
    """Return whether a package is installed, without importing it."""
    try:
        return importlib.util.find_spec(name) is not None
    except ValueError:  # the module is in sys.modules without a spec
        return True
