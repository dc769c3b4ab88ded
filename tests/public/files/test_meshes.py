"""Bodies from OBJ, STL, PLY and glTF: moments against integrals over tetrahedra, refused surfaces, and gravity."""

import importlib.util
import json
import os
import struct
from itertools import combinations_with_replacement

import numpy as np
import pytest
from surfaces import BODIES, BOX, WRITERS, Surface, glb, gltf_parts, integral, joined, obj_plain, ply_text, surface

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.skipif(importlib.util.find_spec("trimesh") is None, reason="trimesh is not installed")

S = co.systems
UNIT = {".obj": 0.001, ".stl": 1e-7, ".ply": 1e30, ".gltf": None, ".glb": None}
ROUNDING = 2e-14  # a hundred roundings, relative to the largest
# Each format ten times, its ways of writing in turn.
FILES = [
    pytest.param(suffix, writers[k % len(writers)], name, id=f"{writers[k % len(writers)].__name__}, {name}")
    for suffix, writers in WRITERS.items()
    for k, name in enumerate(BODIES)
]


def moments_of(body):
    """Return volume, centre, and tensors of second, third and fourth moments about it."""
    volume = integral(body, lambda p: np.ones(len(p)))
    centre = integral(body, lambda p: p) / volume

    def products(p):
        return [p[:, :, None] * p[:, None, :], np.einsum("na,nb,nc->nabc", p, p, p)]

    second = integral(body, lambda p: products(p - centre)[0])
    third = integral(body, lambda p: products(p - centre)[1])
    fourth = integral(body, lambda p: np.einsum("na,nbcd->nabcd", p - centre, products(p - centre)[1]))
    return volume, centre, second, third, fourth


@pytest.mark.thinned(1)
@pytest.mark.parametrize("suffix, writer, name", FILES)
def test_meshes_have_the_moments_of_their_volume(tmp_path, suffix, writer, name):
    path, body, unit = tmp_path / f"mesh{suffix}", BODIES[name], UNIT[suffix] or 1.0
    writer(path, surface(body))
    rho = 2.5 / unit**3
    found = co.bodies.read(path, scale=UNIT[suffix], density=rho)
    volume, centre, second, third, fourth = moments_of(body)
    # Vertices far away have the rounding of their distance.
    size = np.abs(body[0][1] - centre).max()
    away = 1.0 + np.abs(centre).max() / size
    assert found.mass == pytest.approx(2.5 * volume, rel=ROUNDING * away)
    assert np.abs(found.centre_of_mass / unit - centre).max() <= ROUNDING * size * away
    inertia = 2.5 * unit**2 * (np.trace(second) * np.eye(3) - second)
    assert np.abs(found.inertia - inertia).max() <= ROUNDING * away * np.abs(inertia).max()
    for moments, wanted, order in ((found.third_moments, third, 3), (found.fourth_moments, fourth, 4)):
        scale = np.abs(fourth).max() ** (order / 4) * volume ** (1 - order / 4)
        assert np.abs(moments / (2.5 * unit**order) - wanted).max() <= ROUNDING * away * scale
    points = np.concatenate([p for _, p in body])
    assert found.radius == pytest.approx(unit * np.linalg.norm(points - centre, axis=1).max(), rel=ROUNDING * away)
    assert str(path) in found.frame and ("+Y up" in found.frame) == (UNIT[suffix] is None)
    assert ("length: m" in found.units) == (UNIT[suffix] is None)


def test_a_mass_in_place_of_a_density(tmp_path):
    path = tmp_path / "box.obj"
    obj_plain(path, surface(BODIES["box"]))
    found = co.bodies.read(path, scale=0.001, mass=6)
    assert found.inertia == pytest.approx(2e-6 * np.diag([4.25, 1.25, 5.0]), rel=1e-14)
    assert (found.inertia[~np.eye(3, dtype=bool)] == 0.0).all()
    assert co.systems.body(found).parameters["inertia"] == tuple(found.inertia.diagonal())
    glb(tmp_path / "box.glb", surface(BODIES["box"]))
    scaled = co.bodies.read(tmp_path / "box.glb", scale=0.001, mass=6)
    assert scaled.inertia == pytest.approx(found.inertia, rel=1e-14) and "0.001 times" in scaled.units


