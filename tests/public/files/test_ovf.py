"""OVF 2.0 files of spins: written as others read them, and read as others write them."""

import struct

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

NODES = (4, 3, 2)
DATA = ("text", "binary 4", "binary 8")


def moments(nodes=NODES):
    """Return unequal vectors on a mesh, (nx, ny, nz, 3)."""
    return np.random.default_rng(3).normal(size=(*nodes, 3))


def foreign(values, data="Binary 4", change=lambda head: head, labels=""):
    """Return the bytes of a file in the manner of mumax3, by `struct` alone."""
    nx, ny, nz, _ = values.shape
    head = f"""# OOMMF OVF 2.0
# Segment count: 1
# Begin: Segment
# Begin: Header
# Title: m
# meshtype: rectangular
# meshunit: m
# xmin: 0
# ymin: 0
# zmin: 0
# xmax: {nx * 2e-9}
# ymax: {ny * 3e-9}
# zmax: {nz * 4e-9}
# valuedim: 3
# valuelabels: m_x m_y m_z
# valueunits: 1 1 1
# Desc: Total simulation time:  2.5e-10  s
# x base: 1e-09 ## in the middle
# ybase: 1.5e-09
# zbase: 2e-09
# XNodes: {nx}
# ynodes: {ny}
# znodes: {nz}
# xstepsize: 2e-09
# ystepsize: 3e-09
# zstepsize: 4e-09
{labels}# End: Header
# Begin: Data {data}
"""
    order = [values[i, j, k] for k in range(nz) for j in range(ny) for i in range(nx)]
    if data == "Text":
        body = "".join(f"{x!r}\t{y!r} {z!r}\n" for x, y, z in (v.tolist() for v in order)).encode()
    else:
        kind, check = ("<f", 1234567.0) if data == "Binary 4" else ("<d", 123456789012345.0)
        body = struct.pack(kind, check) + b"".join(struct.pack(kind, one) for v in order for one in v) + b"\n"
    return change(head).encode() + body + f"# End: Data {data}\n# End: Segment\n".encode()


