"""Drag and the pressure of sunlight on the plates of a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.systems.forces.body_torque import BodyTorque, body_products, prescribed, read_prescribed
from coadjoint.validation import read_finite, read_number

UNIT = 1e-6
"""Largest deviation of a unit vector from the length 1 that is taken for rounding, and removed."""


class _OnPlates(BodyTorque):
    """Base class of forces on flat plates, each of which has an area, an outward normal and a centre."""

    areas: Any
    normals: Any
    centres: Any

    selectors: ClassVar[tuple[str, ...]] = ("normals",)

    def _read_plates(self) -> None:
        areas, normals, centres = (
            read_finite(getattr(self, name), f"{name} of {self.label}") for name in ("areas", "normals", "centres")
        )
        if areas.ndim != 1 or not len(areas) or normals.shape != (len(areas), 3) or centres.shape != normals.shape:
            raise ValueError(
                f"areas, normals and centres of {self.label} have the shapes {areas.shape}, {normals.shape} and "
                f"{centres.shape}; give (p,), (p, 3) and (p, 3) for p plates"
            )
        lengths = np.sqrt((normals * normals).sum(axis=1))
        if (areas < 0.0).any() or (abs(lengths - 1.0) > UNIT).any():
            raise ValueError(f"areas of {self.label} must not be negative, and normals be unit vectors")
        object.__setattr__(self, "areas", tuple(areas.tolist()))
        object.__setattr__(self, "normals", tuple(map(tuple, (normals / lengths[:, None]).tolist())))
        object.__setattr__(self, "centres", tuple(map(tuple, centres.tolist())))

    def _share(self, name: str) -> Any:
        """Validate numbers from 0 to 1, one or one for each plate; a number stays one."""
        what = f"{name} of {self.label}"
        array = read_finite(getattr(self, name), what)
        if array.shape not in ((), (len(self.areas),)) or (array < 0.0).any() or (array > 1.0).any():
            raise ValueError(f"{what} must be a number from 0 to 1, or one for each of {len(self.areas)} plates")
        plain = array.tolist()
        return tuple(plain) if isinstance(plain, list) else plain


@dataclass(frozen=True)
class SolarPressure(_OnPlates):
    """The torque of sunlight on flat plates, which absorb it, reflect it, and scatter it.

    A plate of area a and normal n at c that is lit, ``s . n > 0`` with the unit vector s toward the sun, has at c the
    force ``-pressure a (s . n) ((1 - specular) s + 2 (specular s . n + diffuse / 3) n)``. Plates do not shade each
    other; a panel that is lit on both sides is two plates.

    Parameters
    ----------
    pressure : float
        Of sunlight that is absorbed: 4.56e-6 N/m^2 at the Earth.
    sun : (3,) or callable
        Unit vector toward the sun, in space: constant, or a function of the time t, compiled by Numba. A shorter vector
        is a weaker light, zero in a shadow.
    areas : (p,)
        Areas of the plates.
    normals : (p, 3)
        Outward unit normals, in the body frame.
    centres : (p, 3)
        Centres from the centre of mass, in the body frame.
    specular, diffuse : float or (p,)
        Shares of the light that are reflected as by a mirror, and scattered; the rest is absorbed.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, shares that exceed 1, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> light = co.forces.SolarPressure(4.56e-6, (1, 0, 0), [2.0], [(1, 0, 0)], [(0, 0, 0.5)], specular=1.0)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(light)
    >>> sat.vector_field(sat.state())[:3]
    array([ 0.00e+00, -9.12e-06,  0.00e+00])
    """

    pressure: float
    sun: Any
    areas: Any
    normals: Any
    centres: Any
    specular: Any = 0.0
    diffuse: Any = 0.0

    def __post_init__(self) -> None:
        self._read_plates()
        object.__setattr__(self, "pressure", read_number(self.pressure, "pressure of SolarPressure"))
        object.__setattr__(self, "sun", read_prescribed(self.sun, "sun of SolarPressure"))
        for name in ("specular", "diffuse"):
            object.__setattr__(self, name, self._share(name))
        if (np.add(self.specular, self.diffuse) > 1.0).any():
            raise ValueError("specular and diffuse of SolarPressure exceed 1 together; they are shares of the light")

    def torque_on(self, system: Any) -> Callable[..., Any]:
        in_body, crossed = body_products()
        pressure, sun, count = self.pressure, prescribed(self.sun), len(self.areas)
        a, n, c = np.array(self.areas), np.array(self.normals), np.array(self.centres)
        mirror, matt = (np.array(np.broadcast_to(share, count)) for share in (self.specular, self.diffuse))

        def torque(x: Any, A: Any, t: Any) -> Any:
            s, result = in_body(A, sun(t)), 0.0 * x[:3]
            for k in range(count):
                along = s[0] * n[k, 0] + s[1] * n[k, 1] + s[2] * n[k, 2]
                turned = (1.0 - mirror[k]) * s + 2.0 * (mirror[k] * along + matt[k] / 3.0) * n[k]
                result = result - pressure * a[k] * (along * (along > 0.0)) * crossed(c[k], turned)
            return result

        return torque


@dataclass(frozen=True)
class Drag(_OnPlates):
    """The torque of thin air on flat plates, with the force ``-density coefficient/2 a (v . n) v`` where v . n > 0.

    Parameters
    ----------
    density : float
        Of the air (mass over length cubed).
    velocity : (3,) or callable
        v, of the body relative to the air, in space: constant, or a function of the time t, compiled by Numba. That of
        the plates relative to the centre of mass is neglected.
    areas : (p,)
        Areas of the plates.
    normals : (p, 3)
        Outward unit normals, in the body frame.
    centres : (p, 3)
        Centres from the centre of mass, in the body frame.
    coefficient : float
        Drag coefficient, 2 to 2.5 in free molecular flow.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> air = co.forces.Drag(1e-12, (7500.0, 0, 0), [2.0], [(1, 0, 0)], [(0, 0, 0.5)], coefficient=2.0)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(air)
    >>> sat.vector_field(sat.state())[:3].round(10)
    array([ 0.000e+00, -5.625e-05,  0.000e+00])
    """

    density: float
    velocity: Any
    areas: Any
    normals: Any
    centres: Any
    coefficient: float = 2.2

    def __post_init__(self) -> None:
        self._read_plates()
        for name in ("density", "coefficient"):
            object.__setattr__(self, name, read_number(getattr(self, name), f"{name} of Drag"))
        object.__setattr__(self, "velocity", read_prescribed(self.velocity, "velocity of Drag"))

    def torque_on(self, system: Any) -> Callable[..., Any]:
        in_body, crossed = body_products()
        factor, velocity, count = 0.5 * self.density * self.coefficient, prescribed(self.velocity), len(self.areas)
        a, n, c = np.array(self.areas), np.array(self.normals), np.array(self.centres)

        def torque(x: Any, A: Any, t: Any) -> Any:
            v, result = in_body(A, velocity(t)), 0.0 * x[:3]
            for k in range(count):
                along = v[0] * n[k, 0] + v[1] * n[k, 1] + v[2] * n[k, 2]
                result = result - factor * a[k] * (along * (along > 0.0)) * crossed(c[k], v)
            return result

        return torque
