"""Two rigid molecules of water, TIP3P."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import rotations_of, stacked
from coadjoint.checkcases.cases.two_asteroids import (
    POSITION,
    VELOCITY,
    pair_kinetic,
    pair_momentum,
    quantities_of_body,
    relative_columns,
)
from coadjoint.checkcases.check_case import CheckCase, Columns, DerivedQuantity
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.bodies.rigid_molecules import rigid_molecules

Floats = npt.NDArray[np.float64]

NM, PS, DALTON = 1e-9, 1e-12, 1.66053906660e-27
ENERGY = DALTON * (NM / PS) ** 2  # 1 kJ/mol of the source, J
SITES = np.array([[0.0, 0.0, 0.0], [0.075695, 0.0, 0.0585882], [-0.075695, 0.0, 0.0585882]])  # nm
CHARGES = np.array([-0.834, 0.417, 0.417])
SITE_MASSES = np.array([15.9994, 1.008, 1.008])
EPSILON, SIGMA, COULOMB = 0.636386, 0.315061, 138.935458  # kJ/mol, nm, kJ nm/mol
SEPARATION = np.array([0.29, 0.03, -0.02])  # nm
ATTITUDES = np.array([[0.3, 0.2, -0.1], [1.2, -0.4, 0.9]])  # rotation vectors, rad
RATES_AT_START = np.array([[3.0, -5.0, 8.0], [-6.0, 2.0, 4.0]])  # rad/ps
METHODS = (Splitting(order=8, parts="free_body"), Splitting(order=6, parts="free_body"))
STEP, END = 0.00025, 0.5  # ps


@checkcase
def water_dimer() -> CheckCase:
    """Return two rigid molecules of water that attract each other, TIP3P, in free space."""
    system = rigid_molecules(SITES, CHARGES, ((EPSILON, SIGMA), (0.0, 0.0), (0.0, 0.0)), SITE_MASSES, coulomb=COULOMB)
    mass = float(SITE_MASSES.sum())
    places = SITES - SITE_MASSES @ SITES / mass
    moments = np.array([np.sum(SITE_MASSES * (np.sum(places**2, axis=1) - places[:, k] ** 2)) for k in range(3)])
    half = SEPARATION / 2.0
    x0 = system.state([-half, half], attitudes=Rotation.from_rotvec(ATTITUDES), angular_velocities=RATES_AT_START)

    def columns(x: Floats, t: Floats) -> Columns:
        found = relative_columns(system, x)
        found |= {name: NM * found[name] for name in POSITION.columns}
        found |= {name: NM / PS * found[name] for name in VELOCITY.columns}
        rates = [name for k in (1, 2) for name in quantities_of_body(k)[0].columns]
        return found | {name: found[name] / PS for name in rates}

    motion = IntegratedMotion(system, x0, STEP, METHODS, columns, time_unit=PS)
    both = tuple(quantity for k in (1, 2) for quantity in quantities_of_body(k))
    names = tuple(quantity.name for quantity in (POSITION, VELOCITY, *both))
    masses, tensors = DALTON * np.array([mass, mass]), DALTON * NM**2 * np.array([moments, moments])

    def energy(table: Mapping[str, Floats]) -> Floats:
        first, second = (rotations_of(table, quantities_of_body(k)[1].columns).as_matrix() @ places.T for k in (1, 2))
        r = stacked(table, POSITION.columns) / NM
        s = np.linalg.norm(r[:, :, None, None] + second[:, :, None, :] - first[:, :, :, None], axis=1)
        potential = COULOMB * np.einsum("i,j,kij->k", CHARGES, CHARGES, 1.0 / s)
        six = (SIGMA / s[:, 0, 0]) ** 6
        return pair_kinetic(table, masses, tensors) + ENERGY * (potential + 4.0 * EPSILON * (six**2 - six))

    times = PS * np.linspace(0.0, END, 251)
    return CheckCase(
        name="water_dimer",
        title="two rigid molecules of water, TIP3P, in free space",
        statement=(
            "Two rigid molecules with three sites each (O, H, H), whose positions in the frame of the molecule are "
            "given before the origin is moved to the centre of mass. V = sum over sites i of one and j of the "
            "other of coulomb q_i q_j/s_ij, and 4 epsilon ((sigma/s)^12 - (sigma/s)^6) between the oxygens. At t = "
            "0 the centres of mass are at rest, that of the second is at the separation from that of the first, "
            "and each molecule is turned from space by its rotation vector and rotates at its rates. Quaternions "
            "are from the molecule to space, and rates in its frame. Parameters are in the units of the source, "
            "nm, ps, dalton and elementary charge; columns are in SI units, with 1 dalton = 1.66053906660e-27 kg."
        ),
        parameters={
            "sites": (SITES, "nm"),
            "charges": (CHARGES, "e"),
            "site_masses": (SITE_MASSES, "dalton"),
            "epsilon": (EPSILON, "dalton nm^2/ps^2"),
            "sigma": (SIGMA, "nm"),
            "coulomb": (COULOMB, "dalton nm^3/(ps^2 e^2)"),
            "separation": (SEPARATION, "nm"),
            "attitudes": (ATTITUDES, "rad"),
            "rates": (RATES_AT_START, "rad/ps"),
            "end": (END * PS, "s"),
        },
        quantities=(POSITION, VELOCITY, *both),
        motion=motion,
        times=times,
        accuracy=1e-9,
        basis="this library, splittings of orders 8 and 6 with exact free bodies, and DOP853 agree",
        source=(
            "W. L. Jorgensen et al., Comparison of simple potential functions for simulating liquid water, J. "
            "Chem. Phys. 79, 926 (1983)"
        ),
        invariants=(
            DerivedQuantity("energy", "J", energy, names),
            DerivedQuantity("momentum", "kg m^2/s", lambda table: pair_momentum(table, masses, tensors), names),
        ),
    )
