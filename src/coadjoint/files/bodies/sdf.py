"""SDF: links of models, nested models, and poses relative to other elements (SI units)."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
from coadjoint.files.bodies.urdf import ENTRIES, tensor_of
from coadjoint.files.bodies.xml_elements import Element
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties, Pose, identity_pose, turned

Floats = npt.NDArray[np.float64]

KINDS = {"revolute": TURNING, "continuous": TURNING, "prismatic": SLIDING, "fixed": FIXED}
OTHER_KINDS = ("ball", "universal", "revolute2", "screw", "gearbox")
MODEL = "__model__"
INFINITE = {"inf": math.inf, "+inf": math.inf, "-inf": -math.inf}
OLD_AXES = (1, 4)
"""Last version of SDF whose axes of joints are in the frame of the model."""


def linkage_of_sdf(root: Element, link: str | None) -> tuple[Linkage, str | None]:
    """Return the links and joints of the model of a file, and the link in it, without the model in its name."""
    models: dict[str, Element] = {}
    for name, model in _models(root):
        if name in models:
            model.refuse(f"has the name of line {models[name].line}; give each its own")
        models[name] = model
    if not models:
        root.refuse("has no <model>")
    if len(models) == 1:
        return _linkage(next(iter(models.values())), root), link
    name, _, inner = (link or "").partition("::")
    if name not in models:
        raise ValueError(
            f"{root.file} has {len(models)} models, {', '.join(short(one, 40) for one in list(models)[:8])}; name one, "
            "with link=MODEL, or one of its links, with link=MODEL::LINK"
        )
    return _linkage(models[name], root), inner or None


def _models(root: Element) -> Iterator[tuple[str, Element]]:
    for place in (root, *root.all("world")):
        for include in place.all("include"):
            include.refuse("is another file; write its model here, as `gz sdf -p` prints it")
        for model in place.all("model"):
            yield model.attribute("name"), model


class _Scope:
    """The elements of a model by their names, those of nested models as model::name, and their poses in its frame."""

    def __init__(self, model: Element) -> None:
        self.model = model
        self.elements: dict[str, tuple[Element, str]] = {}
        self._add(model, "")
        self.poses = {"": identity_pose()}

    def _add(self, model: Element, prefix: str) -> None:
        for element in model.children:
            if element.tag == "include":
                element.refuse("is another file; write its model here, as `gz sdf -p` prints it")
            if element.tag in ("link", "joint", "frame", "model"):
                name = prefix + element.attribute("name")
                if name in self.elements:
                    element.refuse(f"has the name of line {self.elements[name][0].line}; give each its own")
                self.elements[name] = element, prefix
                if element.tag == "model":
                    if "placement_frame" in element.attributes:
                        element.refuse("has a placement_frame, which is not read; give the pose of the model")
                    self._add(element, f"{name}::")

    def named(self, *tags: str) -> dict[str, tuple[Element, str]]:
        """Return the elements with these tags by name, each with the prefix of its model."""
        return {name: found for name, found in self.elements.items() if found[0].tag in tags}

    def pose(self, name: str) -> Pose:
        """Return the pose of an element in the frame of the outer model, whose name is empty."""
        chain: dict[str, None] = {}
        while name not in self.poses:
            if name in chain:
                self.elements[name][0].refuse("has a pose relative to itself")
            chain[name] = None
            name = self._parent(*self.elements[name])
        pose = self.poses[name]
        for name in reversed(chain):
            pose = self.poses[name] = pose @ pose_of(self.elements[name][0].one("pose"))
        return pose

    def _parent(self, element: Element, prefix: str) -> str:
        """Return the element to which the pose of another one is relative; empty for the outer model."""
        pose, model = element.one("pose"), prefix.removesuffix("::")
        relative = "" if pose is None else pose.attributes.get("relative_to", "")
        if not relative and element.tag == "frame":
            relative = element.attributes.get("attached_to", "")
        if not relative and element.tag == "joint":
            relative = child_of(element)
        return model if relative in ("", MODEL) else self.resolved(relative, prefix, element)

    def resolved(self, name: str, prefix: str, element: Element) -> str:
        """Return the full name of an element that another one of a model names."""
        if prefix + name not in self.elements:
            element.refuse(f"refers to {short(name, 60)}, which is not in its model")
        return prefix + name


def child_of(joint: Element) -> str:
    """Return the link that a joint moves, or the frame on it."""
    return joint.needed("child").text.strip()


def pose_of(pose: Element | None) -> Pose:
    """Return a <pose>: a position, and roll, pitch and yaw about fixed axes, or a quaternion x, y, z, w."""
    if pose is None:
        return identity_pose()
    if pose.attributes.get("frame"):
        pose.refuse("has the attribute frame of SDF 1.6; give relative_to")
    if not pose.text.strip():
        return identity_pose()
    written = pose.attributes.get("rotation_format", "euler_rpy")
    if written == "quat_xyzw":
        *position, x, y, z, w = pose.content(7)
        rotation = by_quaternion(w, x, y, z)
        return (
            pose.refuse("has a quaternion of length zero") if rotation is None else Pose(rotation, np.array(position))
        )
    if written != "euler_rpy":
        pose.refuse(f"has the rotation_format {short(written, 40)}; there are euler_rpy and quat_xyzw")
    numbers = pose.content(6)
    angles = [math.radians(value) if pose.flag("degrees") else value for value in numbers[3:]]
    return Pose(by_roll_pitch_yaw(angles), np.array(numbers[:3]))


def _linkage(model: Element, root: Element) -> Linkage:
    scope = _Scope(model)
    links = {}
    for name, (link, _) in scope.named("link").items():
        called = f"link {short(name, 60)}"
        links[name] = Link(f"{called} of {root.file}", scope.pose(name), partial(_inertial, link, called))
    version = tuple(int(part) if part.isdigit() else 0 for part in root.attributes.get("version", "1.0").split("."))
    joints = {name: _joint(scope, name, version) for name in scope.named("joint")}
    return Linkage(root.file, links, joints, f"frame of the model {short(model.attribute('name'), 60)}")


def _inertial(link: Element, name: str) -> MassProperties | None:
    inertial = link.one("inertial")
    if inertial is None:
        return link.refuse("has no <inertial>, and SDF then takes 1 kg and 1 kg m^2; write it")
    if inertial.flag("auto"):
        inertial.refuse('has auto="true", which needs the shapes of the simulator; write its mass and inertia')
    added = inertial.one("fluid_added_mass")
    if added is not None:
        added.refuse("is inertia of the fluid around the body, and no mass of it; remove it, see kirchhoff_body")
    pose = inertial.one("pose")
    if pose is not None and pose.attributes.get("relative_to"):
        pose.refuse("has relative_to, and the pose of an inertial is relative to its link")
    inertia = inertial.one("inertia")
    if inertia is None or inertial.one("mass") is None:
        return inertial.refuse("has no <mass> or no <inertia>, and SDF then takes 1 kg and 1 kg m^2; write both")
    entries = {}
    for key in ENTRIES:
        entry = inertia.one(key)
        if entry is None and key[1] == key[2]:
            inertia.refuse(f"has no <{key}>, and SDF then takes 1 kg m^2; write it")
        entries[key] = 0.0 if entry is None else entry.content(1)[0]
    (mass,) = inertial.needed("mass").content(1)
    return link_properties(inertial, name, mass, tensor_of(entries), pose_of(pose), _shapes(link))


def _shapes(link: Element) -> Shapes | None:
    """Return centre and radius of a ball about each shape of a link; None if one is not known."""
    found: list[tuple[Floats, float]] = []
    for element in link.all("collision", "visual"):
        pose, geometry = element.one("pose"), element.one("geometry")
        for shape in geometry.children if geometry is not None else ():
            numbers = {child.tag: child for child in shape.children}
            if shape.tag == "empty":
                continue
            if pose is not None and pose.attributes.get("relative_to"):
                return None
            if shape.tag == "box" and "size" in numbers:
                radius = 0.5 * math.hypot(*numbers["size"].content(3))
            elif shape.tag == "ellipsoid" and "radii" in numbers:
                radius = max(numbers["radii"].content(3))
            elif shape.tag == "sphere" and "radius" in numbers:
                (radius,) = numbers["radius"].content(1)
            elif shape.tag in ("cylinder", "capsule", "cone") and {"radius", "length"} <= numbers.keys():
                ((around,), (length,)) = (numbers[key].content(1) for key in ("radius", "length"))
                radius = around + 0.5 * length if shape.tag == "capsule" else math.hypot(around, 0.5 * length)
            else:
                return None
            found.append((pose_of(pose).position, radius))
    return found


def _joint(scope: _Scope, name: str, version: tuple[int, ...]) -> Joint:
    joint, prefix = scope.elements[name]
    kind = joint.attribute("type")
    if kind not in KINDS and kind not in OTHER_KINDS:
        joint.refuse(f"has the type {short(kind, 40)}; there are {', '.join((*KINDS, *OTHER_KINDS))}")
    parent = joint.needed("parent").text.strip()
    child = _link_of(scope, scope.resolved(child_of(joint), prefix, joint))
    above = "world" if parent == "world" else _link_of(scope, scope.resolved(parent, prefix, joint))
    pose, direction, followed, limits = scope.pose(name), np.array([0.0, 0.0, 1.0]), None, UNLIMITED
    axis = joint.one("axis")
    if KINDS.get(kind, FIXED) != FIXED and axis is not None:
        xyz, old = axis.one("xyz"), axis.one("use_parent_model_frame")
        in_model = old.text.strip() in ("true", "1") if old is not None else version[:2] <= OLD_AXES
        if xyz is not None:
            direction = np.array(xyz.content(3))
            expressed = xyz.attributes.get("expressed_in", "")
            if expressed or in_model:
                model = prefix.removesuffix("::")
                frame = model if expressed in ("", MODEL) else scope.resolved(expressed, prefix, xyz)
                direction = turned(pose.rotation.T, turned(scope.pose(frame).rotation, direction))
            if not direction.any():
                xyz.refuse("has an axis of length zero")
        followed = _followed(axis.one("mimic"), prefix)
        if kind != "continuous":
            limits = _limits(axis.one("limit"))
    return Joint(
        KINDS.get(kind, kind),
        above,
        child,
        pose.position,
        turned(pose.rotation, direction),
        mimicked=followed,
        limits=limits,
    )


def _limits(limit: Element | None) -> tuple[float, float]:
    """Return the lower and upper limit of an axis, which are infinite by default, and where the file says it."""
    entries = [None if limit is None else limit.one(key) for key in ("lower", "upper")]
    lower, upper = (
        default if entry is None else INFINITE.get(entry.text.strip().lower()) or entry.content(1)[0]
        for entry, default in zip(entries, UNLIMITED, strict=True)
    )
    return lower, upper


def _followed(mimic: Element | None, prefix: str) -> tuple[str, float, float] | None:
    """Return the joint that another one follows, with factor and offset."""
    if mimic is None:
        return None
    numbers = {}
    for key in ("multiplier", "offset", "reference"):
        entry = mimic.one(key)
        if entry is None:
            return mimic.refuse(f"has no <{key}>; write it")
        (numbers[key],) = entry.content(1)
    offset = numbers["offset"] - numbers["multiplier"] * numbers["reference"]
    return prefix + mimic.attribute("joint"), numbers["multiplier"], offset


def _link_of(scope: _Scope, name: str) -> str:
    """Return the link on which an element is fixed."""
    asked: list[str] = []
    while True:
        element, prefix = scope.elements[name]
        if element.tag == "link":
            return name
        asked.append(name)
        inner = element.attributes.get("attached_to", "") if element.tag == "frame" else ""
        if element.tag == "joint":
            inner = child_of(element)
        if inner in ("", MODEL) or prefix + inner in asked:
            return element.refuse("is joined, but not fixed on a link; give attached_to")
        name = scope.resolved(inner, prefix, element)
