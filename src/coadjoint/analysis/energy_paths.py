"""Paths of minimum energy between two states of spins: barriers, saddles and attempt frequencies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.equilibrium import equilibrium
from coadjoint.analysis.spin_descent import SpinSurface, angles, descend, normalized, tangential, tilted
from coadjoint.analysis.thermal_states import are_spins
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.systems.forces.base import read_seed
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_finite, read_integer

Floats = npt.NDArray[np.float64]

LARGEST_TURN = 0.1  # radians of a spin in one step
FRICTION, FASTER, SLOWER, SETTLED = 0.1, 1.1, 0.5, 5  # of the relaxation engine, with its published values
CONVERGED = 1e-5  # largest force across the path, relative to the largest field
MAX_STEPS = 20_000
TILT = 1e-2  # radians by which the images of a straight path are turned, so that they leave symmetric ones
AWAY, NEAR = (
    1e-4,
    1e-6,
)  # radians by which both states are turned first; torques over fields, from which Newton converges
CLIMBING = 100  # steps after which the highest image climbs
ZERO = 1e-6  # frequencies below this, relative to the largest, are those of free rotations


@dataclass(frozen=True, eq=False, repr=False)
class EnergyPath:
    """A path of minimum energy between two states of spins; `co.spins.minimum_energy_path` computes it.

    Attributes
    ----------
    x : (images, n) ndarray
        The states along the path, from one minimum to the other.
    energy : (images,) ndarray
        Their energies.
    distance : (images,) ndarray
        Length of the path from the first state: root of the sum of squares of angles.
    saddle : (n,) ndarray
        The highest state of the path, an unstable equilibrium.
    barrier : float
        Its energy above the first state.
    attempt_frequency : float
        Rate of transitions from the first state over this saddle, without the factor exp(-barrier/kT), of transition
        state theory without damping. NaN if a free rotation makes one of the states degenerate, or the saddle has other
        than one unstable direction.
    """

    x: Floats
    energy: Floats
    distance: Floats
    saddle: Floats
    barrier: float
    attempt_frequency: float

    def __repr__(self) -> str:
        return f"<path of {len(self.x)} states of {self.x.shape[1] // 3} spins, barrier {self.barrier:.6g}>"


@suggest_keywords
@long_operation("minimum_energy_path")
def minimum_energy_path(
    system: Any, start: npt.ArrayLike, end: npt.ArrayLike, *, images: int = 15, seed: int = 0
) -> EnergyPath:
    """Return the path of minimum energy between two states of spins, by a geodesic nudged elastic band.

    Choose it for the barriers of skyrmions, domain walls and nanomagnets, and for the rates of their decay. Both states
    are relaxed to the equilibria below them first. The band has a climbing image, which Newton's method takes to the
    saddle.

    Parameters
    ----------
    system : SpinModel or LiePoissonSystem
        Copies of so(3) without forces, such as `co.systems.spins` and `spin_lattice`.
    start, end : (n,) array_like
        The states, with spins of the same lengths. An image of the band is also a valid start, as an initial path.
    images : int
        States of the path, from 5 to 1000, both ends included.
    seed : int
        Seed of the small tilts of the first path, from 0 to 2^62. Opposite spins turn over about a random axis. The
        path is the lowest near the first one: compare seeds and numbers of images.

    Returns
    -------
    EnergyPath

    Raises
    ------
    TypeError, ValueError
        Other systems, other lengths, or both states in one valley.
    RuntimeError
        The band did not converge in 20 000 steps, or the highest image is near no saddle.

    Notes
    -----
    The first path turns each spin along a great circle. Tangents are those of Henkelman and Jonsson, on the product of
    the spheres. The attempt frequency is ``prod(omega of the minimum) / (2 pi prod(real omega of the saddle))``, of all
    modes of both, in cycles per unit of time.

    References
    ----------
    P. F. Bessarab, V. M. Uzdin, H. Jonsson, Comput. Phys. Commun. 196, 335 (2015); G. Henkelman, H. Jonsson, J. Chem.
    Phys. 113, 9978 (2000); E. Bitzek et al., Phys. Rev. Lett. 97, 170201 (2006), the relaxation.

    Examples
    --------
    A spin with easy axis z and hard axis y turns over x, with the barrier K:

    >>> import coadjoint as co
    >>> spin = co.systems.spin_lattice([], 1, on_site=(0, -1.0, 0.6))        # energy y^2 - K z^2, K = 0.6
    >>> path = co.spins.minimum_energy_path(spin, (0, 0, 1), (0, 0, -1))
    >>> round(path.barrier, 9), abs(path.saddle.round(6)).tolist()
    (0.6, [1.0, 0.0, 0.0])
    """
    check_one_system(system)
    if system.forces:
        raise TypeError(f"{system.name} has forces; minimum_energy_path takes the Hamiltonian part, system.unforced")
    if not are_spins(system):
        raise TypeError(f"{system.name} is not made of spins; minimum_energy_path needs copies of so(3)")
    count, key = read_integer(images, "images", 5, 1000), read_seed(seed, "seed")
    ends = [read_finite(start, "start"), read_finite(end, "end")]
    for what, state in zip(("start", "end"), ends, strict=True):
        if state.shape != (system.dim,):
            raise ValueError(f"{what} has shape {state.shape}; {system.name} needs ({system.dim},)")
    surface = SpinSurface(system, ends[0])
    if not np.allclose(SpinSurface(system, ends[1]).lengths, surface.lengths, rtol=1e-9, atol=0.0):
        raise ValueError("start and end have spins of other lengths; give states of one orbit")
    valleys = [descend(surface, tilted(surface.directions(state), AWAY, key), NEAR) for state in ends]
    minima = [equilibrium(system, surface.state(s)) for s in valleys]
    first, last = (surface.directions(found.x) for found in minima)
    if angles(first, last).max() < 1e-3:
        raise ValueError("start and end relax to the same state; give states of two valleys")
    band = _first_path(first, last, count, key)
    energies = _relax(surface, band)
    top = int(energies[1:-1].argmax()) + 1
    if not energies[top] > max(energies[0], energies[-1]):
        raise RuntimeError("no image of the path is above both ends; give more images")
    saddle = equilibrium(system, surface.state(band[top]), relax="none")
    if angles(surface.directions(saddle.x), band[top]).max() > 0.3:
        raise RuntimeError("the highest image is near no saddle; give more images")
    band[top], energies[top] = surface.directions(saddle.x), saddle.energy
    energies[[0, -1]] = [found.energy for found in minima]
    steps = np.sqrt((angles(band[1:], band[:-1]) ** 2).sum(axis=1))
    return EnergyPath(
        np.array([surface.state(s) for s in band]),
        energies,
        np.concatenate([[0.0], np.cumsum(steps)]),
        saddle.x,
        saddle.energy - minima[0].energy,
        _attempt_frequency(minima[0], saddle),
    )


def _first_path(first: Floats, last: Floats, count: int, seed: int) -> Floats:
    """Return directions (images, sites, 3) along great circles; opposite spins turn about random axes."""
    generator = np.random.default_rng(seed)
    along = tangential(first, last)
    loose = np.linalg.norm(along, axis=1) < 1e-3
    along[loose] = tangential(first[loose], np.broadcast_to(generator.standard_normal(3), first[loose].shape))
    turn, across = angles(first, last)[:, None], normalized(along)
    path = [np.cos(p * turn) * first + np.sin(p * turn) * across for p in np.linspace(0.0, 1.0, count)]
    band = np.array([first, *(tilted(s, TILT, seed + k) for k, s in enumerate(path[1:-1], 1)), last])
    return band


def _relax(surface: SpinSurface, band: Floats) -> Floats:
    """Relax the inner images in place by the fast inertial relaxation engine; return the energies of all images."""
    velocity, step, settled, friction = np.zeros_like(band), 0.3, 0, FRICTION
    for count in range(MAX_STEPS):
        energies = np.array([surface.energy(s) for s in band])
        gradients = np.array([surface.gradient(s) for s in band])
        scale = float(np.abs(gradients).max())
        forces, across = _forces(band, energies, gradients, count > CLIMBING)
        if across <= CONVERGED * scale and count > CLIMBING:
            return energies
        if count % 500 == 499:
            note_progress(f"a path, now with forces of {across / scale:.1e} of the fields")
        forces = forces / scale
        power = float((forces * velocity).sum())
        if power > 0.0:
            settled += 1
            size = np.linalg.norm(velocity) / max(float(np.linalg.norm(forces)), 1e-300)
            velocity = (1.0 - friction) * velocity + friction * size * forces
            if settled > SETTLED:
                step, friction = min(FASTER * step, 1.0), 0.99 * friction
        else:
            velocity, settled, friction, step = 0.0 * velocity, 0, FRICTION, SLOWER * step
        velocity = velocity + step * forces
        moved = step * velocity
        largest = float(np.linalg.norm(moved, axis=-1).max())
        moved *= min(1.0, LARGEST_TURN / largest) if largest > 0.0 else 1.0
        band[1:-1] = normalized(band[1:-1] + moved[1:-1])
        velocity = tangential(band, velocity)
        step = max(step, 1e-3)
    raise RuntimeError(
        f"the path did not converge in {MAX_STEPS} steps: forces across it are {across / scale:.1e} of the fields; "
        "give more images, or states nearer to each other"
    )


def _forces(band: Floats, energies: Floats, gradients: Floats, climbing: bool) -> tuple[Floats, float]:
    """Return the forces on the images, and the largest one across the path, or at the climbing image."""
    forces, across = np.zeros_like(band), 0.0
    top = int(energies[1:-1].argmax()) + 1
    spring = float(np.abs(gradients).max())
    for k in range(1, len(band) - 1):
        s, ahead, behind = band[k], band[k + 1] - band[k], band[k] - band[k - 1]
        rise, fall = energies[k + 1] - energies[k], energies[k - 1] - energies[k]
        if rise > 0.0 > fall or fall > 0.0 > rise:
            tangent = ahead if rise > 0.0 else behind
        else:
            high, low = max(abs(rise), abs(fall)), min(abs(rise), abs(fall))
            tangent = high * ahead + low * behind if rise > fall else low * ahead + high * behind
        tangent = tangential(s, tangent)
        tangent = tangent / max(float(np.linalg.norm(tangent)), 1e-300)
        force = -tangential(s, gradients[k])
        along = float((force * tangent).sum())
        if climbing and k == top:
            forces[k] = force - 2.0 * along * tangent
            across = max(across, float(np.linalg.norm(forces[k], axis=-1).max()))
        else:
            stretch = np.linalg.norm(angles(band[k + 1], s)) - np.linalg.norm(angles(s, band[k - 1]))
            forces[k] = force + (spring * float(stretch) - along) * tangent
            across = max(across, float(np.linalg.norm(force - along * tangent, axis=-1).max()))
    return forces, across


def _attempt_frequency(minimum: Any, saddle: Any) -> float:
    """Return the rate of transition state theory before the Boltzmann factor; NaN if a mode is free."""
    below, above = minimum.frequencies, np.sort(saddle.frequencies)
    free = ZERO * max(below.max(), saddle.growth)
    if minimum.stability != "stable" or saddle.stability != "unstable" or (above[1:] <= free).any() or above[0] > free:
        return math.nan
    return float(np.exp(np.log(below).sum() - np.log(above[1:]).sum()) / (2.0 * np.pi))
