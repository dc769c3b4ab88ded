# For type checkers and editors; docs/write_api.py writes it: a system is one file, and registers itself.

from typing import Any

from coadjoint.systems.clebsch_body import clebsch_body as clebsch_body
from coadjoint.systems.decorated_particles import decorated_particles as decorated_particles
from coadjoint.systems.double_spherical_pendulum import double_spherical_pendulum as double_spherical_pendulum
from coadjoint.systems.fluid_triad import fluid_triad as fluid_triad
from coadjoint.systems.goryachev_chaplygin_top import goryachev_chaplygin_top as goryachev_chaplygin_top
from coadjoint.systems.gyrostat import gyrostat as gyrostat
from coadjoint.systems.heavy_top import heavy_top as heavy_top
from coadjoint.systems.kirchhoff_body import kirchhoff_body as kirchhoff_body
from coadjoint.systems.kovalevskaya_top import kovalevskaya_top as kovalevskaya_top
from coadjoint.systems.lagrange_top import lagrange_top as lagrange_top
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.lorenz_1960 import lorenz_1960 as lorenz_1960
from coadjoint.systems.manakov_top import manakov_top as manakov_top
from coadjoint.systems.matrix_body import matrix_body as matrix_body
from coadjoint.systems.maxwell_bloch import maxwell_bloch as maxwell_bloch
from coadjoint.systems.paper_examples import paper_a37 as paper_a37
from coadjoint.systems.paper_examples import paper_rigid_body as paper_rigid_body
from coadjoint.systems.passive_scalar import passive_scalar as passive_scalar
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.reduced_mhd import reduced_mhd as reduced_mhd
from coadjoint.systems.riccati import riccati as riccati
from coadjoint.systems.rigid_body import rigid_body as rigid_body
from coadjoint.systems.satellite import satellite as satellite
from coadjoint.systems.separable_cosh import separable_cosh as separable_cosh
from coadjoint.systems.sklyanin import sklyanin as sklyanin
from coadjoint.systems.so_n_body import so_n_body as so_n_body
from coadjoint.systems.sphere_euler import sphere_euler as sphere_euler
from coadjoint.systems.spin_lattice import spin_lattice as spin_lattice
from coadjoint.systems.toda import toda as toda
from coadjoint.systems.toda import toda_ring as toda_ring
from coadjoint.systems.torus_euler import torus_euler as torus_euler
from coadjoint.systems.vlasov_moments import vlasov_moments as vlasov_moments

__all__ = [
    "clebsch_body",
    "decorated_particles",
    "double_spherical_pendulum",
    "fluid_triad",
    "get",
    "goryachev_chaplygin_top",
    "gyrostat",
    "heavy_top",
    "kirchhoff_body",
    "kovalevskaya_top",
    "lagrange_top",
    "lorenz_1960",
    "manakov_top",
    "matrix_body",
    "maxwell_bloch",
    "names",
    "paper_a37",
    "paper_rigid_body",
    "passive_scalar",
    "reduced_mhd",
    "riccati",
    "rigid_body",
    "satellite",
    "separable_cosh",
    "sklyanin",
    "so_n_body",
    "sphere_euler",
    "spin_lattice",
    "toda",
    "toda_ring",
    "torus_euler",
    "vlasov_moments",
]

def names() -> tuple[str, ...]: ...
def get(name: str, **parameters: Any) -> LiePoissonSystem | PoissonSystem: ...
