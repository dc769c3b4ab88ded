"""URDF: links with inertials, and joints between them (SI units)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
import numpy.typing as npt

from coadjoint.files.bodies.linkages import (
    FIXED,
    SLIDING,
    TURNING,
    UNLIMITED,
    Joint,
    Link,
    Linkage,
    Shapes,
    link_properties,
)
from coadjoint.files.bodies.poses import by_quaternion, by_roll_pitch_yaw
from coadjoint.files.bodies.xml_elements import Element
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties, Pose, identity_pose, turned

Floats = npt.NDArray[np.float64]

ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
KINDS = {
    "revolute": TURNING,
    "continuous": TURNING,
    "prismatic": SLIDING,
    "fixed": FIXED,
    "floating": "floating",
    "planar": "planar",
}


def linkage_of_urdf(root: Element) -> Linkage:
    """Return the links and joints of a <robot>."""
    for child in root.children:
        if ":" in child.tag and child.tag.startswith("xacro"):
            child.refuse("belongs to xacro; expand the file first, with: xacro FILE > FILE.urdf")
    links = _named(root, "link")
    joints = _named(root, "joint")
    if not links:
        root.refuse("has no <link>")
    poses = _poses(root, links, joints)
    found = {}
    for name, link in links.items():
        called = f"link {short(name, 60)}"
        found[name] = Link(f"{called} of {root.file}", poses[name], partial(_inertial, link, called))
    moving = {name: _joint(joint, poses[joint.needed("child").attribute("link")]) for name, joint in joints.items()}
    return Linkage(root.file, found, moving, f"frame of the link {short(_root(root, links, joints), 60)}")


def _named(root: Element, tag: str) -> dict[str, Element]:
    """Return the elements with a tag by their names, which differ."""
    found: dict[str, Element] = {}
    for element in root.all(tag):
        name = element.attribute("name")
        if name in found:
            element.refuse(f"has the name of line {found[name].line}; give each its own")
        found[name] = element
    return found


def _root(root: Element, links: dict[str, Element], joints: dict[str, Element]) -> str:
    """Return the link that is no child of a joint; ValueError unless there is one."""
    children = {joint.needed("child").attribute("link") for joint in joints.values()}
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        root.refuse(f"has {len(roots)} links that are no child of a joint; a robot has one, its root")
    return roots[0]


def _poses(root: Element, links: dict[str, Element], joints: dict[str, Element]) -> dict[str, Pose]:
    """Return the pose of each link at zero in the frame of the root link."""
    below: dict[str, list[tuple[str, Pose]]] = {}
    for joint in joints.values():
        parent, child = (joint.needed(tag).attribute("link") for tag in ("parent", "child"))
        for name in (parent, child):
            if name not in links:
                joint.refuse(f"joins the link {short(name, 60)}, which is not in the file")
        below.setdefault(parent, []).append((child, _origin(joint.one("origin"))))
    first = _root(root, links, joints)
    poses, pending = {first: identity_pose()}, [first]
    while pending:
        name = pending.pop()
        for child, pose in below.get(name, ()):
            if child in poses:
                links[child].refuse("is the child of several joints; a link of URDF has one")
            poses[child] = poses[name] @ pose
            pending.append(child)
    loose = [name for name in links if name not in poses]
    if loose:
        links[loose[0]].refuse("is in a closed loop of joints; URDF has trees only")
    return poses


def _origin(origin: Element | None) -> Pose:
    """Return the pose of an <origin>, by xyz and rpy (fixed axes) or quat_xyzw."""
    if origin is None:
        return identity_pose()
    position = np.array(origin.numbers("xyz", 3, (0.0, 0.0, 0.0)))
    if "quat_xyzw" not in origin.attributes:
        return Pose(by_roll_pitch_yaw(origin.numbers("rpy", 3, (0.0, 0.0, 0.0))), position)
    if "rpy" in origin.attributes:
        origin.refuse("has rpy and quat_xyzw; give one of them")
    x, y, z, w = origin.numbers("quat_xyzw", 4)
    rotation = by_quaternion(w, x, y, z)
    return origin.refuse("has a quaternion of length zero") if rotation is None else Pose(rotation, position)


def tensor_of(entries: Mapping[str, float]) -> list[list[float]]:
    """Return the tensor of six numbers by the names of URDF and SDF."""
    xx, xy, xz, yy, yz, zz = (entries[name] for name in ENTRIES)
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def _inertial(link: Element, name: str) -> MassProperties | None:
    inertial = link.one("inertial")
    if inertial is None:
        return None
    inertia = inertial.needed("inertia")
    tensor = tensor_of({name: inertia.number(name) for name in ENTRIES})
    mass = inertial.needed("mass").number("value")
    return link_properties(inertial, name, mass, tensor, _origin(inertial.one("origin")), _shapes(link))


def _shapes(link: Element) -> Shapes | None:
    """Return centre and radius of a ball about each shape of a link; None if one is not known."""
    found: list[tuple[Floats, float]] = []
    for element in link.all("collision", "visual"):
        geometry = element.one("geometry")
        for shape in geometry.children if geometry is not None else ():
            if shape.tag == "box":
                radius = 0.5 * math.hypot(*shape.numbers("size", 3))
            elif shape.tag == "sphere":
                radius = shape.number("radius")
            elif shape.tag == "cylinder":
                radius = math.hypot(shape.number("radius"), 0.5 * shape.number("length"))
            elif shape.tag == "capsule":
                radius = shape.number("radius") + 0.5 * shape.number("length")
            else:  # a mesh, in a file that the robot's packages hold
                return None
            found.append((_origin(element.one("origin")).position, radius))
    return found


def _joint(joint: Element, pose: Pose) -> Joint:
    """Return a joint whose frame is that of its child."""
    kind = joint.attribute("type")
    if kind not in KINDS:
        joint.refuse(f"has the type {short(kind, 40)}; there are {', '.join(KINDS)}")
    axis = joint.one("axis")
    direction = np.array((1.0, 0.0, 0.0) if axis is None else axis.numbers("xyz", 3))
    if KINDS[kind] in (TURNING, SLIDING) and not direction.any():
        joint.refuse("has an axis of length zero")
    parent, child = (joint.needed(tag).attribute("link") for tag in ("parent", "child"))
    mimic = joint.one("mimic")
    followed = None
    if mimic is not None:
        followed = mimic.attribute("joint"), mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
    return Joint(
        KINDS[kind],
        parent,
        child,
        pose.position,
        turned(pose.rotation, direction),
        mimicked=followed,
        limits=UNLIMITED if kind == "continuous" else _limits(joint.one("limit")),
    )


def _limits(limit: Element | None) -> tuple[float, float]:
    """Return the lower and upper limit of a joint; where one is written the other is zero by default."""
    if limit is None or not {"lower", "upper"} & limit.attributes.keys():
        return UNLIMITED
    return limit.number("lower", 0.0), limit.number("upper", 0.0)
