"""Runs written as OVF, states of models from files of meshes, and files of VTK as others write them."""

import base64
import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

CELL = (2e-9, 3e-9, 1e-9)
NODES = (4, 3, 2)


def unit_vectors(nodes=NODES, seed=3):
    m = np.random.default_rng(seed).normal(size=(*nodes, 3))
    return m / np.linalg.norm(m, axis=-1, keepdims=True)


def film(**given):
    return co.spins.micromagnetic(NODES, CELL, **{"Msat": 8e5, "Aex": 1e-11} | given).field((0.1, 0, 0.5))


@pytest.mark.parametrize("data", ["binary 8", "binary 4", "text"])
@pytest.mark.parametrize("t_span", [(0, 0.02), (3, 2.98)])
def test_a_run_is_written_with_its_moments_and_times(tmp_path, data, t_span):
    sol = co.integrate(film(), -unit_vectors().ravel(), t_span, 0.005, save_every=2)
    files = sol.to_ovf(tmp_path / "run", data=data)
    assert [file.name for file in files] == [f"m{k:06d}.ovf" for k in range(3)]
    for file, t, x in zip(files, sol.t, sol.x, strict=True):
        field = co.spins.read_ovf(file)
        assert field.time == pytest.approx(1e-12 * t) and field.cell == pytest.approx(CELL)
        tolerance = 1e-7 if data == "binary 4" else 1e-15
        assert np.abs(field.values.reshape(-1, 3) + x.reshape(-1, 3)).max() < tolerance  # m = -S
        assert np.abs(field.spins(film()) - x).max() < max(tolerance, 4e-16)
    (last,) = sol.to_ovf(tmp_path / "last.ovf", data=data)
    assert last.read_bytes() == files[-1].read_bytes()


