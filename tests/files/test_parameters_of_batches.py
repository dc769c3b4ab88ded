"""The numbers in which the systems of a batch differ are coordinates of its dataset, however that was written."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.datasets.variables import parameters_of

CONSTANTS = np.array([2.5, 3.0, 4.0])
BODIES = co.batch([co.systems.rigid_body(inertia=(2, 3, c)) for c in CONSTANTS])
STATES = np.array([(1.0, 0.2, 0.1), (0.3, 1.0, 0.1), (0.1, 0.2, 1.0)])


def test_a_dataset_can_be_read_by_what_was_varied():
    found = co.integrate(BODIES, STATES, (0, 1), 0.1).to_xarray()
    assert found["swept_inertia_2"].dims == ("member",) and np.array_equal(found["swept_inertia_2"], CONSTANTS)
    assert found["swept_inertia_2"].attrs["long_name"] == "system.parameters.inertia[2]"
    assert "swept_inertia_0" not in found.coords and "swept_inertia_1" not in found.coords
    chosen = found.x.isel(time=-1).swap_dims(member="swept_inertia_2").sel(swept_inertia_2=3.0)
    assert np.array_equal(chosen, found.x[-1, 1])


@pytest.mark.parametrize("size", [None, 2])
def test_archives_have_them_too(tmp_path, size):
    if size is None:
        co.integrate(BODIES, STATES, (0, 1), 0.1, archive=tmp_path / "kept.zarr")
    else:
        co.ensemble(BODIES, STATES, (0, 1), 0.1, archive=tmp_path / "kept.zarr", members_per_block=size)
    found = co.open_archive(tmp_path / "kept.zarr").to_xarray()
    assert "swept_inertia_2" in found.coords and np.array_equal(found["swept_inertia_2"], CONSTANTS)


def test_what_cannot_be_a_number_for_each_member_is_left_out():
    alike = co.batch([co.systems.rigid_body(inertia=(2, 3, 4))] * 3)
    plain = co.batch([co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, c])) for c in CONSTANTS])
    for system in (alike, plain, BODIES[0]):
        assert parameters_of(system) == {}


def test_bodies_with_forces_have_those_of_the_bodies():
    forced = co.batch([body.with_forces(co.forces.LinearDamping(0.1)) for body in BODIES])
    ((_, numbers, about),) = parameters_of(forced).values()
    assert np.array_equal(numbers, CONSTANTS) and about == {"long_name": "system.parameters.inertia[2]"}
