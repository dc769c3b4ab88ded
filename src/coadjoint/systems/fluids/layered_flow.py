"""Quasi-geostrophic flow in layers, on the sphere and the torus."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.fluids.quasi_geostrophic import QuasiGeostrophic, SphereQG, sphere_qg, torus_qg
from coadjoint.systems.fluids.sphere_euler import MAX_ROTATION, sphere_euler
from coadjoint.systems.fluids.torus_euler import torus_euler
from coadjoint.systems.forces.mode_force import MAX_LAYERS
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices import sphere_states
from coadjoint.systems.matrices.fluid_system import FluidSystem
from coadjoint.systems.matrices.labelled_fields import POTENTIAL_VORTICITY, RELATIVE_VORTICITY, STREAM_FUNCTION
from coadjoint.systems.matrices.matrix_invariants import traces_of, values_of
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.spherical_modes import generators
from coadjoint.systems.matrices.stacked_system import StackedSystem
from coadjoint.systems.matrices.streams import LayeredStream
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_choice, read_finite, read_integer, read_number, set_fields

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

ROUNDING = 1e-9
"""Relative to the largest number of a coupling: asymmetries and negative eigenvalues below it are rounding."""


class LayeredQG(StackedSystem):
    """Layers of quasi-geostrophic flow, with conversions between states, vorticities and stream functions.

    A state is an array (layers, N, N), ``[0]`` the uppermost layer: the **potential vorticity** of each, without its
    mean. `relative` returns the relative vorticities, and `stream_of` the stream functions; `absolute` and
    `from_stream` are the inverses. Matrices of one field are made and shown by `fluid`, an ideal fluid of this N.

    Attributes
    ----------
    gamma, lamb : (layers, layers) arrays
        The coupling, constant and times the squared sine of the latitude.
    thicknesses : (layers,) array
        Thickness of each layer.
    rotation : float
        Angular velocity of the frame.
    planetary : (layers, N, N) array
        The state at rest.
    """

    stream: LayeredStream
    planetary: Matrix
    layer_names = "the potential vorticity of each layer"
    independent_layers = True

    def __init__(self, N: int, gamma: Floats, thicknesses: Floats, lamb: Floats, rotation: float, surface: str) -> None:
        self.gamma, self.thicknesses, self.lamb, self.rotation = gamma, thicknesses, lamb, rotation
        layers, root = len(thicknesses), np.sqrt(thicknesses / thicknesses.sum())
        constant, of_latitude, vectors = vertical_modes(gamma, lamb, thicknesses)
        flows: list[Any] = [
            sphere_qg(N, s, 0.0, None, g) if surface == "sphere" else torus_qg(N, g)
            for g, s in zip(constant.tolist(), of_latitude.tolist(), strict=True)
        ]
        self._flows: list[QuasiGeostrophic] = flows
        self._fluid: FluidSystem = sphere_euler(N) if surface == "sphere" else torus_euler(N)
        self.energy_unit = self._fluid.energy_unit
        super().__init__(
            self._fluid.algebra,
            flows[0].stream,
            energy_sign=-1,
            name="layered_qg",
            parameters={
                "N": N,
                "gamma": as_tuples(gamma),
                "thicknesses": as_tuples(thicknesses),
                "lamb": as_tuples(lamb),
                "rotation": rotation,
                "surface": surface,
            },
        )
        self._stack(self.algebra, layers)
        of_modes = tuple(flow.stream for flow in flows)
        stream = LayeredStream(of_modes, vectors.T * root, vectors / root[:, None], thicknesses)
        planetary, linear = np.zeros(self.shape, dtype=np.complex128), None
        if rotation:
            planetary[:] = -2.0 * rotation * generators(N)[2]
            linear = -stream(planetary)
            linear.flags.writeable = False
        planetary.flags.writeable = False
        names = ("rotation",) if surface == "sphere" else ()
        set_fields(self, stream=stream, planetary=planetary, linear=linear, energy_parameters=names)

    @property
    def fluid(self) -> FluidSystem:
        return self._fluid

    @property
    def surface(self) -> str:
        """The surface, sphere or torus."""
        return self._fluid.surface

    @property
    def modes(self) -> tuple[Floats, Floats, Floats]:
        """The vertical modes, the stiffest one last: couplings, (layers,) each, and shapes, (layers, layers).

        The couplings are the constant one and that times the squared sine of the latitude; a shape is the stream
        function as a column, whose largest number is 1.
        """
        constant, of_latitude, _ = vertical_modes(self.gamma, self.lamb, self.thicknesses)
        shapes = self.stream.to_layers
        largest = shapes[np.abs(shapes).argmax(axis=0), np.arange(len(shapes))]
        return constant, of_latitude, shapes / largest

    def relative(self, x: Any) -> Matrix:
        """Return the relative vorticities of states.

        Parameters
        ----------
        x : (..., layers, N, N) array
            States.

        Returns
        -------
        (..., layers, N, N) array
            Matrices of the Laplacian of each stream function, for conversions of `fluid`.
        """
        V = self.matrices(x) - self.planetary
        return self.stream.by_modes([flow._vorticity for flow in self._flows], V)

    def absolute(self, W: Any) -> Matrix:
        """Return the states of relative vorticities; inverse of `relative`.

        Parameters
        ----------
        W : (..., layers, N, N) array or sequence of (N, N) arrays
            Such as ``[fluid.random(seed=1), fluid.zonal_jet()]`` of `fluid`.

        Returns
        -------
        (..., layers, N, N) array
        """
        steps = [lambda V, flow=flow: flow._anomaly(flow._stream_of_vorticity(V)) for flow in self._flows]
        return np.asarray(self.planetary + self.stream.by_modes(steps, self.matrices(W)))

    def from_stream(self, P: Any) -> Matrix:
        """Return the states of stream functions without their means; inverse of `stream_of`.

        Parameters
        ----------
        P : (..., layers, N, N) array or sequence of (N, N) arrays

        Returns
        -------
        (..., layers, N, N) array
        """
        return np.asarray(
            self.planetary + self.stream.by_modes([flow._anomaly for flow in self._flows], self.matrices(P))
        )

    @property
    def shown_fields(self) -> dict[str, tuple[str, Any, float]]:
        """Long name, function of states and mean of each field in datasets."""
        return {
            "vorticity": (RELATIVE_VORTICITY, self.relative, 0.0),
            "potential_vorticity": (POTENTIAL_VORTICITY, self.matrices, 0.0),
            "stream_function": (STREAM_FUNCTION, self.stream_of, 0.0),
        }

    def rossby_wave(
        self, degree: int = 5, order: int = 4, mode: int = 0, *, wave: float = 1.0, longitude: float = 0.0
    ) -> Matrix:
        """Return the state of a Rossby wave of one vertical mode on the sphere, an exact solution for every N.

        Parameters
        ----------
        degree, order : int
            As for `SphereQG.rossby_wave`.
        mode : int
            Vertical mode, from 0, the softest one: barotropic if the coupling moves no layer against the others.
        wave : float
            Root mean square of the relative vorticity in the layer where it is largest.
        longitude : float
            Longitude of a maximum of the vorticity in the northern hemisphere of that layer, in radians.

        Returns
        -------
        (layers, N, N) array
        """
        flow, k = self._flow_of_mode(mode)
        W = flow.rossby_wave(degree, order, wave=wave, longitude=longitude)
        return np.asarray(self.planetary + self.modes[2][:, k, None, None] * W)

    def rossby_speed(self, degree: int, order: int, mode: int = 0) -> float:
        """Return the angular velocity in the frame (rad/time, eastward) of the wave of `rossby_wave`.

        Parameters
        ----------
        degree, order, mode : int
            As for `rossby_wave`.

        Returns
        -------
        float

        Examples
        --------
        >>> s = layered_qg(N=16, gamma=[[2.0, -2.0], [-2.0, 2.0]], rotation=3.0)
        >>> [round(s.rossby_speed(2, 1, mode) * (6.0 + gamma), 12) for mode, gamma in ((0, 0.0), (1, 4.0))]
        [-6.0, -6.0]
        """
        flow, _ = self._flow_of_mode(mode)
        n, m = flow._read_wave(degree, order)
        return float(-2.0 * self.rotation / flow.stream.eigenmodes(m)[0][n - m])

    def _flow_of_mode(self, mode: Any) -> tuple[SphereQG, int]:
        k = read_integer(mode, "mode", 0, len(self._flows) - 1)
        if self.surface != "sphere":
            raise ValueError("the torus does not rotate, and has no Rossby waves; take surface='sphere'")
        return cast(SphereQG, self._flows[k]), k

    @cached_property
    def casimirs(self) -> dict[str, Any]:
        """Name to function of states (..., layers, N, N): the traces of powers of each layer, from 1."""
        found: dict[str, Any] = {}
        for k in range(len(self.thicknesses)):
            one = traces_of(self.algebra, self.powers, partial(self._layer, k), partial(self._of_layer, k))
            found |= {f"{name} [{k + 1}]": trace for name, trace in one.items()}
        return found

    def _layer(self, k: int, x: Any) -> Matrix:
        """Return a layer of states."""
        return self.matrices(x)[..., k, :, :]

    def _of_layer(self, k: int, W: Matrix) -> Floats:
        """Return the vectors of states of one layer, zero in the others."""
        X = np.zeros((*W.shape[:-2], *self.matrix_shape), dtype=np.complex128)
        X[..., k, :, :] = W
        return self.to_vector(X)

    @property
    def quadratic_casimirs(self) -> tuple[str, ...]:
        return tuple(f"tr W^2 [{k + 1}]" for k in range(len(self.thicknesses)) if self.powers)

    def casimirs_at(self, x: Any) -> dict[str, Any]:
        X = self.matrices(x)
        found: dict[str, Any] = {}
        traces = traces_of(self.algebra, self.powers, self.matrices, self.to_vector)
        for k in range(len(self.thicknesses)):
            found |= {f"{name} [{k + 1}]": value for name, value in values_of(traces, X[..., k, :, :]).items()}
        return found

    @property
    def integrals(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Name to function of states: on the sphere the angular momentum along the axis of rotation."""
        return {"angular momentum z": self._momentum} if self.surface == "sphere" else {}

    def _momentum(self, x: Any) -> Any:
        """Return the integral of mu times the potential vorticity, summed over layers with their thicknesses."""
        return sphere_states.angular_momentum(self.matrices(x))[..., 2] @ self.thicknesses

    def slope_transposed(self, Y: Matrix, t: float = 0.0) -> Matrix:
        weights = self.thicknesses[:, None, None]
        return np.asarray(weights * self.slope_of(Y / weights, t))

    def dual(self, Y: Matrix) -> Matrix:
        """Return the gradient of the pairing with an element, by the thicknesses."""
        return np.asarray(self.thicknesses[:, None, None] * Y)

    def _of_gradient(self, u: Floats) -> Matrix:
        return np.asarray(self.algebra.projected(self.from_vector(u)) / self.thicknesses[:, None, None])

    def pairing(self, Y: Matrix, X: Matrix) -> Any:
        return np.sum(np.conj(self.dual(Y)) * X, axis=(-3, -2, -1)).real

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return the energy of the motion relative to the frame, of all layers by their thicknesses."""
        V = self.matrices(x) - self.planetary
        value = 0.5 * self.energy_factor * self.pairing(self.slope_of(V), V)
        return float(value) if np.ndim(value) == 0 else value

    def spectrum(self, x: Any) -> Floats:
        """Return the eigenvalues of -i W of each layer, real and ascending, (..., layers, N)."""
        return MatrixSystem.spectrum(self, x)

    def generic_rank(self) -> int:
        """Return the rank of J at a generic state: that of all layers."""
        return len(self.thicknesses) * self.algebra.generic_rank()


def vertical_modes(gamma: Floats, lamb: Floats, thicknesses: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the eigenvalues of both couplings and common orthonormal vectors, as columns, in symmetric form."""
    root = np.sqrt(thicknesses)
    both = [coupling * root[:, None] / root for coupling in (gamma, lamb)]
    sizes = [np.abs(coupling).max() or 1.0 for coupling in both]
    # A generic sum has the vectors that both share if they commute.
    mixed = both[0] / sizes[0] + 0.6180339887 * both[1] / sizes[1]
    _, vectors = np.linalg.eigh((mixed + mixed.T) / 2)
    values = []
    for name, coupling, size in zip(("gamma", "lamb"), both, sizes, strict=True):
        diagonal = vectors.T @ coupling @ vectors
        found = np.diagonal(diagonal).copy()
        if np.abs(diagonal - np.diag(found)).max() > ROUNDING * size:
            raise ValueError("gamma and lamb do not commute; give couplings with the same vertical modes")
        if found.min() < -ROUNDING * size:
            raise ValueError(
                f"{name} has the negative eigenvalue {found.min():.6g}; the energy would not be positive: give minus "
                "the coupling to other layers beside the diagonal"
            )
        values.append(np.where(np.abs(found) <= ROUNDING * size, 0.0, found))
    return values[0], values[1], vectors


