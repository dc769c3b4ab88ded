"""MJCF: bodies with inertials, nested; by MuJoCo if it is installed, and otherwise those that are written in full."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coadjoint.files.bodies.compiled_mjcf import linkage_by_mujoco
from coadjoint.files.bodies.linkages import Link, Linkage, link_properties
from coadjoint.files.bodies.poses import about_axis, by_euler_angles, by_quaternion
from coadjoint.files.bodies.xml_elements import MAX_DEPTH, Element, elements_of
from coadjoint.optional_packages import EXTRAS, installed
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties, Pose, identity_pose

Floats = npt.NDArray[np.float64]

MAX_INCLUDES = 100
"""Largest number of files that one includes."""
COMPUTED = ("boundmass", "boundinertia", "settotalmass", "balanceinertia")
"""Attributes of <compiler> by which MuJoCo changes what is written."""
BY_MUJOCO = ("frame", "replicate", "attach", "composite", "flexcomp")
"""Elements of bodies that MuJoCo expands."""
ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


def linkage_of_mjcf(root: Element, path: Path, moving: bool) -> Linkage:
    """Return the bodies of a <mujoco>; its joints, if they are to be moved, are read by MuJoCo."""
    _include(root, path, {path.resolve()}, 1)
    if installed("mujoco"):
        return linkage_by_mujoco(root, path)
    if moving:
        root.refuse(f"is read at the positions of joints by {_hint()}")
    compiler = {key: value for element in root.all("compiler") for key, value in element.attributes.items()}
    for element in root.all("compiler"):
        for name in COMPUTED:
            if element.attributes.get(name, "false") not in ("false", "0", "-1"):
                element.refuse(f"has {name}, which {_hint()} applies")
        if element.attributes.get("inertiafromgeom", "auto") == "true":
            element.refuse(f"has inertiafromgeom, which {_hint()} applies")
    angle = 1.0 if compiler.get("angle", "degree") == "radian" else math.pi / 180.0
    links: dict[str, Link] = {}
    pending = [(world, identity_pose()) for world in reversed(root.all("worldbody"))]
    while pending:
        parent, pose = pending.pop()
        for element in parent.children:
            if element.tag in BY_MUJOCO:
                element.refuse(f"is expanded by {_hint()}")
        if parent.tag == "body":
            name = parent.attributes.get("name", f"body {len(links) + 1}")
            pose = pose @ _pose(parent, angle, compiler.get("eulerseq", "xyz"))
            if name in links:
                parent.refuse("has the name of another body; give each its own")
            called = f"body {short(name, 60)}"
            read = partial(_inertial, parent, called, angle, compiler.get("eulerseq", "xyz"))
            links[name] = Link(f"{called} of {root.file}", pose, read)
        pending += [(child, pose) for child in reversed(parent.all("body"))]
    if not links:
        root.refuse("has no <body>")
    return Linkage(root.file, links, {}, "frame of the world")


def _hint() -> str:
    return f'MuJoCo; install it with: pip install "coadjoint[{EXTRAS["mujoco"]}]", or save the model with its inertials'


def _inertial(body: Element, name: str, angle: float, sequence: str) -> MassProperties | None:
    inertial = body.one("inertial")
    if inertial is None:
        geoms = body.all("geom")
        return geoms[0].refuse(f"has a mass that is computed by {_hint()}") if geoms else None
    inertial.attribute("pos")
    pose = _pose(inertial, angle, sequence)
    if "fullinertia" in inertial.attributes:
        turned = [key for key in (*ORIENTATIONS, "diaginertia") if key in inertial.attributes]
        if turned:
            inertial.refuse(f"has fullinertia and {turned[0]}; give one of them")
        xx, yy, zz, xy, xz, yz = inertial.numbers("fullinertia", 6)
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        tensor = np.diag(inertial.numbers("diaginertia", 3))
    return link_properties(inertial, name, inertial.number("mass"), tensor, pose, None)


def _pose(element: Element, angle: float, sequence: str) -> Pose:
    """Return the pose of an element, by pos and one of the orientations of MJCF."""
    position = np.array(element.numbers("pos", 3, (0.0, 0.0, 0.0)))
    given = [key for key in ORIENTATIONS if key in element.attributes]
    if len(given) > 1:
        element.refuse(f"has {' and '.join(given)}; give one orientation")
    return Pose(_rotation(element, given[0], angle, sequence) if given else np.eye(3), position)


def _rotation(element: Element, kind: str, angle: float, sequence: str) -> Floats:
    rotation: Floats | None = None
    if kind == "quat":
        rotation = by_quaternion(*element.numbers(kind, 4))
    elif kind == "axisangle":
        *about, turn = element.numbers(kind, 4)
        rotation = about_axis(about, angle * turn) if any(about) else None
    elif kind == "euler":
        if len(sequence) != 3 or not set(sequence) <= set("xyzXYZ"):
            element.refuse(f"is turned by eulerseq={short(sequence, 20)}; it has three of the letters xyzXYZ")
        rotation = by_euler_angles([angle * value for value in element.numbers(kind, 3)], sequence)
    elif kind == "xyaxes":
        numbers = np.array(element.numbers(kind, 6))
        x, y = numbers[:3], numbers[3:]
        if x.any():
            x = x / np.linalg.norm(x)
            y = y - (x * y).sum() * x
            if y.any():
                y = y / np.linalg.norm(y)
                rotation = np.stack([x, y, np.cross(x, y)], axis=1)
    else:
        z = np.array(element.numbers(kind, 3))
        if z.any():
            z = z / np.linalg.norm(z)
            axis = np.cross((0.0, 0.0, 1.0), z)
            size = float(np.linalg.norm(axis))
            # Opposite to z every axis across it turns by half a turn; MuJoCo takes x.
            rotation = about_axis(axis if size else np.array((1.0, 0.0, 0.0)), math.atan2(size, float(z[2])))
    return element.refuse(f"has {kind} of length zero") if rotation is None else rotation


def _include(element: Element, main: Path, read: set[Path], depth: int) -> None:
    """Replace <include file=""/> by the children of the roots of files in the folder of the main one."""
    if depth > MAX_DEPTH:
        element.refuse(f"is nested deeper than {MAX_DEPTH}, with the files that are included")
    children: list[Element] = []
    for child in element.children:
        if child.tag != "include":
            _include(child, main, read, depth + 1)
            children.append(child)
            continue
        path = (main.parent / child.attribute("file")).resolve()
        if not path.is_relative_to(main.resolve().parent):
            child.refuse(f"includes {short(child.attribute('file'), 60)}, which is outside of the folder of the model")
        if path in read or len(read) > MAX_INCLUDES:
            child.refuse(f"includes {short(child.attribute('file'), 60)} again; a file is included once")
        read.add(path)
        try:
            root = elements_of(path)
        except OSError as error:
            child.refuse(f"includes {short(child.attribute('file'), 60)}, which cannot be read: {error}")
        _include(root, main, read, depth + 1)
        children += root.children
    element.children = children