BOX_SURFACE = surface([(1, BOX)])
INNER = surface([(1, 0.5 * BOX)])


def moved(mesh, *by):
    return Surface(mesh.vertices + by, mesh.triangles)


def one_flipped():
    triangles = BOX_SURFACE.triangles.copy()
    triangles[4] = triangles[4, ::-1]
    return Surface(BOX_SURFACE.vertices, triangles)


def split_by_rounding():
    """A corner that one triangle has a bit elsewhere."""
    vertices = np.concatenate([BOX_SURFACE.vertices, BOX_SURFACE.vertices[:1] * (1 + 1e-12)])
    triangles = BOX_SURFACE.triangles.copy()
    first = np.argwhere(triangles == 0)[0]
    triangles[tuple(first)] = 8
    return Surface(vertices, triangles)


SURFACES = {
    "open": (Surface(BOX_SURFACE.vertices, BOX_SURFACE.triangles[1:]), ["is open", "3 edges"]),
    "with a seam": (split_by_rounding(), ["is open", "merge"]),
    "inside out": (BOX_SURFACE.flipped(), ["inside out", "flip"]),
    "one triangle flipped": (one_flipped(), ["turned against", "3 edges"]),
    "hollow, inside out": (joined(BOX_SURFACE.flipped(), INNER), ["2 separate surfaces", "inside out"]),
    "part inside out": (joined(BOX_SURFACE, moved(INNER, 5, 0, 0).flipped()), ["2 separate surfaces", "inside out"]),
    "part in a part": (joined(BOX_SURFACE, INNER), ["2 separate surfaces", "lies in another"]),
    "flat": (Surface(BOX_SURFACE.vertices * (1, 1, 0), BOX_SURFACE.triangles), ["no volume"]),
    "a point": (Surface(0.0 * BOX_SURFACE.vertices, BOX_SURFACE.triangles), ["size 0", "float64"]),
    "too large": (Surface(1e61 * BOX_SURFACE.vertices, BOX_SURFACE.triangles), ["size 2e+61", "float64"]),
    "overflow": (Surface(1e308 * BOX_SURFACE.vertices, BOX_SURFACE.triangles), ["size inf", "float64"]),
}


@pytest.mark.parametrize("mesh, named", SURFACES.values(), ids=SURFACES)
def test_surfaces_are_refused(tmp_path, mesh, named):
    path = tmp_path / "mesh.obj"
    obj_plain(path, mesh)
    with refused(ValueError, str(path), *named):
        co.bodies.read(path, scale=1.0, mass=1.0)


def test_touching_boxes_are_one_body(tmp_path):
    """Two boxes that share a face, an edge or a corner: every edge is passed equally often in both directions."""
    for by in ((2, 0, 0), (2, 2, 0), (2, 2, 2)):
        obj_plain(tmp_path / "mesh.obj", joined(BOX_SURFACE, moved(BOX_SURFACE, *by)))
        found = co.bodies.read(tmp_path / "mesh.obj", scale=1.0, density=1.0)
        assert found.mass == pytest.approx(16, rel=1e-14)
        assert found.centre_of_mass == pytest.approx(0.5 * np.array(by), abs=1e-14)


@pytest.mark.parametrize(
    "arguments, named",
    [
        ({"mass": 1.0}, ["scale", "OBJ files have no unit"]),
        ({"scale": 1.0}, ["mass", "density", "one of them"]),
        ({"scale": 1.0, "mass": 1.0, "density": 1.0}, ["mass and density were both given", "one of them"]),
        ({"scale": 0.0, "mass": 1.0}, ["scale"]),
        ({"scale": 1.0, "mass": -1.0}, ["mass"]),
        ({"scale": 1.0, "density": np.inf}, ["density"]),
        ({"scale": 1.0, "mass": 1.0, "link": "a"}, ["link", "no links"]),
        ({"scale": 1.0, "mass": 1.0, "configuration": {}}, ["configuration", "no links"]),
    ],
)
def test_arguments_are_refused(tmp_path, arguments, named):
    obj_plain(tmp_path / "mesh.obj", BOX_SURFACE)
    with refused(ValueError, *named):
        co.bodies.read(tmp_path / "mesh.obj", **arguments)