@pytest.mark.parametrize("g", [2.0, -2.0])
def test_models_have_moments_of_the_sign_of_g(tmp_path, g):
    """Positive g: moments along the states, also of substituted ions; vacancies are cells without a moment."""
    iron = co.spins.crystal(lattice=(3, 4, 5, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    model = co.systems.spins(iron, NODES, g=g, units="meV").field((0, 0, 1.0)).vacancies(0.25, seed=1)
    model = model.substitute("Fe", 0.3, seed=2, spin=1.0, g=-g)
    x = np.stack([unit_vectors((18,)).ravel(), unit_vectors((18,), 4).ravel()])
    sol = co.integrate(model, x, (0, 0.1), 0.05)
    files = sol.to_ovf(tmp_path / "run", member=1)
    field = co.spins.read_ovf(files[0])
    assert field.cell == pytest.approx((3e-10, 4e-10, 5e-10))
    found = np.array([field.values[tuple(cell)] for cell in model.cells])
    assert np.abs(found - np.sign(model.moments)[:, None] * x[1].reshape(-1, 3)).max() < 1e-15
    assert (np.linalg.norm(field.values, axis=-1) == 0).sum() == 6
    assert np.abs(field.spins(model) - x[1]).max() < 4e-16


def test_lattices_and_archives_are_written(tmp_path):
    square = co.systems.spin_lattice("square", (3, 2), field=(0, 0, 1.0))
    sol = co.integrate(square, unit_vectors((6,)).ravel(), (0, 1), 0.5, archive=tmp_path / "run.zarr")
    files = co.load(tmp_path / "run.zarr").to_ovf(tmp_path / "files", cell=CELL)
    for file, x in zip(files, sol.x, strict=True):
        field = co.spins.read_ovf(file)
        assert field.time is None and np.abs(field.spins((3, 2)) - x).max() < 4e-16


def test_a_model_takes_files_of_its_extent(tmp_path):
    """Finer and coarser meshes of one extent, and others by name."""
    co.spins.write_ovf(tmp_path / "m.ovf", -unit_vectors().ravel(), NODES, cell=CELL)
    field = co.spins.read_ovf(tmp_path / "m.ovf")
    fine = co.spins.micromagnetic((8, 6, 4), np.array(CELL) / 2, Msat=8e5, Aex=1e-11)
    assert np.array_equal(field.spins(fine), field.spins((8, 6, 4)))
    larger = co.spins.micromagnetic(NODES, (2e-9, 3.01e-9, 1e-9), Msat=8e5, Aex=1e-11)
    for model, words in [(larger, "9.03e-09"), (co.spins.micromagnetic((4, 3, 1), CELL, Msat=1, Aex=0), "1e-09")]:
        with refused(ValueError, "8e-09 x 9e-09 x 2e-09", words):
            field.spins(model)
    hexagonal = co.spins.crystal(lattice=(3, 3, 5, 90, 90, 120), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    with refused(ValueError, "rectangular mesh"):
        field.spins(co.systems.spins(hexagonal, NODES, units="meV"))


def test_runs_that_are_not_written(tmp_path):
    sol = co.integrate(film(), -unit_vectors().ravel(), (0, 0.02), 0.01)
    pair = co.integrate(film(), -np.stack([unit_vectors().ravel()] * 2), (0, 0.02), 0.01)
    square = co.integrate(co.systems.spin_lattice("square", (2, 2)), unit_vectors((4,)).ravel(), (0, 1), 0.5)
    kagome = co.integrate(co.systems.spin_lattice("kagome", (1, 2)), unit_vectors((6,)).ravel(), (0, 1), 0.5)
    (tmp_path / "file").write_text("")
    rigid = co.integrate(co.systems.rigid_body((1, 2, 3)), (1, 0, 0.1), (0, 1), 0.5)
    for one, given, words in [
        (sol, {"cell": CELL}, "leave it out"),
        (sol, {"member": 0}, "no members"),
        (pair, {}, "2 members"),
        (pair, {"member": 2}, "member"),
        (square, {}, "no unit of length"),
        (kagome, {"cell": CELL}, "rectangular mesh"),
        (rigid, {"cell": CELL}, "rectangular mesh"),
        (sol, {"data": "binary 2"}, "binary 8"),
        (sol, {"path": tmp_path / "file"}, "folder"),
        (sol, {"path": tmp_path / "none" / "run"}, "folder"),
    ]:
        with refused((ValueError, TypeError), words):
            one.to_ovf(**{"path": tmp_path / "run"} | given)


def in_the_manner_of_mumax(m, cell, form, order="<"):
    """Return a structured grid as mumax3-convert writes it, with points at whole cells."""
    nx, ny, nz, _ = m.shape
    cells = [(i, j, k) for k in range(nz) for j in range(ny) for i in range(nx)]

    def array(rows):
        values = [float(np.float32(one)) for row in rows for one in row]
        if form == "ascii":
            return " ".join(map(repr, values))
        raw = struct.pack(f"{order}{len(values)}f", *values)
        return base64.b64encode(struct.pack(f"{order}I", len(raw)) + raw).decode()

    return f"""<?xml version="1.0"?>
<VTKFile type="StructuredGrid" version="0.1" byte_order="{"LittleEndian" if order == "<" else "BigEndian"}">
	<StructuredGrid WholeExtent="0 {nx - 1} 0 {ny - 1} 0 {nz - 1}">
		<Piece Extent="0 {nx - 1} 0 {ny - 1} 0 {nz - 1}">
			<PointData Vectors="m">
				<DataArray type="Float32" Name="m" NumberOfComponents="3" format="{form}">
					{array(m[cell] for cell in cells)}
				</DataArray>
			</PointData>
			<Points>
				<DataArray type="Float32" NumberOfComponents="3" format="{form}">
					{array(np.multiply(c, cell) for c in cells)}
				</DataArray>
			</Points>
		</Piece>
	</StructuredGrid>
</VTKFile>
"""


@pytest.mark.parametrize("form", ["ascii", "binary"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nodes", [NODES, (5, 2, 1)])
def test_grids_of_mumax_are_read(tmp_path, form, order, nodes):
    m = unit_vectors(nodes)
    (tmp_path / "m.vts").write_text(in_the_manner_of_mumax(m, CELL, form, order))
    field = co.spins.read_vtk(tmp_path / "m.vts")
    assert np.array_equal(field.values, np.float32(m)) and field.title == "m"
    known = np.array(nodes) > 1
    assert np.allclose(np.array(field.cell)[known], np.array(CELL)[known], rtol=1e-6)
    assert np.isnan(np.array(field.cell)[~known]).all()
    assert np.allclose(field.spins(nodes), -m.ravel(), atol=1e-7)


@pytest.mark.parametrize("data", ["text", "binary 4", "binary 8"])
@pytest.mark.parametrize("shape", [5, (5, 2), NODES])
def test_image_data_is_written_and_read(tmp_path, data, shape):
    full = (*np.atleast_1d(shape).tolist(), 1, 1)[:3]
    m = unit_vectors(full)
    co.spins.write_vtk(tmp_path / "m.vti", -m.ravel(), shape, cell=CELL, data=data, title='a<"&m')
    field = co.spins.read_vtk(tmp_path / "m.vti")
    assert np.abs(field.values - m).max() < (1e-7 if data == "binary 4" else 1e-16)
    assert field.cell == CELL and field.title == 'a<"&m'
    # By another parser: the extent counts cells, and x is fastest.
    root = ElementTree.parse(tmp_path / "m.vti").getroot()
    grid, array = root.find("ImageData"), root.find(".//CellData/DataArray")
    assert [int(one) for one in grid.get("WholeExtent").split()[1::2]] == list(full)
    if data == "text":
        rows = np.array(array.text.split(), dtype=float).reshape(-1, 3)
        assert np.array_equal(rows[1], m[1, 0, 0]) and np.array_equal(rows[-1], m[-1, -1, -1])
    else:
        raw = base64.b64decode(array.text)
        assert struct.unpack("<Q", raw[:8])[0] == len(raw) - 8 == m.size * int(data[-1])


def test_data_encoded_after_their_length_and_at_points(tmp_path):
    """As ParaView writes base64, with the length encoded alone; among other arrays."""
    m = unit_vectors((3, 2, 1))
    raw = np.float64(m.transpose(2, 1, 0, 3)).tobytes()
    text = base64.b64encode(struct.pack("<I", len(raw))).decode() + base64.b64encode(raw).decode()
    (tmp_path / "m.vti").write_text(f"""<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian">
<ImageData WholeExtent="1 3 0 1 0 0" Origin="0 0 0" Spacing="1 2 3"><Piece Extent="1 3 0 1 0 0">
<PointData Vectors="m"><DataArray type="Float64" Name="B" NumberOfComponents="3" format="ascii">1 2 3</DataArray>
<DataArray type="Float64" Name="e" format="ascii">1</DataArray>
<DataArray type="Float64" Name="m" NumberOfComponents="3" format="binary">{text}</DataArray></PointData>
</Piece></ImageData></VTKFile>""")
    field = co.spins.read_vtk(tmp_path / "m.vti")
    assert np.array_equal(field.values, m) and field.cell == (1, 2, 3)


def test_other_files_of_vtk_are_refused(tmp_path):
    good = in_the_manner_of_mumax(unit_vectors(), CELL, "ascii")
    for old, new, words in [
        ("StructuredGrid", "UnstructuredGrid", "UnstructuredGrid"),
        ("VTKFile type", 'VTKFile compressor="vtkZLibDataCompressor" type', "compressed"),
        ('format="ascii"', 'format="appended"', "appended"),
        ('WholeExtent="0 3', 'WholeExtent="0 4', "vectors"),
        ('WholeExtent="0 3', 'WholeExtent="0 999999999', "at most"),
        ('WholeExtent="0 3', 'WholeExtent="3 0', "WholeExtent"),
        ('NumberOfComponents="3"', 'NumberOfComponents="1"', "three components"),
        ("0.0 0.0 0.0 ", "0.0 0.0 9e-8 ", "even mesh"),
        ("0.0 0.0 0.0 ", "0.0 0.0 nan ", "not finite"),
        ("0.0 0.0 0.0 ", "0.0 0.0 x ", "no number"),
        ('<?xml version="1.0"?>', "<!DOCTYPE a [<!ENTITY b 'c'>]>", "DOCTYPE"),
        ("</VTKFile>", "", "no XML"),
    ]:
        assert old in good
        (tmp_path / "m.vts").write_text(good.replace(old, new))
        with refused(ValueError, "m.vts", words):
            co.spins.read_vtk(tmp_path / "m.vts")


def test_other_image_data_is_refused(tmp_path):
    """Meshes along other axes or without lengths, numbers in an unknown order, and meshes of several parts."""
    co.spins.write_vtk(tmp_path / "good.vti", unit_vectors().ravel(), NODES, cell=CELL)
    good = (tmp_path / "good.vti").read_text()
    for old, new, words in [
        ("<ImageData ", '<ImageData Direction="0 1 0 1 0 0 0 0 1" ', "Direction"),
        ('Spacing="', 'Spacing="-', "Spacing"),
        ("LittleEndian", "MiddleEndian", "byte_order"),
        ('"UInt64"', '"Int64"', "header_type"),
        ("</Piece>", '</Piece><Piece Extent="0 4 0 3 0 2"></Piece>', "2 pieces"),
    ]:
        assert old in good
        (tmp_path / "m.vti").write_text(good.replace(old, new))
        with refused(ValueError, "m.vti", words):
            co.spins.read_vtk(tmp_path / "m.vti")


def test_damaged_files_of_vtk_are_read_or_refused(tmp_path):
    rng = np.random.default_rng(2)
    for form in ("ascii", "binary"):
        good = in_the_manner_of_mumax(unit_vectors(), CELL, form).encode()
        for _ in range(100):
            content = bytearray(good)
            for place in rng.integers(0, len(content), 2):
                content[place] = rng.integers(0, 256)
            (tmp_path / "m.vts").write_bytes(bytes(content))
            try:
                assert np.isfinite(co.spins.read_vtk(tmp_path / "m.vts").values).all()
            except ValueError as error:
                assert "m.vts" in str(error)
