"""Thermal quasi-geostrophic flow, with a buoyancy that it carries, on the sphere and the torus."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.fluids.carried_fields import TwoLayerSystem
from coadjoint.systems.fluids.quasi_geostrophic import QuasiGeostrophic, SphereQG, sphere_qg, torus_qg
from coadjoint.systems.fluids.sphere_euler import sphere_euler
from coadjoint.systems.fluids.torus_euler import torus_euler
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices import sphere_states
from coadjoint.systems.matrices.labelled_fields import BUOYANCY
from coadjoint.systems.matrices.spherical_modes import generators
from coadjoint.systems.matrices.streams import BuoyancyFactors
from coadjoint.systems.matrices.topography import modes_of_rows, plain_rows, topography_rows
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_choice, read_number, set_fields

Matrix = npt.NDArray[Any]


class ThermalQG(TwoLayerSystem):
    """A thermal quasi-geostrophic flow, with conversions between states, buoyancy, vorticities and stream function.

    A state is an array (2, N, N): ``[0]`` the **buoyancy** b, ``[1]`` the Lie-Poisson variable W = q + mu b, on the
    torus q + b, of the **potential vorticity** q. Both are without their means. `potential` returns b and q, and
    `relative` b and the relative vorticity; `from_potential` and `absolute` are the inverses. Matrices of one field are
    made and shown by `fluid`, the flow without buoyancy, whose state is q.

    Attributes
    ----------
    fluid : SphereQG or TorusQG
        The flow without buoyancy.
    bathymetry : (k, 4) array or None
        Modes of h as rows: two numbers of a mode, real and imaginary part.
    """

    layer_names = "the buoyancy and the potential vorticity with its part"
    carried_field = "buoyancy", BUOYANCY
    buoyancy: BuoyancyFactors

    def __init__(self, flow: QuasiGeostrophic, bathymetry: Any, parameters: Mapping[str, Any]) -> None:
        plain: Any = sphere_euler(flow.algebra.N) if flow.surface == "sphere" else torus_euler(flow.algebra.N)
        rows = None if bathymetry is None else topography_rows(bathymetry, plain, "stream function", "bathymetry")
        super().__init__(
            flow.algebra,
            flow.stream,
            energy_sign=-1,
            name="thermal_qg",
            parameters={**parameters, "bathymetry": plain_rows(rows)},
        )
        N = flow.algebra.N
        sine = 2.0 / np.sqrt(N * N - 1.0) * (1j * generators(N)[2]).diagonal().real
        factors = BuoyancyFactors((sine[:, None] + sine) / 2 if flow.surface == "sphere" else np.ones((N, N)))
        half = 0.5 * plain.from_modes({} if rows is None else modes_of_rows(rows))
        self._fluid, self._half, self.energy_unit = flow, half, flow.energy_unit
        linear = None
        if flow.linear is not None or half.any():
            P = np.zeros_like(half) if flow.linear is None else flow.linear
            linear = np.stack([P, factors.stream_of_buoyancy(P) + half])
            linear.flags.writeable = False
        set_fields(self, bathymetry=rows, buoyancy=factors, second_stream=factors, linear=linear, energy_parameters=())

    def potential(self, x: Any) -> Matrix:
        """Return the buoyancy and the potential vorticity of states.

        Parameters
        ----------
        x : (..., 2, N, N) array
            States.

        Returns
        -------
        (..., 2, N, N) array
            b and q, for conversions of `fluid` with ``absolute=True``.
        """
        return self.buoyancy.separated(self.matrices(x))

    def from_potential(self, X: Any) -> Matrix:
        """Return the states of a buoyancy and a potential vorticity; inverse of `potential`.

        Parameters
        ----------
        X : (..., 2, N, N) array or sequence of two (N, N) arrays
            b and q, such as ``[fluid.from_modes(b, absolute=True), fluid.random(seed=1)]`` of `fluid`.

        Returns
        -------
        (..., 2, N, N) array
        """
        return self.buoyancy.joined(self.matrices(X))

    def relative(self, x: Any) -> Matrix:
        """Return the buoyancy and the relative vorticity of states.

        Parameters
        ----------
        x : (..., 2, N, N) array
            States.

        Returns
        -------
        (..., 2, N, N) array
            b and the Laplacian of psi.
        """
        fields = self.potential(x)
        fields[..., 1, :, :] = self._fluid.relative(fields[..., 1, :, :])
        return fields

    def absolute(self, X: Any) -> Matrix:
        """Return the states of a buoyancy and a relative vorticity; inverse of `relative`.

        Parameters
        ----------
        X : (..., 2, N, N) array or sequence of two (N, N) arrays
            b and the Laplacian of psi, such as ``fluid.relative(fluid.random(seed=1))`` of `fluid`.

        Returns
        -------
        (..., 2, N, N) array

        Raises
        ------
        ValueError
            A state of `fluid` in place of the relative vorticity of a list.
        """
        self._check_relative(X)
        fields = np.array(self.matrices(X))
        fields[..., 1, :, :] = self._fluid.absolute(fields[..., 1, :, :])
        return self.buoyancy.joined(fields)

    def fluid_state(self, x: Any) -> Matrix:
        return self.potential(x)[..., 1, :, :]

    def slope_of(self, W: Matrix, t: float = 0.0) -> Matrix:
        """Return P and J of states (..., 2, N, N), in this order, without their constant terms."""
        P = self.stream(W[..., 1, :, :] - self.buoyancy(W[..., 0, :, :]))
        return np.stack([P, self.buoyancy.stream_of_buoyancy(P)], axis=-3)

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return the energy of the motion relative to the frame, less the integral of h b/2."""
        value = self._fluid.energy(self.fluid_state(x)) + self.energy_factor * self.algebra.pairing(
            self._half, self.matrices(x)[..., 0, :, :]
        )
        return float(value) if np.ndim(value) == 0 else value

    @property
    def integrals(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Name to function of states: on the sphere, with zonal topography and bathymetry, an angular momentum.

        It is the integral of mu W.
        """
        flow = self._fluid
        if not isinstance(flow, SphereQG) or "angular momentum z" not in flow.integrals:
            return {}
        is_zonal = not np.count_nonzero(self._half - np.diag(np.diagonal(self._half)))
        return {"angular momentum z": partial(_momentum, self)} if is_zonal else {}


def _momentum(system: ThermalQG, x: Any) -> Any:
    return sphere_states.momentum_along("z", system.matrices(x)[..., 1, :, :])


BOTTOM = ((4.0, 3.0, 0.6, 0.0), (2.0, 0.0, -0.5, 0.0))
"""Modes of the bathymetry of the example."""


def _warm_tropics() -> Matrix:
    """Return a flow at rest but for small eddies, warm at the equator."""
    system = thermal_qg(48, 40.0, 2.0, None, BOTTOM)
    fluid = system.fluid
    b = fluid.from_modes({(2, 0): -1.0, (1, 0): 0.3}, absolute=True)
    return system.absolute([b, 0.2 * fluid.relative(fluid.random(seed=2, degrees=(3, 8)))])


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_warm_tropics,
        t_span=(0.0, 8.0),
        step=0.01,
        caption="Water that is warm at the equator, over a bottom with ridges: the buoyancy drives eddies that fold it "
        "into fronts. Above, the relative vorticity, and below, the buoyancy, at the end. The spectrum of the buoyancy "
        "is constant.",
        pictures=(Picture("vorticity", at=1.0), Picture("vorticity", part="carried", at=1.0), Picture("eigenvalues")),
        components=Picture("energy by scale"),
        parameters={"N": 48, "gamma": 40.0, "rotation": 2.0, "bathymetry": BOTTOM},
        save_every=20,
        quantity="vorticity",
    )
)
def thermal_qg(
    N: int = 32,
    gamma: float = 0.0,
    rotation: float = 0.0,
    topography: Any = None,
    bathymetry: Any = None,
    lamb: float = 0.0,
    surface: str = "sphere",
) -> ThermalQG:
    """Return thermal quasi-geostrophic flow: a potential vorticity, and a buoyancy that it carries and that drives it.

    On the torus ``b_t + {psi, b} = 0`` and ``q_t + {psi, q - b} = -{h, b}/2`` with
    ``q = (Laplacian - gamma) psi + eta``. On the sphere, whose Coriolis parameter is 2 rotation mu, mu = sin(latitude),
    ``b_t + {psi, b} = 0`` and ``W_t + {psi, W} = {mu psi - h/2, b}`` with ``W = q + mu b`` and
    ``q = (Laplacian - gamma - lamb mu^2) psi + 2 rotation mu (1 + topography)``. Choose it for an upper ocean whose
    temperature varies along the surface: fronts, and instabilities at scales below the deformation radius. For a
    buoyancy that does not act on the flow take `passive_scalar`, for one at the surface of a deep fluid `surface_qg`.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_qg` and `torus_qg`.
    gamma : float
        Squared inverse of a constant deformation radius (1/length^2), not negative.
    rotation : float
        Angular velocity of the frame, on the sphere, as for `sphere_qg`.
    topography : optional
        The topography in the potential vorticity, as for `sphere_qg` and `torus_qg`, in all its forms.
    bathymetry : optional
        h, as modes, rows, a grid, an `xarray.DataArray` or a function, as `topography`, in the unit of psi
        (length^2/time). Of a bottom at the depth D below its mean it is ``2 g D/f``, with the Coriolis parameter f, on
        the sphere that of the pole, 2 rotation. Its mean has no effect.
    lamb : float
        Lamb's parameter, on the sphere, as for `sphere_qg`.
    surface : {"sphere", "torus"}
        Surface of the fluid.

    Returns
    -------
    ThermalQG
        States (2, N, N): b and W = q + mu b, on the torus q + b; ``absolute([b, omega])`` makes one of a relative
        vorticity, ``from_potential([b, q])`` of q. The unit of b is 1/time: where the gravity g of the layer is g + g',
        it is ``f g'/(2 g)``, with f as above. The energy is the integral of
        ``(|u|^2 + (gamma + lamb mu^2) psi^2 - h b)/2``. Casimirs ``tr Theta^k``, integrals of powers of b, and
        ``tr W Theta^k``, of W times these. Integral: on the sphere, if topography and bathymetry do not depend on the
        longitude, that of mu W.

    Raises
    ------
    TypeError, ValueError
        As for `sphere_qg` and `torus_qg`, for `bathymetry` as for `topography`; a rotation or `lamb` on the torus.

    Warns
    -----
    UserWarning
        N is too small for the deformation radius, as for `sphere_qg`; a mean of `topography` or `bathymetry` is
        dropped.

    Notes
    -----
    The equations are those of a semidirect product, ``b' = [P, b]``, ``W' = [P, W] + [J, b]`` with P of psi and J of
    ``h/2 - mu psi``, and their steps those of `reduced_mhd`. `Friction`, `Viscosity` and `BetaPlane` act on q at a
    given b, and with ``layer="carried"`` on b at a given q. The torus is an f-plane: mu is 1. On the sphere W is the
    potential vorticity of thermal shallow water at small Rossby numbers.

    D. D. Holm, E. Luesink, W. Pan, Phys. Fluids 33 (2021) 046603; F. J. Beron-Vera, Rev. Mex. Fis. 67 (2021) 351; for
    another treatment of the sphere see M. Roop, S. Ephrati, arXiv:2505.17044.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = thermal_qg(N=9, gamma=4.0, bathymetry={(1, 1): 0.2}, surface="torus")
    >>> b = s.fluid.from_modes({(0, 1): 0.5}, absolute=True)
    >>> x0 = s.from_potential([b, s.fluid.random(seed=1)])
    >>> sol = co.integrate(s, x0, (0, 1), 0.02, co.IsospectralGauss())
    >>> bool(sol.drift()["tr W Theta"] < 1e-13), bool(sol.drift()["energy"] < 1e-4)
    (True, True)
    """
    place = read_choice(surface, "surface", ("sphere", "torus"))
    rate, of_latitude = read_number(rotation, "rotation"), read_number(lamb, "lamb")
    if place == "torus" and (rate or of_latitude):
        raise ValueError("rotation and lamb are given for the torus, which has no latitude; omit them")
    flow: Any = (
        sphere_qg(N, of_latitude, rate, topography, gamma) if place == "sphere" else torus_qg(N, gamma, topography)
    )
    parameters = {
        "N": flow.algebra.N,
        "gamma": flow.gamma,
        "rotation": rate,
        "topography": plain_rows(flow.topography),
        "lamb": of_latitude,
        "surface": place,
    }
    return ThermalQG(flow, bathymetry, parameters)
