"""Two matrices, a vorticity and a field carried by its flow: reduced magnetohydrodynamics, a passive scalar."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.fluids.sphere_euler import sphere_euler
from coadjoint.systems.fluids.torus_euler import torus_euler
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices.fluid_system import FluidSystem, RelativeVorticity
from coadjoint.systems.matrices.labelled_fields import CARRIED_FIELD
from coadjoint.systems.matrices.matrix_invariants import traces_of
from coadjoint.systems.matrices.matrix_system import POWERS
from coadjoint.systems.matrices.stacked_system import StackedSystem
from coadjoint.systems.matrices.streams import Stream, as_stream
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_choice, read_number, set_fields

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

PICTURES: dict[str, Any] = {
    "pictures": (Picture("vorticity", at=1.0), Picture("vorticity", part="carried", at=1.0), Picture("eigenvalues")),
    "components": Picture("energy by scale"),
}


@suggest_keywords
class TwoLayerSystem(StackedSystem):
    """Two matrices, a carried field Theta and a vorticity W: ``Theta' = [P, Theta]``, ``W' = [P, W] + [J, Theta]``.

    P = stream(W) and J = second_stream(Theta), or zero if the field is passive. A state is an array (2, N, N),
    ``[0]`` Theta and ``[1]`` W: the Lie-Poisson equation of the semidirect product of the algebra with its dual. With
    dual numbers, eps^2 = 0, X = Theta + eps W and Y = P + eps J, it is ``X' = [Y, X]``. So the spectrum of Theta and
    ``tr W Theta^k`` are preserved; for a passive field also the spectrum of W.

    Parameters
    ----------
    algebra : MatrixAlgebra
        The algebra of both matrices, skew-Hermitian.
    stream : Stream
        A symmetric linear map from W to P.
    second_stream : Stream, optional
        A symmetric linear map from Theta to J; omit it for a passive field.
    energy_sign : {1, -1}
        Sign of the energy ``energy_sign (<P, W> + <J, Theta>)/2``.
    name, parameters, powers
        As for `MatrixSystem`; `powers` is the number of invariants of each kind to record.

    Raises
    ------
    TypeError, ValueError
        An argument of the wrong type, or an algebra that is not skew-Hermitian.

    Notes
    -----
    K. Modin, M. Roop, "Spatio-temporal Lie-Poisson discretization for incompressible magnetohydrodynamics on the
    sphere" (2023).

    Examples
    --------
    >>> from coadjoint.systems.matrices.streams import Weights
    >>> half = Weights(np.full((3, 3), 0.5))
    >>> s = TwoLayerSystem(MatrixAlgebra("u", 3), half, half)
    >>> s.shape, list(s.casimirs)[:3]
    ((2, 3, 3), ['tr Theta^2', 'tr W Theta', 'tr Theta^3'])
    """

    def __init__(
        self,
        algebra: MatrixAlgebra,
        stream: Stream,
        second_stream: Stream | None = None,
        *,
        energy_sign: int = 1,
        name: str = "two-layer system",
        parameters: Mapping[str, Any] | None = None,
        powers: int = POWERS,
    ) -> None:
        super().__init__(algebra, stream, energy_sign=energy_sign, name=name, parameters=parameters, powers=powers)
        self._stack(algebra, 2)
        traces = traces_of(algebra, self.powers, self.matrices, self.to_vector)
        self._followed = tuple(trace.power for trace in traces.values() if trace.power > 1)
        self.second_stream = None if second_stream is None else as_stream(second_stream, algebra, "second_stream")
        for what, one in (("stream", self.stream), ("second_stream", self.second_stream)):
            if one is not None and one.kind == "BY_FUNCTION":
                raise TypeError(f"{what} is a function; two layers need a Stream, such as Weights(w)")
        if self.second_stream is not None:
            self._check_stream(self.second_stream)

    layer_names = "the carried field and the vorticity"
    carried_field: tuple[str, str] = "carried", CARRIED_FIELD
    """Name and long name of the carried field in datasets."""
    _fluid: Any = None

    @property
    def fluid(self) -> Any:
        return self._fluid

    def fluid_state(self, x: Any) -> Matrix:
        return self.matrices(x)[..., 1, :, :]

    def relative(self, x: Any) -> Matrix:
        """Return the carried field and the vorticity relative to the frame, of states (..., 2, N, N)."""
        return self._in_frame(x, "relative")

    def absolute(self, X: Any) -> Matrix:
        """Return the states of a carried field and a vorticity relative to the frame; inverse of `relative`.

        Of a list of two matrices the second is one of ``fluid.relative``; states of `fluid` are refused in its place.
        """
        self._check_relative(X)
        return self._in_frame(X, "absolute")

    def _check_relative(self, X: Any) -> None:
        """Raise ValueError for a list with a state of the fluid where a relative vorticity is meant."""
        if not isinstance(X, (list, tuple)) or len(X) != 2 or self._fluid is None or not self._fluid.has_frame:
            return
        if not isinstance(X[1], RelativeVorticity):
            raise ValueError(
                f"absolute of {self.name} was given a vorticity that may be a state of its fluid, as fluid.from_modes "
                "and fluid.random make; give fluid.relative(state), or an array of both matrices"
            )

    def _in_frame(self, x: Any, conversion: str) -> Matrix:
        X = np.array(self.matrices(x))
        if self.linear is not None:
            X[..., 1, :, :] = getattr(self._fluid, conversion)(X[..., 1, :, :])
        return X

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return the energy of states (..., 2, N, N), that of the motion relative to the frame."""
        return super().energy(x, t) if self.linear is None else self._fluid.energy(self.fluid_state(x), t)

    @cached_property
    def casimirs(self) -> dict[str, Any]:
        """Name to function of states (..., 2, N, N)."""
        return {name: _Invariant(self, name) for name in self._names}

    @property
    def quadratic_casimirs(self) -> tuple[str, ...]:
        """Names of the quadratic Casimirs, first in order, for which runs with forces keep balances."""
        return self._names[:2]

    @property
    def _names(self) -> tuple[str, ...]:
        vorticity_names = [] if self.second_stream is not None else [f"tr W^{k}" for k in self._followed]
        return (*(name for k in self._followed for name in (f"tr Theta^{k}", mixed(k))), *vorticity_names)

    def casimirs_at(self, x: Any) -> dict[str, Any]:
        """Return the invariants of states (..., 2, N, N), of -i Theta and -i W if these are complex."""
        X = self.matrices(x)
        base = -1j * X if self.complex else X
        theta, W = base[..., 0, :, :], base[..., 1, :, :]
        values = {}
        for k, power in self._powers(theta):
            values[f"tr Theta^{k}"], values[mixed(k)] = _trace(power, theta), _trace(power, W)
        if self.second_stream is None:
            values |= {f"tr W^{k}": _trace(power, W) for k, power in self._powers(W)}
        return values

    def _powers(self, A: Matrix) -> list[tuple[int, Matrix]]:
        """Return the pairs (k, power k - 1 of matrices)."""
        powers, power, below = [], A, 1
        for k in self._followed:
            while below < k - 1:
                power, below = power @ A, below + 1
            powers.append((k, power))
        return powers

    def slope_of(self, W: Matrix, t: float = 0.0) -> Matrix:
        """Return P and J of states (..., 2, N, N), in this order."""
        P = self.stream(W[..., 1, :, :])
        J = np.zeros_like(P) if self.second_stream is None else self.second_stream(W[..., 0, :, :])
        return np.stack([P, J], axis=-3)

    def slope_transposed(self, Y: Matrix, t: float = 0.0) -> Matrix:
        return self.dual(self.slope_of(self.dual(Y), t))

    def dual(self, Y: Matrix) -> Matrix:
        """Return (J, P) of (P, J): J is the derivative by the carried field, and P that by the vorticity."""
        return Y[..., ::-1, :, :]

    def pairing(self, Y: Matrix, X: Matrix) -> Any:
        return np.sum(np.conj(self.dual(Y)) * X, axis=(-3, -2, -1)).real

    def spectrum(self, x: Any) -> Floats:
        """Return the eigenvalues of -i Theta, real and ascending, of states (..., 2, N, N)."""
        return np.asarray(np.linalg.eigvalsh(-1j * self.matrices(x)[..., 0, :, :]), dtype=np.float64)

    def generic_rank(self) -> int:
        """Return the rank of J at a generic state; each Casimir of the algebra gives two of the layers."""
        return 2 * self.algebra.generic_rank()

    def bracket(self, Y: Matrix, X: Matrix) -> Matrix:
        """Return the commutator of dual numbers, states (..., 2, N, N)."""
        bracket = self.algebra.bracket
        P, J, theta, W = Y[..., 0, :, :], Y[..., 1, :, :], X[..., 0, :, :], X[..., 1, :, :]
        return np.stack([bracket(P, theta), bracket(P, W) + bracket(J, theta)], axis=-3)


