# For type checkers and editors; docs/write_api.py writes it: a system is one file, and registers itself.

from typing import Any

from coadjoint.systems.bodies.bodies import bodies as bodies
from coadjoint.systems.bodies.bodies_in_fluids import clebsch_body as clebsch_body
from coadjoint.systems.bodies.bodies_in_fluids import kirchhoff_body as kirchhoff_body
from coadjoint.systems.bodies.body import body as body
from coadjoint.systems.bodies.double_spherical_pendulum import double_spherical_pendulum as double_spherical_pendulum
from coadjoint.systems.bodies.gravitating_bodies import gravitating_bodies as gravitating_bodies
from coadjoint.systems.bodies.heavy_tops import goryachev_chaplygin_top as goryachev_chaplygin_top
from coadjoint.systems.bodies.heavy_tops import heavy_top as heavy_top
from coadjoint.systems.bodies.heavy_tops import kovalevskaya_top as kovalevskaya_top
from coadjoint.systems.bodies.heavy_tops import lagrange_top as lagrange_top
from coadjoint.systems.bodies.matrix_body import matrix_body as matrix_body
from coadjoint.systems.bodies.rigid_body import gyrostat as gyrostat
from coadjoint.systems.bodies.rigid_body import rigid_body as rigid_body
from coadjoint.systems.bodies.rigid_molecules import rigid_molecules as rigid_molecules
from coadjoint.systems.bodies.satellite import satellite as satellite
from coadjoint.systems.bodies.satellite_on_orbit import satellite_on_orbit as satellite_on_orbit
from coadjoint.systems.bodies.so_n_bodies import manakov_top as manakov_top
from coadjoint.systems.bodies.so_n_bodies import so_n_body as so_n_body
from coadjoint.systems.coordinates import canonical_state as canonical_state
from coadjoint.systems.examples.elliptic_motions import maxwell_bloch as maxwell_bloch
from coadjoint.systems.examples.elliptic_motions import sklyanin as sklyanin
from coadjoint.systems.examples.paper_examples import paper_a37 as paper_a37
from coadjoint.systems.examples.paper_examples import paper_rigid_body as paper_rigid_body
from coadjoint.systems.examples.paper_examples import riccati as riccati
from coadjoint.systems.examples.paper_examples import separable_cosh as separable_cosh
from coadjoint.systems.fluids.carried_fields import passive_scalar as passive_scalar
from coadjoint.systems.fluids.carried_fields import reduced_mhd as reduced_mhd
from coadjoint.systems.fluids.decorated_particles import decorated_particles as decorated_particles
from coadjoint.systems.fluids.layered_flow import layered_qg as layered_qg
from coadjoint.systems.fluids.point_vortices import point_vortices as point_vortices
from coadjoint.systems.fluids.quasi_geostrophic import sphere_qg as sphere_qg
from coadjoint.systems.fluids.quasi_geostrophic import surface_qg as surface_qg
from coadjoint.systems.fluids.quasi_geostrophic import torus_qg as torus_qg
from coadjoint.systems.fluids.sphere_euler import sphere_euler as sphere_euler
from coadjoint.systems.fluids.thermal_flow import thermal_qg as thermal_qg
from coadjoint.systems.fluids.torus_euler import torus_euler as torus_euler
from coadjoint.systems.fluids.truncations import fluid_triad as fluid_triad
from coadjoint.systems.fluids.truncations import lorenz_1960 as lorenz_1960
from coadjoint.systems.fluids.truncations import vlasov_moments as vlasov_moments
from coadjoint.systems.hamiltonians.terms import FunctionTerm as FunctionTerm
from coadjoint.systems.hamiltonians.terms import PolynomialTerm as PolynomialTerm
from coadjoint.systems.hamiltonians.terms import QuadraticTerm as QuadraticTerm
from coadjoint.systems.lattices.spin_lattice import spin_lattice as spin_lattice
from coadjoint.systems.lattices.spins_on_crystals import spins as spins
from coadjoint.systems.lattices.toda import toda as toda
from coadjoint.systems.lattices.toda import toda_ring as toda_ring
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.planet import RotatingPlanet as RotatingPlanet
from coadjoint.systems.matrices.streams import Circulants as Circulants
from coadjoint.systems.matrices.streams import DiagonalSolve as DiagonalSolve
from coadjoint.systems.matrices.streams import FunctionStream as FunctionStream
from coadjoint.systems.matrices.streams import Weights as Weights
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.registry import ready_made as ready_made

__all__ = [
    "Circulants",
    "DiagonalSolve",
    "FunctionStream",
    "FunctionTerm",
    "PolynomialTerm",
    "QuadraticTerm",
    "RotatingPlanet",
    "Weights",
    "bodies",
    "body",
    "canonical_state",
    "clebsch_body",
    "decorated_particles",
    "double_spherical_pendulum",
    "fluid_triad",
    "get",
    "goryachev_chaplygin_top",
    "gravitating_bodies",
    "gyrostat",
    "heavy_top",
    "kirchhoff_body",
    "kovalevskaya_top",
    "lagrange_top",
    "layered_qg",
    "lorenz_1960",
    "manakov_top",
    "matrix_body",
    "maxwell_bloch",
    "names",
    "paper_a37",
    "paper_rigid_body",
    "passive_scalar",
    "point_vortices",
    "ready_made",
    "reduced_mhd",
    "riccati",
    "rigid_body",
    "rigid_molecules",
    "satellite",
    "satellite_on_orbit",
    "separable_cosh",
    "sklyanin",
    "so_n_body",
    "sphere_euler",
    "sphere_qg",
    "spin_lattice",
    "spins",
    "surface_qg",
    "thermal_qg",
    "toda",
    "toda_ring",
    "torus_euler",
    "torus_qg",
    "vlasov_moments",
]

def names() -> tuple[str, ...]: ...
def get(name: str, **parameters: Any) -> LiePoissonSystem | PoissonSystem: ...