def test_trimesh_is_named(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name, *more: None if name == "trimesh" else find(name, *more)
    )
    obj_plain(tmp_path / "mesh.obj", BOX_SURFACE)
    with refused(ModuleNotFoundError, "mesh.obj", "trimesh", "coadjoint[bodies]"):
        co.bodies.read(tmp_path / "mesh.obj", scale=1.0, mass=1.0)


DAMAGED = {
    "empty": (".stl", b"", []),
    "text": (".stl", b"hello", []),
    "points": (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", []),
    "in the plane": (".obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", []),
    "missing vertex": (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", []),
    "words": (".obj", b"v 0 0 zero\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", []),
    "huge counts": (
        ".ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n",
        ["length"],
    ),
    "no end of the header": (".ply", b"ply\nformat ascii 1.0\nelement vertex 1\n", []),
    "no JSON": (".gltf", b"{", ["no file of glTF 2.0"]),
    "another JSON": (".gltf", b"[1, 2]", ["no file of glTF 2.0"]),
    "deep JSON": (".gltf", b"[" * 100_000, ["no file of glTF 2.0"]),
    "short GLB": (".glb", b"glTF\2\0\0\0", ["no file of glTF 2.0"]),
}  # fmt: skip


@pytest.mark.parametrize("suffix, content, named", DAMAGED.values(), ids=DAMAGED)
def test_damaged_files_are_refused(tmp_path, suffix, content, named):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(content)
    with refused(ValueError, str(path), *named):
        co.bodies.read(path, scale=1.0, mass=1.0)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("writer", [glb, ply_text, obj_plain], ids=lambda writer: writer.__name__)
def test_truncated_files_are_refused(tmp_path, writer):
    suffix = next(suffix for suffix, writers in WRITERS.items() if writer in writers)
    path = tmp_path / f"mesh{suffix}"
    writer(path, BOX_SURFACE)
    content = path.read_bytes()
    for length in range(0, len(content) - 16, 97):
        path.write_bytes(content[:length])
        with refused(ValueError, str(path)):
            co.bodies.read(path, scale=1.0, mass=1.0)


def sparse(header):
    header["accessors"][0]["sparse"] = {"count": 1}


def without_view(header):
    header["accessors"][0] = {"componentType": 5126, "count": 10**12, "type": "VEC3"}


def too_long(header):
    header["accessors"][0]["count"] = 10**12


def fan(header):
    header["meshes"][0]["primitives"][0]["mode"] = 6


def two_scenes(header):
    del header["scene"]
    header["scenes"] *= 2


CHANGES = {
    "sparse": (sparse, ["accessors[0]", "sparse"]),
    "without a view": (without_view, ["accessors[0]", "no bufferView"]),
    "too long": (too_long, ["accessors[0]", "longer than its bufferView"]),
    "fan": (fan, ["meshes[0].primitives[0]", "fan"]),
    "two scenes": (two_scenes, ["scenes", "2 without a default"]),
    "version": (lambda header: header["asset"].update(version="1.0"), ["asset.version", "1.0"]),
    "required": (lambda header: header.update(extensionsRequired=["KHR_x"]), ["extensionsRequired", "KHR_x"]),
    "draco": (
        lambda header: header["meshes"][0]["primitives"][0].update(extensions={"KHR_draco_mesh_compression": {}}),
        ["meshes[0].primitives[0]", "Draco"],
    ),
    "morph": (
        lambda header: header["meshes"][0]["primitives"][0].update(targets=[{"POSITION": 0}]), ["morph targets"]),
    "skin": (
        lambda header: (header["nodes"][0].update(skin=0), header.update(skins=[{"joints": [0]}])), ["skins"]),
    "network": (lambda header: header["buffers"][0].update(uri="https://example.org/a.bin"), ["buffers[0]", "folder"]),
    "outside": (lambda header: header["buffers"][0].update(uri="../a.bin"), ["buffers[0]", "folder"]),
    "absolute": (lambda header: header["buffers"][0].update(uri="/etc/passwd"), ["buffers[0]", "folder"]),
    "missing": (lambda header: header["buffers"][0].update(uri="none.bin"), ["buffers[0]", "cannot be read"]),
    "a number as a name": (lambda header: header["buffers"][0].update(uri=1), ["no file of glTF"]),
    "a null in a name": (lambda header: header["buffers"][0].update(uri="a%00b"), ["no file of glTF"]),
    "a text as a count": (lambda header: header["accessors"][0].update(count="8"), ["no file of glTF"]),
    "a negative length": (lambda header: header["bufferViews"][0].update(byteLength=-1), ["no file of glTF"]),
    "buffers that are none": (lambda header: header.update(buffers=5), ["no file of glTF"]),
}  # fmt: skip


@pytest.mark.parametrize("change, named", CHANGES.values(), ids=CHANGES)
def test_what_gltf_would_leave_out_is_refused(tmp_path, change, named):
    header, data = gltf_parts(BOX_SURFACE)
    (tmp_path / "a.bin").write_bytes(data)
    header["buffers"][0]["uri"] = "a.bin"
    change(header)
    path = tmp_path / "mesh.gltf"
    path.write_text(json.dumps(header))
    with refused(ValueError, str(path), *named):
        co.bodies.read(path, mass=1.0)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_buffer_that_is_a_pipe_is_not_waited_for(tmp_path):
    header, _ = gltf_parts(BOX_SURFACE)
    header["buffers"][0]["uri"] = "a.bin"
    os.mkfifo(tmp_path / "a.bin")
    (tmp_path / "mesh.gltf").write_text(json.dumps(header))
    with refused(ValueError, "mesh.gltf", "buffers[0]", "regular file"):
        co.bodies.read(tmp_path / "mesh.gltf", mass=1.0)


def test_nothing_beside_a_mesh_is_read(tmp_path):
    """Materials and textures, whose files may be pipes, have no mass."""
    if hasattr(os, "mkfifo"):
        for name in ("none.mtl", "none.png"):
            os.mkfifo(tmp_path / name)
    for suffix, writers in WRITERS.items():
        writers[min(1, len(writers) - 1)](tmp_path / f"mesh{suffix}", BOX_SURFACE)
        assert co.bodies.read(tmp_path / f"mesh{suffix}", scale=1.0, mass=1.0).mass == 1.0


def test_a_binary_stl_of_another_length_is_refused(tmp_path):
    path = tmp_path / "mesh.stl"
    path.write_bytes(b" " * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50)
    with refused(ValueError, str(path)):
        co.bodies.read(path, scale=1.0, mass=1.0)


# Gravity.


def potential(body, distance, order, A, direction):
    """Return the energy per mass of a point at a distance from a body."""
    pair = S.gravitating_bodies([body, (0, 0, 0)], (body.mass, 1e-9), order=order)
    r = np.array([np.zeros(3), distance * direction])
    return pair.energy(pair.state(r, attitudes=[A, np.eye(3)])) / 1e-9


@pytest.mark.parametrize("name", ["tetrahedron", "pyramid", "two apart"])
def test_gravity_of_a_mesh_to_fourth_order(tmp_path, name):
    """The error against the integral over the volume falls by the power of the first term that is left out."""
    path, body = tmp_path / "mesh.obj", BODIES[name]
    obj_plain(path, surface(body))
    found = co.bodies.read(path, scale=1.0, density=2.0)
    A = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    A[:, 0] *= np.linalg.det(A)
    directions = [one / np.linalg.norm(one) for one in np.random.default_rng(2).normal(size=(8, 3))]
    distances = found.radius * np.array([16.0, 32.0])
    for order, power in ((0, 3), (2, 4), (4, 6)):
        errors = np.empty((2, len(directions)))
        for k, distance in enumerate(distances):
            for n, direction in enumerate(directions):
                at = found.centre_of_mass + A.T @ (distance * direction)
                exact = -2.0 * integral(body, lambda p, at=at: 1.0 / np.linalg.norm(at - p, axis=-1))
                errors[k, n] = potential(found, distance, order, A, direction) - exact
        before, after = np.sqrt((errors**2).sum(axis=1))
        assert abs(np.log2(before / after) - power) < 0.15


def test_a_homogeneous_ellipsoid_has_the_moments_of_one():
    """Its moments in closed form, as those that are taken without them, beside a body that has none."""
    axes, mass = np.array([1.0, 1.4, 1.9]), 3.0
    squares = mass * axes**2 / 5
    fourth = np.zeros((3,) * 4)
    for i in range(3):
        for j in range(3):
            value = 3 * mass * axes[i] ** 4 / 35 if i == j else mass * axes[i] ** 2 * axes[j] ** 2 / 35
            for index in {(i, i, j, j), (i, j, i, j), (i, j, j, i)}:
                fourth[index] = value
    inertia = squares.sum() - squares
    known = co.bodies.MassProperties(mass, inertia, third_moments=np.zeros((3,) * 3), fourth_moments=fourth)
    other = (0.2, 0.3, 0.35)
    with_moments = S.gravitating_bodies([known, other], (mass, 1.0), order=4)
    without = S.gravitating_bodies([inertia, other], (mass, 1.0), order=4)
    assert without.parameters["higher_moments"] is None
    rng = np.random.default_rng(3)
    attitudes = [np.linalg.qr(rng.normal(size=(3, 3)))[0] * [1, 1, 1] for _ in range(2)]
    attitudes = [A * np.linalg.det(A) for A in attitudes]
    x = without.state([[0, 0, 0], [4, 1, -2]], attitudes=attitudes)
    assert with_moments.energy(x) == pytest.approx(without.energy(x), rel=1e-15)
    slope, wanted = with_moments.hamiltonian.gradient(x), without.hamiltonian.gradient(x)
    # Derivatives by the axes differ along the axes, where the tensors have other traces; their torques do not.
    assert slope[24:] == pytest.approx(wanted[24:], rel=1e-12, abs=1e-13)
    assert with_moments.vector_field(x) == pytest.approx(without.vector_field(x), rel=1e-11, abs=1e-13)
    rows = np.array(with_moments.parameters["higher_moments"])
    again = S.get("gravitating_bodies", **with_moments.parameters)
    assert rows.shape == (2, 25) and again.energy(x) == with_moments.energy(x)
    order = list(combinations_with_replacement(range(3), 4))
    assert rows[0, 10:] == pytest.approx([fourth[i] for i in order])


def two_lumps(unit=1.0):
    """Return two bodies without any symmetry, by points."""
    rng, found = np.random.default_rng(5), []
    for mass in (3.0, 2.0):
        y, m = rng.normal(size=(6, 3)), mass * np.array([1, 2, 3, 1, 2, 1]) / 10
        y = unit * (y - m @ y / mass)
        second = np.einsum("k,ka,kb->ab", m, y, y)
        moments = [np.einsum(f"k,{','.join('k' + a for a in s)}->{s}", m, *[y] * len(s)) for s in ("abc", "abcd")]
        moments = [0.5 * (one + one.transpose()) for one in moments]
        inertia = np.trace(second) * np.eye(3) - second
        found.append(co.bodies.MassProperties(mass, inertia, third_moments=moments[0], fourth_moments=moments[1]))
    return found


def test_derivatives_of_gravity_with_higher_moments():
    pair = S.gravitating_bodies(two_lumps(), order=4)
    x = pair.state([[0, 0, 0], [5, 2, -3]], attitudes=[np.eye(3), np.diag([1, -1, -1])])
    x = x + 0.01 * np.random.default_rng(2).normal(size=x.shape)
    h = 2.0**-16

    def central(f):
        return np.array([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))])

    H = pair.hamiltonian
    assert central(H.value) == pytest.approx(H.gradient(x), rel=1e-6, abs=1e-9)
    assert central(H.gradient) == pytest.approx(H.hessian(x), rel=1e-6, abs=1e-8)
    # Forces of a potential of differences and turns: total momentum, and total angular momentum at rest.
    for integral_ in pair.integrals.values():
        assert (
            abs(integral_.gradient(pair.state(pair.positions(x))) @ pair.vector_field(pair.state(pair.positions(x))))
            < 1e-13
        )