def mixed(k: int) -> str:
    """Return the name of the invariant of degree k that is linear in W."""
    return "tr W Theta" if k == 2 else f"tr W Theta^{k - 1}"


def _trace(A: Matrix, B: Matrix) -> Any:
    return np.einsum("...ij,...ji->...", A, B).real


class _Invariant:
    def __init__(self, system: TwoLayerSystem, name: str) -> None:
        self._system, self._name = system, name

    def __repr__(self) -> str:
        return self._name

    def __call__(self, x: Any) -> Any:
        return self._system.casimirs_at(x)[self._name]

    def sum_of_absolute_terms(self, x: Any) -> Any:
        """Return the sum of the products of the singular values, since eigenvalues may cancel."""
        singular = np.linalg.svd(self._system.matrices(x), compute_uv=False)
        theta, W = singular[..., 0, :], singular[..., 1, :]
        power = int(self._name.rpartition("^")[2]) if "^" in self._name else 1
        if self._name.startswith(mixed(2)):
            return np.sum(W * theta**power, axis=-1)
        return np.sum((W if self._name.startswith("tr W") else theta) ** power, axis=-1)


def _two_vortices() -> npt.NDArray[np.complex128]:
    """Return the Orszag-Tang vortex: omega = cos x + cos y, Theta = cos y + cos(2 x)/2."""
    fluid = torus_euler(N=33)
    theta, W = (fluid.from_modes(modes) for modes in ({(0, 1): 0.5, (2, 0): 0.25}, {(1, 0): 0.5, (0, 1): 0.5}))
    return np.stack([theta, W])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_two_vortices,
        t_span=(0.0, 2.0),
        step=0.002,
        caption="The vortex of Orszag and Tang in a conducting fluid: vorticity and magnetic potential fold into each "
        "other, and sheets of vorticity grow where the field is bent. The spectrum of the potential is constant.",
        **PICTURES,
        parameters={"N": 33, "surface": "torus"},
        save_every=20,
        quantity="vorticity",
    )
)
def reduced_mhd(N: int = 17, surface: str = "sphere") -> TwoLayerSystem:
    """Return the equations of an ideal conducting fluid in two dimensions, as two matrices.

    ``W' = [P, W] + [J, Theta]``, ``Theta' = [P, Theta]`` with ``L P = -W`` and ``J = -L Theta``: W is the vorticity,
    Theta the magnetic potential, J the current. Alfven waves propagate along the magnetic field.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Surface of the fluid.

    Returns
    -------
    TwoLayerSystem
        States (2, N, N): Theta and W. Energy: the integral of ``(|u|^2 + |b|^2)/2`` over the surface,
        ``(tr(W* L^-1 W) + tr(Theta* L Theta))/2`` times `energy_unit`. Casimirs tr Theta^k and
        tr W Theta^k, of which k = 1 is the cross helicity.

    Notes
    -----
    K. Modin, M. Roop, "Spatio-temporal Lie-Poisson discretization for incompressible magnetohydrodynamics on the
    sphere" (2023); H. R. Strauss, Phys. Fluids 19 (1976) 134.

    Examples
    --------
    >>> s = reduced_mhd(N=7)
    >>> s.shape, list(s.casimirs)[:2]
    ((2, 7, 7), ['tr Theta^2', 'tr W Theta'])
    """
    return _with_second_field("reduced_mhd", N, surface, acts=True)


