"""The scheme of runs for which none is given: one that serves the system, at every entry point."""

import numpy as np
import pytest

import coadjoint as co
from command import command

E3, SO4 = co.algebras.se(3), co.algebras.so(4)
RNG = np.random.default_rng(4)


def full(n):
    M = RNG.standard_normal((n, n))
    return co.Quadratic(M @ M.T)


SPLIT = {
    "full on so(4)": co.LiePoissonSystem(SO4, full(6)),
    "full on e(3)": co.LiePoissonSystem(E3, full(6), sign=-1),
    "solvable": co.LiePoissonSystem(co.algebras.get("A4,9", b=0.5), lambda x: np.cos(x[0]) + x[3] ** 2 - x[1]),
    "sum of functions": co.LiePoissonSystem(E3, "x1^2/2 + cos(x2) + x3^4/4 + sin(x4*x5)"),
    "forced": co.LiePoissonSystem(SO4, full(6)).with_forces(co.forces.LinearDamping(0.1)),
    "batch": co.batch([co.LiePoissonSystem(SO4, full(6)), co.LiePoissonSystem(SO4, "exp(x1) + x2^2")]),
}
COUPLED = "cos(x1*x2) + x4*x6"
NOT_SPLIT = {
    "coupled": co.LiePoissonSystem(E3, COUPLED),
    "monomial": co.LiePoissonSystem(SO4, "x1*x2*x3 + x4^2"),
    "not traceable": co.LiePoissonSystem(
        co.algebras.get("A4,9", b=0.5),
        co.Hamiltonian(lambda x: max(x[0], 0.0) ** 2 + x[1], lambda x: np.array([2 * max(x[0], 0.0), 1.0, 0.0, 0.0])),
    ),
    "nonlinear bracket": co.systems.sklyanin(),
    "forced": co.LiePoissonSystem(E3, COUPLED).with_forces(co.forces.LinearDamping(0.1)),
    "batch": co.batch([co.LiePoissonSystem(E3, full(6)), co.LiePoissonSystem(E3, COUPLED)]),
}


def state_of(system):
    return np.linspace(0.2, 0.5, system.dim)


@pytest.mark.parametrize(
    ("system", "scheme"),
    [(system, co.Splitting()) for system in SPLIT.values()]
    + [(system, co.GaussLegendre(3)) for system in NOT_SPLIT.values()],
    ids=[*SPLIT, *(f"{name}, not split" for name in NOT_SPLIT)],
)
def test_the_scheme_that_serves_is_taken_with_the_same_bits(system, scheme):
    run = co.integrate(system, state_of(system), (0, 0.5), 0.05)
    assert run.method == scheme
    np.testing.assert_array_equal(run.x, co.integrate(system, state_of(system), (0, 0.5), 0.05, scheme).x)


@pytest.mark.parametrize("systems", [SPLIT, NOT_SPLIT], ids=["split", "not split"])
def test_every_entry_point_has_the_same_default(systems, tmp_path):
    system = systems["full on e(3)" if systems is SPLIT else "coupled"]
    scheme = co.Splitting() if systems is SPLIT else co.GaussLegendre(3)
    x = state_of(system)
    assert co.prepare(system, step=0.05).method == scheme
    archived = co.integrate(system, x, (0, 0.5), 0.05, archive=tmp_path / "run.zarr")
    assert archived.method == scheme
    exponents = [co.lyapunov(system, x, (0, 0.5), 0.05, method=method).exponents for method in (None, scheme)]
    np.testing.assert_array_equal(*exponents)
    members = [x, 2 * x]
    assert co.integrate(system, members, (0, 0.5), 0.05).method == scheme
    event = co.Event(0)
    sections = [co.poincare_section(system, members, event, (0, 0.5), 0.05, method).x for method in (None, scheme)]
    np.testing.assert_array_equal(*sections)


@pytest.mark.parametrize(
    ("H", "scheme"), [("x1^2/2 + cos(x2)", co.Splitting()), (COUPLED, co.GaussLegendre(3))], ids=["split", "coupled"]
)
def test_files_have_the_same_default(H, scheme, tmp_path, capsys):
    path = tmp_path / "run.toml"
    path.write_text(
        f'[algebra]\nname = "e(3)"\n[hamiltonian]\nformula = "{H}"\n[initial]\nx = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\n'
        "[run]\nt_span = [0, 0.5]\nstep = 0.05\n"
    )
    assert command(capsys, "run", path, "--quiet", "--out", tmp_path / "run.nc").status == 0
    assert co.load(tmp_path / "run.nc").method == scheme