def test_gravity_of_higher_moments_in_other_units():
    x0 = [[0, 0, 0], [5, 2, -3]]
    plain = S.gravitating_bodies(two_lumps(), order=4)
    for unit in (1e-7, 1e30):
        pair = S.gravitating_bodies(two_lumps(unit), order=4)
        found = pair.energy(pair.state(unit * np.array(x0)))
        assert found * unit == pytest.approx(plain.energy(plain.state(x0)), rel=1e-13)


@pytest.mark.long
@pytest.mark.parametrize("options", [{}, {"t_span": (5.0, 15.0)}, {"members": 3}], ids=["plain", "t0", "members"])
def test_runs_with_higher_moments(tmp_path, options):
    """A run against DOP853, stored and resumed with its moments, and the same of members of an ensemble."""
    from scipy.integrate import solve_ivp

    pair = S.gravitating_bodies(two_lumps(), order=4)
    x0 = pair.state(
        [[0, 0, 0], [12, 2, -3]], [[0, -0.25, 0], [0, 0.38, 0]], angular_velocities=[[0.1, 0.3, 0], [0, 0, 0.5]]
    )
    t0, t1 = options.get("t_span", (0.0, 10.0))
    exact = solve_ivp(lambda t, x: pair.vector_field(x), (t0, t1), x0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    starts = np.tile(x0, (options["members"], 1)) if "members" in options else x0
    sol = co.integrate(pair, starts, (t0, t1), 0.05, co.Splitting(order=8), archive=tmp_path / "run.zarr")
    end = np.atleast_2d(sol.x[-1])
    assert np.abs(end - exact).max() < 1e-8 and sol.drift()["energy"] < 1e-9
    more = co.resume(tmp_path / "run.zarr", t1 + 5.0)
    back = co.integrate(pair, more.x[-1], (t1 + 5.0, t0), 0.05, co.Splitting(order=8))
    assert np.abs(np.atleast_2d(back.x[-1]) - x0).max() < 1e-8


@pytest.mark.parametrize(
    "arguments, named",
    [
        ({"higher_moments": np.zeros((2, 25)), "order": 2}, ["higher_moments", "order=2"]),
        ({"higher_moments": np.zeros((2, 24)), "order": 4}, ["higher_moments", "(2, 24)", "(2, 25)"]),
        ({"higher_moments": np.full((2, 25), np.nan), "order": 4}, ["higher_moments[0, 0]"]),
    ],
)
def test_wrong_higher_moments_are_refused(arguments, named):
    with refused(ValueError, *named):
        S.gravitating_bodies(**arguments)


def test_the_field_of_a_polyhedron(tmp_path):
    """Against the closed form of a polyhedron of another library, which has no error of expansion."""
    polyhedral = pytest.importorskip("polyhedral_gravity")
    body = BODIES["hexagonal prism"]
    mesh = surface(body)
    obj_plain(tmp_path / "mesh.obj", mesh)
    found = co.bodies.read(tmp_path / "mesh.obj", scale=1.0, density=2.0)
    source = mesh.vertices.tolist(), mesh.triangles.tolist()
    field = polyhedral.GravityEvaluable(polyhedral.Polyhedron(source, 2.0, metric_unit=polyhedral.MetricUnit.UNITLESS))
    direction = np.array([1.0, 2.0, 2.0]) / 3.0
    for order, power in ((2, 4), (4, 6)):
        errors = []
        for distance in (8.0, 16.0):
            value, _, _ = field((found.centre_of_mass + distance * direction).tolist(), parallel=False)
            errors.append(potential(found, distance, order, np.eye(3), direction) + value)
        assert abs(np.log2(abs(errors[0] / errors[1])) - power) < 1.1
