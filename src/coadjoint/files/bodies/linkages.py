"""Links of a robot with their joints: mass properties of one link, or of all at given positions of the joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.errors import unknown_name
from coadjoint.files.bodies.poses import about_axis
from coadjoint.files.bodies.xml_elements import Element
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties, Pose, composed, identity_pose, placed, turned
from coadjoint.validation import read_number

Floats = npt.NDArray[np.float64]

UNITS = "kg, m"
"""Units of URDF and SDF by definition, and of MJCF by convention."""

TURNING, SLIDING, FIXED = "turning", "sliding", "fixed"
MOVING = (TURNING, SLIDING)
"""Kinds of joints that have a position; joints of another kind have the name of the format."""
UNLIMITED = (-np.inf, np.inf)
SLACK = 64 * UNIT_ROUNDOFF
"""Rounding of positions at limits, relative to these."""


class Link(NamedTuple):
    """A link: its pose at zero in the frame of the file, and its mass properties, which are read when needed."""

    shown: str
    pose: Pose
    read: Callable[[], MassProperties | None]
    """Return them in the frame of the link; None without mass."""


class Joint(NamedTuple):
    """A joint between two links: its anchor and axis at zero, in the frame of the file, and its position there."""

    kind: str
    parent: str
    child: str
    anchor: Floats
    axis: Floats
    zero: float = 0.0
    mimicked: tuple[str, float, float] | None = None
    """Joint that it follows, with factor and offset."""
    limits: tuple[float, float] = UNLIMITED

    def motion(self, position: float) -> Pose:
        """Return the motion from zero to a position, in the frame of the file at zero."""
        change = position - self.zero
        if self.kind == SLIDING:
            return Pose(np.eye(3), change * self.axis / np.sqrt((self.axis**2).sum()))
        R = about_axis(self.axis, change)
        return Pose(R, self.anchor - turned(R, self.anchor))


class Linkage(NamedTuple):
    """The links and the joints of a file."""

    file: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    frame: str
    """What the frame of the file is."""

    def properties(self, link: str | None, configuration: Mapping[str, float] | None) -> MassProperties:
        """Return the mass properties of a link in its frame, or of all links in the frame of the file."""
        if link is not None:
            if configuration is not None:
                raise ValueError(f"configuration does not change the link {short(link)} in its own frame; leave it out")
            return self._one(link)
        positions = self._positions({} if configuration is None else configuration)
        motions = self._motions(positions)
        found = [(name, one, one.read()) for name, one in self.links.items()]
        parts = [placed(own, motions[name] @ one.pose, one.shown) for name, one, own in found if own is not None]
        if not parts:
            raise ValueError(f"{self.file} has no link with a mass; give one an <inertial>")
        posed = f" at {short(dict(configuration), 60)}" if configuration else ""
        return composed(parts, f"{self.frame} of {self.file}{posed}")

    def _one(self, link: str) -> MassProperties:
        if not isinstance(link, str) or link not in self.links:
            raise unknown_name(f"link of {self.file}", link, self.links)
        found = self.links[link].read()
        if found is None:
            raise ValueError(f"{self.links[link].shown} has no mass; name a link with an <inertial>")
        return found

    def _positions(self, configuration: Mapping[str, float]) -> dict[str, float]:
        """Return the position of each joint that moves."""
        if not isinstance(configuration, Mapping):
            raise TypeError(f"configuration is {short(configuration)}; give positions by the names of joints")
        given: dict[str, float] = {}
        for name, value in configuration.items():
            if not isinstance(name, str) or name not in self.joints:
                raise unknown_name(f"joint of {self.file}", name, self.joints or ["(none)"])
            joint = self.joints[name]
            if joint.kind not in MOVING:
                raise ValueError(
                    f"configuration has the joint {short(name)} of {self.file}, which is {joint.kind}; joints that "
                    "turn about one axis or slide along it have a position"
                )
            if joint.mimicked is not None:
                raise ValueError(
                    f"configuration has the joint {short(name)} of {self.file}, which mimics "
                    f"{short(joint.mimicked[0])}; give that one"
                )
            given[name] = read_number(value, f"configuration[{short(name)}]")
        positions = {name: given.get(name, joint.zero) for name, joint in self.joints.items()}
        for name, joint in self.joints.items():
            if joint.mimicked is not None and joint.kind in MOVING:
                other, factor, offset = joint.mimicked
                if other not in self.joints or self.joints[other].mimicked is not None:
                    raise ValueError(f"{self.file}: the joint {short(name)} mimics {short(other)}, which does not move")
                positions[name] = factor * positions[other] + offset
        for name, joint in self.joints.items():
            leader = name if joint.mimicked is None else joint.mimicked[0]
            if leader in given and joint.kind in MOVING:  # positions by default are those of the file
                self._check_limits(name, leader, positions[name], given[leader])
        return positions

    def _check_limits(self, name: str, leader: str, position: float, given: float) -> None:
        """Raise ValueError for the position of a joint, that of `leader` or of one that follows it, beyond limits."""
        lower, upper = self.joints[name].limits
        if not lower - SLACK * abs(lower) <= position <= upper + SLACK * abs(upper):
            unit = "m" if self.joints[name].kind == SLIDING else "radians"
            put = f", which puts the joint {short(name)} at {position:.10g}," if name != leader else ""
            raise ValueError(
                f"configuration[{short(leader)}] is {given:.10g}{put} and {self.file} limits this joint to "
                f"{lower:.10g} to {upper:.10g} {unit}; give a position within, or correct the limits in the file"
            )

    def _motions(self, positions: Mapping[str, float]) -> dict[str, Pose]:
        """Return the motion of each link from zero, in the frame of the file."""
        if all(positions[name] == joint.zero for name, joint in self.joints.items()):
            return dict.fromkeys(self.links, identity_pose())
        above: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            above.setdefault(joint.child, []).append(name)
        motions: dict[str, Pose] = {}
        for link in self.links:
            chain = [link]
            while chain[-1] not in motions and chain[-1] in above:
                parents = {self.joints[name].parent for name in above[chain[-1]]}
                if len(parents) > 1 or len(chain) > len(self.joints):
                    raise ValueError(
                        f"{self.file}: the link {short(chain[-1])} is in a closed loop of joints, whose positions "
                        "depend on each other; name a link, or leave configuration out"
                    )
                chain += parents
            motion = motions.setdefault(chain[-1], identity_pose())
            for name in reversed(chain[:-1]):
                for key in above[name]:
                    if positions[key] != self.joints[key].zero:
                        motion = motion @ self.joints[key].motion(positions[key])
                motions[name] = motion
        return motions


Shapes = Sequence[tuple[Floats, float]]
"""Centre and radius of a ball about each shape of a link, in its frame."""


def link_properties(
    element: Element, name: str, mass: float, tensor: Any, pose: Pose, shapes: Shapes | None
) -> MassProperties | None:
    """Return the mass properties of an <inertial> in the frame of its link; None if mass and inertia are zero."""
    # `pose` is that of the axes of the tensor, whose origin is the centre of mass; `shapes` is None if one is unknown.
    if mass == 0.0 and not np.any(tensor):
        return None
    if mass <= 0.0:
        element.refuse(f"has the mass {mass:g}; a body with inertia has a positive mass")
    frame = f"{name} of {element.file}, line {element.line}"
    reach = max((float(np.linalg.norm(at - pose.position)) + radius for at, radius in shapes or ()), default=0.0)
    own = MassProperties(mass, tensor, frame=frame, units=UNITS, radius=reach if reach > 0.0 else None)
    return placed(own, pose, frame)