def _read_coupling(given: Any, name: str, layers: int | None) -> Floats:
    coupling = read_finite(given, name)
    if coupling.ndim != 2 or coupling.shape[0] != coupling.shape[1] or not 2 <= len(coupling) <= MAX_LAYERS:
        raise ValueError(f"{name} has the shape {coupling.shape}; give (layers, layers), from 2 to {MAX_LAYERS} layers")
    if layers is not None and len(coupling) != layers:
        raise ValueError(f"{name} has {len(coupling)} layers, and gamma {layers}; give the same number")
    return coupling


def _check_symmetric(coupling: Floats, name: str, thicknesses: Floats) -> None:
    weighted = thicknesses[:, None] * coupling
    asymmetry = np.abs(weighted - weighted.T)
    if asymmetry.max() > ROUNDING * np.abs(weighted).max():
        i, j = np.unravel_index(asymmetry.argmax(), asymmetry.shape)
        raise ValueError(
            f"thickness times {name} is {weighted[i, j]:.6g} at [{i}, {j}] and {weighted[j, i]:.6g} at [{j}, {i}]; it "
            "must be symmetric: give thicknesses in the inverse ratio of these couplings"
        )


GALLERY_GAMMA = ((8.0, -8.0), (-8.0, 8.0))


def _sheared_jet() -> Matrix:
    """Return a jet in the upper layer alone."""
    system = layered_qg(48, GALLERY_GAMMA)
    jet = sphere_euler(48).zonal_jet(band=(0.2, 1.2), perturbation=0.05)
    return system.absolute([jet, np.zeros_like(jet)])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_sheared_jet,
        t_span=(0.0, 10.0),
        step=0.0125,
        caption="A jet in the upper of two layers becomes unstable, and its waves carry momentum to the lower layer. "
        "Above, the relative vorticity of the upper layer at the start and at the end; below, that of the lower layer "
        "at the end.",
        pictures=(
            Picture("vorticity", at=0.0),
            Picture("vorticity", at=1.0),
            Picture("vorticity", at=1.0, layer=1),
            Picture("eigenvalues"),
        ),
        components=Picture("energy by scale"),
        parameters={"N": 48, "gamma": GALLERY_GAMMA},
        save_every=20,
        quantity="vorticity",
    )
)
def layered_qg(
    N: int = 32,
    gamma: npt.ArrayLike = ((1.0, -1.0), (-1.0, 1.0)),
    thicknesses: npt.ArrayLike | None = None,
    lamb: npt.ArrayLike | None = None,
    rotation: float = 0.0,
    surface: str = "sphere",
) -> LayeredQG:
    """Return quasi-geostrophic flow in two or more layers, coupled by a matrix: ``q_k' + {psi_k, q_k} = 0``.

    ``q_k = Laplacian psi_k - sum over j of (gamma_kj + lamb_kj mu^2) psi_j + 2 rotation mu``, mu = sin(latitude).
    Choose it for baroclinic flow: waves and instabilities of a current that differs from layer to layer. The state is
    q of every layer, whose traces of powers are all preserved, layer by layer. For one layer take `sphere_qg`.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_qg` and `torus_qg`.
    gamma : (layers, layers)
        The coupling, squared inverses of deformation radii (1/length^2), uppermost layer first: for two layers with a
        rigid lid ``((F1, -F1), (-F2, F2))``, ``F_k = f^2/(g' H_k)``. Each row adds up to zero, or with a free surface
        or another layer at rest to more. Times the thickness of its row it is symmetric, and has no negative
        eigenvalue.
    thicknesses : (layers,), optional
        Thickness H of each layer, positive: in any unit, that of the energy per density and area. By default 1.
    lamb : (layers, layers), optional
        A coupling times the squared sine of the latitude, on the sphere, ``4 Omega^2 a^2/(g' H_k)`` in place of
        ``F_k``. It has the vertical modes of `gamma`: give zeros for either.
    rotation : float
        Angular velocity of the frame, on the sphere, as for `sphere_qg`.
    surface : {"sphere", "torus"}
        Surface of the fluid.

    Returns
    -------
    LayeredQG
        States (layers, N, N). `fluid` makes and shows fields of one layer, ``absolute([W0, W1])`` the state of relative
        vorticities. The energy is the integral of ``sum of H_k (|u_k|^2 + psi_k (coupling psi)_k)/2``. Casimirs
        ``"tr W^2 [1]"``, ... of each layer. Integral: on the sphere the angular momentum along the axis.

    Raises
    ------
    TypeError, ValueError
        A coupling of another shape, that is not symmetric with the thicknesses, or has a negative eigenvalue; `gamma`
        and `lamb` without common vertical modes; a rotation or `lamb` on the torus.

    Warns
    -----
    UserWarning
        N is too small for the smallest deformation radius, as for `sphere_qg`.

    Notes
    -----
    The coupling is diagonalized once. Each step maps q to vertical modes, solves each for its stream function as
    `sphere_qg` does, and maps these back. Steps move each layer by its own stream function; they cost about twice
    those of as many single layers. Conversions from ``psi`` ignore its mean.

    A. Franken, E. Luesink, S. Ephrati, B. Geurts, arXiv:2409.05410; N. A. Phillips, Tellus 6 (1954) 273.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = layered_qg(N=16, gamma=[[3.0, -3.0], [-1.0, 1.0]], thicknesses=[1.0, 3.0], rotation=2.0)
    >>> x0 = s.absolute([s.fluid.random(seed=1), 0.1 * s.fluid.random(seed=2)])
    >>> sol = co.integrate(s, x0, (0, 1), 0.02, co.IsospectralGauss())
    >>> bool(sol.drift()["tr W^3 [2]"] < 1e-13), bool(sol.drift()["energy"] < 1e-4)
    (True, True)
    """
    coupling = _read_coupling(gamma, "gamma", None)
    layers = len(coupling)
    of_latitude = np.zeros_like(coupling) if lamb is None else _read_coupling(lamb, "lamb", layers)
    H = np.ones(layers) if thicknesses is None else read_finite(thicknesses, "thicknesses")
    if H.shape != (layers,) or not (H > 0.0).all():
        raise ValueError(f"thicknesses is {short(H.tolist())}; give a positive number for each of {layers} layers")
    rate, place = read_number(rotation, "rotation"), read_choice(surface, "surface", ("sphere", "torus"))
    if abs(rate) > MAX_ROTATION:
        raise ValueError(f"rotation is {rate:g}; give at most {MAX_ROTATION:g} in magnitude")
    if place == "torus" and (rate or of_latitude.any()):
        raise ValueError("rotation and lamb are given for the torus, which has no latitude; omit them")
    for name, one in (("gamma", coupling), ("lamb", of_latitude)):
        _check_symmetric(one, name, H)
    return LayeredQG(read_integer(N, "N", 3), coupling, H, of_latitude, rate, place)