def _latitude_as_dye() -> npt.NDArray[np.complex128]:
    """Return a random flow on the sphere with a dye equal to the sine of the latitude."""
    fluid = sphere_euler(N=33)
    return np.stack([fluid.from_modes({(1, 0): 1.0}), fluid.random(seed=3)])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_latitude_as_dye,
        t_span=(0.0, 4.0),
        step=0.02,
        caption="A dye, at the start the sine of the latitude, is wound up by the vortices of a random flow on the "
        "sphere. Above, the vorticity, and below, the dye, at the end. The spectrum of the dye is constant.",
        **PICTURES,
        parameters={"N": 33},
        save_every=4,
        quantity="vorticity",
    )
)
def passive_scalar(N: int = 17, surface: str = "sphere", rotation: float = 0.0) -> TwoLayerSystem:
    """Return an ideal fluid in two dimensions with a passive scalar, as two matrices.

    ``W' = [P, W]``, ``Theta' = [P, Theta]`` with ``L P = -W``: W is the vorticity, Theta the scalar, which does not
    affect the flow. All traces of products of W and Theta are preserved.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Surface of the fluid.
    rotation : float
        Angular velocity of the frame, on the sphere, as for `sphere_euler`: W is the absolute vorticity.

    Returns
    -------
    TwoLayerSystem
        States (2, N, N): Theta and W; ``absolute([Theta, omega])`` makes one of a relative vorticity, and `relative` is
        its inverse. Energy: the integral of ``|u|^2/2`` over the surface, of the motion relative to the frame. Casimirs
        tr Theta^k, tr W Theta^k and tr W^k.

    Raises
    ------
    TypeError, ValueError
        An argument of the wrong type or beyond its range, or a rotation on the torus.

    Notes
    -----
    V. Zeitlin, "Finite-mode analogs of 2D ideal hydrodynamics", Physica D 49 (1991) 353.

    Examples
    --------
    >>> s = passive_scalar(N=7, surface="torus")
    >>> s.shape, "tr W^2" in s.casimirs
    ((2, 7, 7), True)
    """
    rate = read_number(rotation, "rotation")
    if rate and surface == "torus":
        raise ValueError(f"rotation is {rate:g}, and the torus does not rotate; take the force BetaPlane")
    return _with_second_field("passive_scalar", N, surface, acts=False, rotation=rate)


def _with_second_field(name: str, N: int, surface: str, acts: bool, **frame: float) -> TwoLayerSystem:
    """Return an ideal fluid with a second field that it carries, and that acts on it by its current or not at all."""
    place = read_choice(surface, "surface", ("sphere", "torus"))
    ideal: FluidSystem = sphere_euler(N, **frame) if place == "sphere" else torus_euler(N)
    stream: Any = ideal.stream
    system = TwoLayerSystem(
        ideal.algebra,
        stream,
        stream.inverted() if acts else None,
        energy_sign=-1,
        name=name,
        parameters={"N": ideal.algebra.N, "surface": surface, **frame},
    )
    system._fluid, system.energy_unit = ideal, ideal.energy_unit
    set_fields(system, energy_parameters=tuple(frame) if place == "sphere" else ())
    if ideal.linear is not None:
        linear = np.stack([ideal.linear, np.zeros_like(ideal.linear)])
        linear.flags.writeable = False
        set_fields(system, linear=linear)
    return system