@pytest.mark.parametrize("data", ["Text", "Binary 4", "Binary 8"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_files_of_others_are_read(tmp_path, data, ends):
    file = tmp_path / "m.ovf"
    file.write_bytes(foreign(moments(), data, lambda head: head.replace("\n", ends)))
    field = co.spins.read_ovf(file)
    assert np.array_equal(field.values, np.float32(moments()) if data == "Binary 4" else moments())
    assert (field.cell, field.length_unit, field.units, field.title, field.time) == (
        (2e-9, 3e-9, 4e-9),
        "m",
        ("1",) * 3,
        "m",
        2.5e-10,
    )
    # The state of a lattice has the last axis fastest, and spins opposite to moments.
    x = field.spins(NODES)
    for site, cell in enumerate(np.ndindex(NODES)):
        m = field.values[cell]
        assert np.allclose(x[3 * site : 3 * site + 3], -m / np.linalg.norm(m), rtol=0, atol=1e-15)


@pytest.mark.parametrize("data", DATA)
@pytest.mark.parametrize("shape", [5, (5, 2), NODES])
def test_files_written_are_those_of_others(tmp_path, data, shape):
    full = (*np.atleast_1d(shape).tolist(), 1, 1)[:3]
    m = moments(full)
    co.spins.write_ovf(tmp_path / "m.ovf", -m.ravel(), shape, cell=(2e-9, 3e-9, 4e-9), data=data, time=2.5e-10)
    (tmp_path / "other.ovf").write_bytes(foreign(m, data.title()))
    written, other = (co.spins.read_ovf(tmp_path / name) for name in ("m.ovf", "other.ovf"))
    assert np.array_equal(written.values, other.values)
    assert (written.cell, written.units, written.time) == (other.cell, other.units, other.time)
    ours, theirs = ((tmp_path / name).read_bytes() for name in ("m.ovf", "other.ovf"))
    if data != "text":
        begin = f"# Begin: Data {data.title()}\n".encode()
        assert ours.partition(begin)[2] == theirs.partition(begin)[2]

    def numbers(text):
        pairs = (
            line[2:].partition(b":")
            for line in text.split(b"Begin: Data")[0].splitlines()
            if line.startswith((b"# x", b"# y", b"# z"))
        )
        return {label: float(value) for label, _, value in pairs}

    assert numbers(ours)[b"xmax"] == pytest.approx(2e-9 * full[0]) and numbers(ours)[b"zbase"] == 2e-9


def test_a_run_goes_on_from_a_file(tmp_path):
    system = co.systems.spin_lattice("square", (3, 4), field=(0.3, 0.1, 1.0))
    x0 = moments((3, 4)).reshape(-1, 3)
    x0 = (x0 / np.linalg.norm(x0, axis=1)[:, None]).ravel()
    co.spins.write_ovf(tmp_path / "m.omf", x0, (3, 4), cell=(1e-9,) * 3)
    again = co.spins.read_ovf(tmp_path / "m.omf").spins((3, 4))
    assert np.abs(again - x0).max() < 4e-16
    ends = [co.integrate(system, x, (0, 1), 0.1).x[-1] for x in (x0, again)]
    assert np.abs(ends[0] - ends[1]).max() < 1e-14


@pytest.mark.parametrize("shape", [(8, 6, 4), (2, 3, 1), (12, 9, 6)])
def test_proportional_meshes_are_interpolated(tmp_path, shape):
    """Directions whose components are linear in the place are exact between the centres of the given cells."""
    nodes = (4, 6, 2) if shape == (2, 3, 1) else NODES

    def field(places):
        return places @ np.array([[0.1, 0, 0.02], [0, 0.05, 0], [0.03, 0, 0]]) + [0.2, 0.3, 1.0]

    def centres(counts):
        axes = [(np.arange(n) + 0.5) / n for n in counts]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    (tmp_path / "m.ovf").write_bytes(foreign(field(centres(nodes)), "Binary 8"))
    edge = 0.5 / np.array(nodes)
    expected = -field(np.clip(centres(shape), edge, 1 - edge))
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    assert np.abs(co.spins.read_ovf(tmp_path / "m.ovf").spins(shape) - expected.ravel()).max() < 1e-14


@pytest.mark.parametrize("count", [2, 3, 8, 10, 15])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_directions_turn_linearly_between_neighbours(tmp_path, axis, count):
    """A chain whose moments differ from cell to cell: components lie on the segments between adjacent centres."""
    nodes = tuple(5 if a == axis else 1 for a in range(3))
    values = np.random.default_rng(3).standard_normal((5, 3)) + [0, 0, 2.0]
    (tmp_path / "m.ovf").write_bytes(foreign(values.reshape(*nodes, 3), "Binary 8"))
    wanted = [np.interp((np.arange(count) + 0.5) / count, (np.arange(5) + 0.5) / 5, one) for one in values.T]
    wanted = -np.transpose(wanted) / np.linalg.norm(wanted, axis=0)[:, None]
    found = co.spins.read_ovf(tmp_path / "m.ovf").spins(tuple(count if a == axis else 1 for a in range(3)))
    np.testing.assert_allclose(found.reshape(-1, 3), wanted, rtol=0, atol=1e-14)


def test_cells_without_material_have_no_spin(tmp_path):
    m = moments() * 8e5
    m[1, 2, 0] = 0.0
    (tmp_path / "m.ovf").write_bytes(foreign(m, "Binary 8", lambda head: head.replace("1 1 1", "A/m")))
    field = co.spins.read_ovf(tmp_path / "m.ovf")
    lengths = np.linalg.norm(field.spins(NODES).reshape(*NODES, 3), axis=-1)
    assert lengths[1, 2, 0] == 0.0 and np.allclose(np.delete(lengths.ravel(), 1 * 6 + 2 * 2), 1.0, atol=1e-15)
    assert field.units == ("A/m",) * 3


def test_other_meshes_and_files_are_refused(tmp_path):
    file = tmp_path / "m.ovf"

    def read(content):
        file.write_bytes(content)
        return co.spins.read_ovf(file)

    good = foreign(moments())
    for shape in ((8, 3, 2), (4, 3), (3, 4, 2), 24):
        with refused(ValueError, "another mesh, 4 x 3 x 2 cells"):
            read(good).spins(shape)
    for change, words in [
        (lambda h: h.replace("OOMMF OVF 2.0", "OOMMF: rectangular mesh v1.0"), "another version than 2.0"),
        (lambda h: h.replace("OOMMF OVF 2.0", "vtk DataFile"), "no OVF 2.0 file"),
        (lambda h: h.replace("rectangular", "irregular"), "irregular"),
        (lambda h: h.replace("valuedim: 3", "valuedim: 1"), "with 1 components"),
        (lambda h: h.replace("# XNodes: 4\n", ""), "no 'xnodes'"),
        (lambda h: h.replace("XNodes: 4", "XNodes: -4"), "xnodes is '-4'"),
        (lambda h: h.replace("XNodes: 4", "XNodes: 999999999"), "999999999 x 3 x 2 cells need"),
        (lambda h: h.replace("xstepsize: 2e-09", "xstepsize: 0"), "xstepsize is '0'"),
        (lambda h: h.replace("Data Binary 4", "Data Binary 8"), "123456789012345"),
        (lambda h: h.replace("Data Binary 4", "Data Binary 16"), "no block of data"),
    ]:
        with refused(ValueError, words):
            read(foreign(moments(), change=change))
    bad = moments()
    bad[3, 0, 1, 2] = np.nan
    for content, words in [
        (good[: good.index(b"# End: Data") - 9], "has 70 numbers"),
        (b"", "no OVF 2.0 file"),
        (foreign(moments(), "Text").replace(b"\t", b"\tx", 1), "holds what is no number"),
        (foreign(bad, "Text"), "cell (3, 0, 1)"),
    ]:
        with refused(ValueError, words):
            read(content)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"shape": 4, "spins": np.ones(11)}, "4 x 1 x 1 cells"),
        ({"cell": (1e-9, 0, 1e-9)}, "three positive lengths"),
        ({"data": "binary 16"}, "binary 8"),
        ({"path": "m.vtk"}, "suffix"),
        ({"spins": np.full(12, np.nan)}, "finite"),
    ],
)
def test_states_and_cells_that_are_refused(tmp_path, given, words):
    good = {"path": "m.ovf", "spins": np.ones(12), "shape": (2, 2), "cell": (1e-9,) * 3} | given
    with refused(ValueError, words):
        co.spins.write_ovf(**good | {"path": tmp_path / good["path"]})
    assert not list(tmp_path.iterdir())


def test_damaged_files_are_read_or_refused(tmp_path):
    rng, file = np.random.default_rng(1), tmp_path / "m.ovf"
    for data in ("Text", "Binary 4"):
        good = foreign(moments(), data)
        for _ in range(300):
            content = bytearray(good)
            for place in rng.integers(0, len(content), 3):
                content[place] = rng.integers(0, 256)
            file.write_bytes(bytes(content[: rng.integers(1, len(content))] if rng.random() < 0.3 else content))
            try:
                assert np.isfinite(co.spins.read_ovf(file).values).all()
            except ValueError as error:
                assert str(file) in str(error)
