"""Mass properties of bodies from files, by the suffix of the file and the root of its XML."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from coadjoint.errors import nearest
from coadjoint.files.bodies.meshes import properties_of_mesh
from coadjoint.files.bodies.mjcf import linkage_of_mjcf
from coadjoint.files.bodies.sdf import linkage_of_sdf
from coadjoint.files.bodies.urdf import linkage_of_urdf
from coadjoint.files.bodies.xml_elements import Element, elements_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties
from coadjoint.validation import read_path

Robot = Callable[[Element, Path, str | None, Mapping[str, float] | None], MassProperties]


def _urdf(root: Element, path: Path, link: str | None, at: Mapping[str, float] | None) -> MassProperties:
    return linkage_of_urdf(root).properties(link, at)


def _sdf(root: Element, path: Path, link: str | None, at: Mapping[str, float] | None) -> MassProperties:
    linkage, inner = linkage_of_sdf(root, link)
    return linkage.properties(inner, at)


def _mjcf(root: Element, path: Path, link: str | None, at: Mapping[str, float] | None) -> MassProperties:
    return linkage_of_mjcf(root, path, bool(at)).properties(link, at)


ROBOTS: dict[str, Robot] = {"robot": _urdf, "sdf": _sdf, "mujoco": _mjcf}
"""Root of an XML file -> its reader."""
XML_SUFFIXES = (".urdf", ".sdf", ".world", ".xml", ".mjcf")
MESH_SUFFIXES = (".obj", ".stl", ".ply", ".gltf", ".glb")


@suggest_keywords
def read(
    path: str | Path,
    link: str | None = None,
    configuration: Mapping[str, float] | None = None,
    *,
    scale: float | None = None,
    mass: float | None = None,
    density: float | None = None,
) -> MassProperties:
    """Read the mass properties of a body from a file: a robot in URDF, SDF or MJCF, or a mesh in OBJ, STL, PLY or glTF.

    Choose it to begin with a file in place of an inertia that was typed: systems of bodies take what it returns. Of a
    robot it is one link, or all links as one rigid body with the joints at given positions. Of a mesh it is the
    homogeneous body inside its surface.

    Parameters
    ----------
    path : str or pathlib.Path
        The file: ``.urdf``, ``.sdf``, ``.world``, ``.mjcf`` or ``.xml``, by whose root element the format is known;
        ``.obj``, ``.stl``, ``.ply``, ``.gltf`` or ``.glb``.
    link : str, optional
        Name of a link, or of a body of MJCF. The frame is then that of the link. In a file of several SDF models it is
        the name of a model, or ``"model::link"``. By default all links together, in the frame of the root link (URDF),
        of the model (SDF) or of the world (MJCF).
    configuration : mapping, optional
        Positions of joints by name (radians, or metres of a sliding joint); others are at zero, or of MJCF at their
        reference. Only without `link`. A position
        beyond the limits of its joint is refused, unless the joint is continuous.
    scale : float, optional
        Length of the unit of a mesh, such as 0.001 for millimetres and results in metres. Needed for OBJ, STL and PLY,
        which have no unit; glTF is in metres.
    mass : float, optional
        Mass of a mesh. Either this or `density` is needed.
    density : float, optional
        Mass per volume of a mesh, in units of the scaled length: with results in metres, kg/m^3 for kg.

    Returns
    -------
    MassProperties
        ``mass``, ``centre_of_mass``, ``inertia`` about it, ``moments``, ``axes``, ``frame`` and ``units``. The
        off-diagonal entries of ``inertia`` are minus the products of inertia, ``inertia[0, 1] = -integral of x y dm``,
        as in the three formats of robots. A mesh has the third and fourth moments too.

    Raises
    ------
    OSError
        The file cannot be read.
    TypeError, ValueError
        Unknown names, or a file that is refused, with its name, line and element: XML with a document type, numbers
        that are none, zero mass, a tensor that no body has, elements that simulators complete by themselves; a surface
        that is open, turned inside out or inside another one; positions beyond the limits of joints; arguments that
        belong to another format.
    MissingPackageError
        A mesh without ``trimesh``.

    Warns
    -----
    UserWarning
        A moment is larger than the shapes of its link allow, such as one in other units.

    Notes
    -----
    XML is read without entities and without network, and files that a model names are read from beside it. With
    ``mujoco`` installed MJCF is compiled by it: default classes, masses of shapes and meshes. Without it bodies with
    an ``<inertial>`` are read, at the reference positions of joints. The integrals over meshes are exact to rounding.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import coadjoint as co
    >>> file = pathlib.Path(tempfile.mkdtemp(), "sat.urdf")
    >>> _ = file.write_text('''<robot name="sat"><link name="bus"><inertial><mass value="12"/>
    ... <inertia ixx="0.3" ixy="0.01" ixz="0" iyy="0.4" iyz="0" izz="0.5"/></inertial></link></robot>''')
    >>> bus = co.bodies.read(file)
    >>> bus.mass, bus.moments.round(6).tolist()
    (12.0, [0.29901, 0.40099, 0.5])
    >>> sat = co.systems.body(bus)
    """
    file = read_path(path, "path")
    suffix = file.suffix.lower()
    if suffix in MESH_SUFFIXES:
        if link is not None or configuration is not None:
            name = "link" if link is not None else "configuration"
            raise ValueError(f"{name} was given for {file}, a mesh, which has no links; leave it out")
        return properties_of_mesh(file, scale, mass, density)
    if suffix not in XML_SUFFIXES:
        known = (*XML_SUFFIXES, *MESH_SUFFIXES)
        near = nearest(suffix, known)
        hint = f"did you mean {near}?" if near else f"give one of {', '.join(known)}"
        if suffix == ".xacro":
            hint = "expand it first, with: xacro FILE > FILE.urdf"
        raise ValueError(
            f"{short(str(file), 160)} has the suffix {short(suffix, 20)}, which names no format of bodies; {hint}"
        )
    for name, value in (("scale", scale), ("mass", mass), ("density", density)):
        if value is not None:
            raise ValueError(f"{name} was given for {file}, which has masses and units of its own; leave it out")
    root = elements_of(file)
    if root.tag not in ROBOTS:
        root.refuse(f"is no root of a robot; there are {', '.join(f'<{tag}>' for tag in ROBOTS)}")
    return ROBOTS[root.tag](root, file, link, configuration)
