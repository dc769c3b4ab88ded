"""The vertical of tops, to which inclinations are measured."""

import numpy as np
import pytest

import coadjoint as co

TOPS = {
    "heavy_top": co.systems.heavy_top(),
    "kovalevskaya_top": co.systems.kovalevskaya_top(),
    "lagrange_top": co.systems.lagrange_top(),
}
X = np.array([0.0, 0.2, 3.0, 0.5, 0.0, 0.75**0.5])


@pytest.mark.parametrize("name", TOPS)
def test_inclinations_are_to_the_vertical_of_the_top(name):
    sol = co.integrate(TOPS[name], X, (0, 2), 0.01, co.Splitting(order=4), attitude=True)
    (axes,) = sol.plot(["nutation"]).axes
    assert axes.get_ylabel() == "inclination to the vertical [degrees]"
    inclination = axes.lines[0].get_ydata()
    exact = np.degrees(np.arccos(sol.x[:, 5]))
    assert abs(inclination[0] - exact[0]) < 1e-9
    assert exact.min() - 0.1 < inclination.min() < exact.min() + 2 and inclination.max() < exact.max() + 0.1


def test_inclinations_of_other_systems_are_to_the_third_axis():
    own = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.4]), sign=-1)
    sol = co.integrate(own, (0.1, 0.5, 1.0), (0, 5), 0.05, attitude=True)
    (axes,) = sol.plot(["nutation"]).axes
    assert axes.get_ylabel() == "inclination to the third axis of space [degrees]"
    np.testing.assert_allclose(axes.lines[0].get_ydata()[0], 0.0, atol=1e-6)


def test_drifts_have_a_time_axis():
    sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.3, 1, 0.2), (0, 1), 0.01)
    for pictures in (["drift"], ["drift", "coadjoint orbit"]):
        labels = [axes.get_xlabel() for axes in sol.plot(pictures, width=3.4).axes]
        assert "time $t$" in labels
