"""Small robots in URDF, SDF and MJCF, by the conventions of their documentation, with what their links hold.

Each has its text, the arguments of `co.bodies.read`, and its parts: mass, position and axes of the centre of mass in
the frame that is asked for, and the tensor or the moments in these axes, which the reference adds up with SciPy.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation


class Part(NamedTuple):
    """A body: mass, centre, rotation of its axes, and tensor or moments in them."""

    mass: float
    centre: Any
    turn: Rotation
    inertia: Any


class Robot(NamedTuple):
    """A file with the arguments and the parts of one reading."""

    text: str
    parts: list[Part]
    arguments: Any = MappingProxyType({})


NONE = Rotation.identity()


def rpy(*angles: float, degrees: bool = False) -> Rotation:
    """Return roll, pitch and yaw about fixed axes."""
    return Rotation.from_euler("xyz", angles, degrees=degrees)


def tensor(xx, xy, xz, yy, yz, zz):
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def reference(parts: list[Part]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and tensor about it, from the tensor about the origin."""
    mass, first, about = 0.0, np.zeros(3), np.zeros((3, 3))
    for part in parts:
        c = np.asarray(part.centre, dtype=float)
        R = part.turn.as_matrix()
        inner = np.asarray(part.inertia, dtype=float)
        inner = np.diag(inner) if inner.ndim == 1 else inner
        mass, first = mass + part.mass, first + part.mass * c
        about += R @ inner @ R.T + part.mass * (c @ c * np.eye(3) - np.outer(c, c))
    c = first / mass
    return mass, c, about - mass * (c @ c * np.eye(3) - np.outer(c, c))


def link(name, mass, six, origin="", more=""):
    xx, xy, xz, yy, yz, zz = six
    return (
        f'<link name="{name}"><inertial>{origin}<mass value="{mass}"/><inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" '
        f'iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial>{more}</link>'
    )


BUS, ARM = (0.3, 0.01, -0.02, 0.4, 0.005, 0.5), (0.01, 0, 0, 0.04, 0, 0.045)


def joint(kind, place="", more="", name="j", parent="bus", child="arm"):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{place}{more}</joint>'


TWO = link("bus", 12, BUS, '<origin xyz="0.1 0 -0.2"/>'), link("arm", 2, ARM, '<origin xyz="0 0 0.5" rpy="0.3 0 0"/>')
ON_BUS = Part(12, (0.1, 0, -0.2), NONE, tensor(*BUS))


def arm_at(place, turn):
    """Return the arm whose link is at a place, turned, in the frame of the bus."""
    return Part(2, np.array(place) + turn.apply([0, 0, 0.5]), turn * rpy(0.3, 0, 0), tensor(*ARM))


AXIS = '<origin xyz="0 1 0" rpy="0 0 1.5"/>'
HINGE = rpy(0, 0, 1.5)
BENT = HINGE * Rotation.from_rotvec([0, 0.7, 0])
URDF = {
    "one link": Robot(
        f'<?xml version="1.0"?><robot name="sat">{link("bus", 12, BUS)}</robot>',
        [Part(12, (0, 0, 0), NONE, tensor(*BUS))],
    ),
    "turned axes of an inertial": Robot(
        f'<robot name="r">{link("a", 3, BUS, """<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 2.0"/>""")}</robot>',
        [Part(3, (0.1, 0.2, 0.3), rpy(0.4, -0.5, 2.0), tensor(*BUS))],
        {"link": "a"},
    ),
    "fixed joint": Robot(
        f'<robot name="r">{"".join(TWO)}{joint("fixed", AXIS)}</robot>', [ON_BUS, arm_at((0, 1, 0), HINGE)]
    ),
    "revolute joint": Robot(
        f'<robot name="r">{"".join(TWO)}{joint("revolute", AXIS, """<axis xyz="0 2 0"/><limit/>""")}</robot>',
        [ON_BUS, arm_at((0, 1, 0), HINGE * Rotation.from_rotvec([0, 0.7, 0]))],
        {"configuration": {"j": 0.7}},
    ),
    "slider": Robot(
        f'<robot name="r">{"".join(reversed(TWO))}{joint("prismatic", AXIS, """<axis xyz="1 0 0"/>""")}</robot>',
        [ON_BUS, arm_at(np.array([0, 1, 0]) + HINGE.apply([0.25, 0, 0]), HINGE)],
        {"configuration": {"j": 0.25}},
    ),
    "mimic": Robot(
        '<robot name="r">'
        + link("bus", 12, BUS, '<origin xyz="0.1 0 -0.2"/>')
        + link("finger", 1, ARM)
        + link("arm", 2, ARM, '<origin xyz="0 0 0.5" rpy="0.3 0 0"/>')
        + joint("revolute", more='<axis xyz="0 0 1"/>', name="led", child="finger")
        + joint("revolute", more='<axis xyz="0 0 1"/><mimic joint="led" multiplier="-2" offset="0.1"/>')
        + "</robot>",
        [
            ON_BUS,
            Part(1, (0, 0, 0), Rotation.from_rotvec([0, 0, 0.3]), tensor(*ARM)),
            arm_at((0, 0, 0), Rotation.from_rotvec([0, 0, -0.5])),
        ],
        {"configuration": {"led": 0.3}},
    ),
    "quaternions": Robot(
        '<robot name="r" version="1.1">'
        + link(
            "a",
            3,
            BUS,
            '<origin quat_xyzw="0 0 2 2" xyz="1 0 0"/>',
            '<collision><geometry><capsule radius="2" length="5"/></geometry></collision>',
        )
        + "</robot>",
        [Part(3, (1, 0, 0), rpy(0, 0, 90, degrees=True), tensor(*BUS))],
    ),
    "massless root": Robot(
        '<robot name="r"><!-- as KDL wants it --><material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>'
        f'<link name="bus"/>{TWO[1]}{joint("continuous", AXIS)}<gazebo reference="arm"><mu1>0.2</mu1></gazebo></robot>',
        [arm_at((0, 1, 0), HINGE * Rotation.from_rotvec([-1.2, 0, 0]))],
        {"configuration": {"j": -1.2}},
    ),
    "numbers on lines": Robot(
        '<robot name="r">\n'
        + link("a", "1.5e1", ("3E-1", "1e-2", "-.02", "+0.4", "5e-3", "0.5"), '<origin xyz="1\n 2\t3." rpy="0 0 0"/>')
        + "\n</robot>\n",
        [Part(15, (1, 2, 3), NONE, tensor(*BUS))],
    ),
    "chain of two joints": Robot(
        f'<robot name="r">{"".join(TWO)}{link("tip", 1, ARM)}'
        + joint("revolute", AXIS, '<axis xyz="0 1 0"/>')
        + joint("revolute", '<origin xyz="0 0 1"/>', '<axis xyz="1 0 0"/>', "k", "arm", "tip")
        + "</robot>",
        [
            ON_BUS,
            arm_at((0, 1, 0), BENT),
            Part(1, BENT.apply([0, 0, 1]) + [0, 1, 0], BENT * Rotation.from_rotvec([0.4, 0, 0]), tensor(*ARM)),
        ],
        {"configuration": {"k": 0.4, "j": 0.7}},
    ),
    "rod and sphere": Robot(
        '<robot name="r">'
        + link("bus", 1, (0.4, 0, 0, 0.4, 0, 0.4))
        + link("arm", 1, (0.0, 0, 0, 0.5, 0, 0.5))
        + joint("floating", '<origin xyz="0 0 3"/>')
        + "</robot>",
        [Part(1, (0, 0, 0), NONE, (0.4, 0.4, 0.4)), Part(1, (0, 0, 3), NONE, (0, 0.5, 0.5))],
    ),
}


def entity(name, mass, six, pose="", inertial_pose="", more=""):
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    entries = "".join(f"<{key}>{value}</{key}>" for key, value in zip(names, six, strict=True) if value is not None)
    return (
        f'<link name="{name}">{pose}<inertial>{inertial_pose}<mass>{mass}</mass><inertia>{entries}</inertia>'
        f"</inertial>{more}</link>"
    )


def sdf(inside, version="1.9"):
    return f'<?xml version="1.0"?>\n<sdf version="{version}">{inside}</sdf>'


def moving(kind, axis, place="", parent="bus"):
    return (
        f'<joint name="j" type="{kind}">{place}<parent>{parent}</parent><child>arm</child><axis>{axis}</axis></joint>'
    )


SDF_BUS = entity("bus", 12, BUS, inertial_pose="<pose>0.1 0 -0.2 0 0 0</pose>")
SDF_ARM = entity("arm", 2, ARM, "<pose>0 1 0 0 0 1.5</pose>", "<pose>0 0 0.5 0.3 0 0</pose>")
FOLLOWS = '<mimic joint="l"><multiplier>2</multiplier><offset>0.25</offset><reference>0.1</reference></mimic>'
SDF = {
    "one link": Robot(
        sdf(f'<model name="sat">{entity("bus", 12, BUS)}</model>'), [Part(12, (0, 0, 0), NONE, tensor(*BUS))]
    ),
    "turned axes of an inertial": Robot(
        sdf(
            '<model name="m">'
            + entity("a", 3, BUS, "<pose>5 5 5 1 1 1</pose>", "<pose>0.1 0.2 0.3 0.4 -0.5 2.0</pose>")
            + "</model>"
        ),
        [Part(3, (0.1, 0.2, 0.3), rpy(0.4, -0.5, 2.0), tensor(*BUS))],
        {"link": "a"},
    ),
    "model in a world": Robot(
        sdf(
            '<world name="w"><gravity>0 0 -9.8</gravity><model name="m"><pose>9 9 9 1 0 0</pose>'
            f"{SDF_BUS}{SDF_ARM}</model></world>",
            "1.6",
        ),
        [ON_BUS, arm_at((0, 1, 0), HINGE)],
    ),
    "relative poses": Robot(
        sdf(
            '<model name="m">'
            + entity("bus", 12, BUS, '<pose relative_to="arm">0 0 2 0 0 0</pose>', "<pose>0.1 0 -0.2 0 0 0</pose>")
            + SDF_ARM
            + "</model>"
        ),
        [Part(12, HINGE.apply([0.1, 0, 1.8]) + [0, 1, 0], HINGE, tensor(*BUS)), arm_at((0, 1, 0), HINGE)],
    ),
    "frames": Robot(
        sdf(
            '<model name="m"><frame name="f" attached_to="bus"><pose>0 0 1 0 0 1.5</pose></frame>'
            '<frame name="g"><pose relative_to="f">1 0 0 0 0 0</pose></frame>'
            + SDF_BUS
            + SDF_ARM.replace("<pose>0 1 0 0 0 1.5</pose>", '<pose relative_to="g"/>')
            + "</model>"
        ),
        [ON_BUS, arm_at(HINGE.apply([1, 0, 0]) + [0, 0, 1], HINGE)],
    ),
    "nested models": Robot(
        sdf(f'<model name="m">{SDF_BUS}<model name="inner"><pose>0 0 3 0.5 0 0</pose>{SDF_ARM}</model></model>'),
        [ON_BUS, arm_at(rpy(0.5, 0, 0).apply([0, 1, 0]) + [0, 0, 3], rpy(0.5, 0, 0) * HINGE)],
    ),
    "quaternions and degrees": Robot(
        sdf(
            '<model name="m">'
            + entity(
                "a",
                3,
                BUS,
                '<pose rotation_format="quat_xyzw">1 0 0  0 0 2 2</pose>',
                '<pose degrees="true">0 0 1 0 90 0</pose>',
            )
            + "</model>"
        ),
        [Part(3, (1, 0, 1), rpy(0, 0, 90, degrees=True) * rpy(0, 90, 0, degrees=True), tensor(*BUS))],
    ),
    "axis of the model": Robot(
        sdf(
            f'<model name="m">{SDF_BUS}{SDF_ARM}'
            + moving("revolute", '<xyz expressed_in="__model__">0 2 0</xyz>')
            + "</model>"
        ),
        [ON_BUS, arm_at((0, 1, 0), Rotation.from_rotvec([0, 0.7, 0]) * HINGE)],
        {"configuration": {"j": 0.7}},
    ),
    "axis of the model, by default in SDF 1.4": Robot(
        sdf(f'<model name="m">{SDF_BUS}{SDF_ARM}{moving("revolute", "<xyz>0 2 0</xyz>")}</model>', "1.4"),
        [ON_BUS, arm_at((0, 1, 0), Rotation.from_rotvec([0, 0.7, 0]) * HINGE)],
        {"configuration": {"j": 0.7}},
    ),
    "mimic with a reference": Robot(
        sdf(
            f'<model name="m">{SDF_BUS}{SDF_ARM}{entity("led", 1, ARM)}'
            + moving("revolute", "<xyz>0 0 1</xyz>").replace('"j"', '"l"').replace("arm", "led")
            + moving("revolute", f"<xyz>0 0 1</xyz>{FOLLOWS}")
            + "</model>",
            "1.11",
        ),
        [
            ON_BUS,
            arm_at((0, 1, 0), rpy(0, 0, 1.5 + 2 * (0.3 - 0.1) + 0.25)),
            Part(1, (0, 0, 0), rpy(0, 0, 0.3), tensor(*ARM)),
        ],
        {"configuration": {"l": 0.3}},
    ),
    "joint with a pose": Robot(
        sdf(
            f'<model name="m">{SDF_BUS}{SDF_ARM}'
            + moving("prismatic", "<xyz>1 0 0</xyz>", "<pose>3 0 0 0 0 1.0</pose>")
            + "</model>"
        ),
        [ON_BUS, arm_at(np.array([0, 1, 0]) + rpy(0, 0, 2.5).apply([0.25, 0, 0]), HINGE)],
        {"configuration": {"j": 0.25}},
    ),
    "two models, no products": Robot(
        sdf(
            f'<model name="one">{SDF_BUS}</model><model name="two">'
            f"{entity('a', 1, (0.1, None, None, 0.2, None, 0.25))}</model>"
        ),
        [Part(1, (0, 0, 0), NONE, (0.1, 0.2, 0.25))],
        {"link": "two::a"},
    ),
}


def mjcf(inside, before=""):
    return f'<mujoco model="m">{before}<worldbody><light pos="0 0 3"/>{inside}</worldbody></mujoco>'


MOMENTS = (0.3, 0.4, 0.5)
PLAIN = 'mass="3" diaginertia="0.3 0.4 0.5"'
MJCF = {
    "diaginertia": Robot(
        mjcf(f'<body name="a" pos="1 2 3"><freejoint/><inertial pos="0.1 0 0" {PLAIN}/></body>'),
        [Part(3, (1.1, 2, 3), NONE, MOMENTS)],
    ),
    "fullinertia": Robot(
        mjcf(
            '<body name="a" pos="1 2 3"><inertial pos="0 0 0" mass="3" fullinertia="0.3 0.4 0.5 0.01 -0.02'
            ' 0.005"/></body>'
        ),
        [Part(3, (0, 0, 0), NONE, tensor(*BUS))],
        {"link": "a"},
    ),
    "quat": Robot(
        mjcf(f'<body name="a" pos="1 0 0" quat="2 2 0 0"><inertial pos="0 1 0" quat="1 0 1 0" {PLAIN}/></body>'),
        [Part(3, (1, 0, 1), rpy(90, 0, 0, degrees=True) * rpy(0, 90, 0, degrees=True), MOMENTS)],
    ),
    "nested, euler in degrees": Robot(
        mjcf(
            f'<body name="a" pos="0 0 1" euler="30 40 0"><inertial pos="0 0 0" {PLAIN}/>'
            f'<body name="b" pos="1 0 0" euler="0 0 90"><inertial pos="0 1 0" {PLAIN}/></body></body>'
        ),
        [
            Part(3, (0, 0, 1), Rotation.from_euler("XYZ", (30, 40, 0), degrees=True), MOMENTS),
            Part(
                3,
                [0, 0, 1] + Rotation.from_euler("XYZ", (30, 40, 0), degrees=True).apply([0, 0, 0]),
                Rotation.from_euler("XYZ", (30, 40, 90), degrees=True),
                MOMENTS,
            ),
        ],
    ),
    "radians, fixed axes": Robot(
        mjcf(
            f'<body name="a" euler="0.3 0.4 0.5"><inertial pos="0 0 1" {PLAIN}/></body>',
            '<compiler angle="radian" eulerseq="ZYX"/>',
        ),
        [
            Part(
                3,
                Rotation.from_euler("zyx", (0.3, 0.4, 0.5)).apply([0, 0, 1]),
                Rotation.from_euler("zyx", (0.3, 0.4, 0.5)),
                MOMENTS,
            )
        ],
    ),
    "axisangle": Robot(
        mjcf(f'<body name="a" axisangle="0 0 3 90"><inertial pos="1 0 0" axisangle="1 1 1 120" {PLAIN}/></body>'),
        [
            Part(
                3,
                (0, 1, 0),
                rpy(0, 0, 90, degrees=True) * Rotation.from_rotvec(120 * np.ones(3) / np.sqrt(3), degrees=True),
                MOMENTS,
            )
        ],
    ),
    "xyaxes and zaxis": Robot(
        mjcf(
            f'<body name="a" xyaxes="0 2 0 -1 3 0"><inertial pos="1 0 0" {PLAIN}/></body>'
            f'<body name="b" zaxis="0 -1 0"><inertial pos="0 0 2" {PLAIN}/></body>'
        ),
        [
            Part(3, (0, 1, 0), rpy(0, 0, 90, degrees=True), MOMENTS),
            Part(3, (0, -2, 0), rpy(90, 0, 0, degrees=True), MOMENTS),
        ],
    ),
    "include": Robot(mjcf('<include file="part.xml"/>'), [Part(3, (1, 2, 3), NONE, MOMENTS)]),
    "massless body": Robot(
        mjcf(f'<body name="a" pos="1 0 0"><body name="b" pos="1 0 0"><inertial pos="1 0 0" {PLAIN}/></body></body>'),
        [Part(3, (3, 0, 0), NONE, MOMENTS)],
    ),
    "two bodies without names": Robot(
        mjcf(
            f'<body pos="1 0 0"><inertial pos="0 0 0" {PLAIN}/></body><body pos="0 1 0">'
            f'<inertial pos="0 0 0" {PLAIN}/></body>'
        ),
        [Part(3, (1, 0, 0), NONE, MOMENTS), Part(3, (0, 1, 0), NONE, MOMENTS)],
    ),
}
PART_OF_MJCF = f'<mujoco><body name="a" pos="1 2 3"><inertial pos="0 0 0" {PLAIN}/></body></mujoco>'

CUBE = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)
BALL = 4 / 3 * np.pi * 0.5**3
BY_MUJOCO = {
    "default classes": Robot(
        mjcf(
            '<body name="a" childclass="heavy"><geom type="sphere"/><body name="b" pos="0 0 2">'
            '<geom type="sphere" class="light"/>'
            "</body></body>",
            '<default><geom size="0.5"/><default class="heavy"><geom density="2"/><default class="light">'
            '<geom density="1"/>'
            "</default></default></default>",
        ),
        [
            Part(2 * BALL, (0, 0, 0), NONE, np.full(3, 0.4 * 2 * BALL * 0.25)),
            Part(BALL, (0, 0, 2), NONE, np.full(3, 0.1 * BALL)),
        ],
    ),
    "mesh": Robot(
        mjcf(
            '<body name="a" pos="0 0 5"><geom type="mesh" mesh="cube" mass="6"/></body>',
            '<compiler meshdir="parts"/><asset><mesh name="cube" file="cube.obj" scale="1 1 2"/>'
            '<texture name="t" type="2d" builtin="flat" width="8" height="8"/><material name="m" texture="t"/></asset>',
        ),
        [Part(6, (0, 0, 5), NONE, (10, 10, 4))],
    ),
    "frame and replicate": Robot(
        mjcf(
            '<frame pos="0 0 1" euler="0 0 90"><body name="a" pos="1 0 0">'
            '<geom type="box" size="0.5 0.5 0.5" mass="6"/></body></frame>'
            '<replicate count="2" offset="0 3 0"><body name="b">'
            '<geom type="sphere" size="0.5" mass="1" material="m"/></body>'
            "</replicate>"
        ),
        [
            Part(6, (0, 1, 1), NONE, np.ones(3)),
            Part(1, (0, 0, 0), NONE, np.full(3, 0.1)),
            Part(1, (0, 3, 0), NONE, np.full(3, 0.1)),
        ],
    ),
    "joints with a reference": Robot(
        mjcf(
            '<body name="a" pos="0 0 1"><joint name="h" axis="0 0 1" pos="1 0 0" ref="30"/>'
            '<joint name="s" type="slide" axis="0 2 0"/>'
            f'<inertial pos="0 0 0" {PLAIN}/></body>'
        ),
        [Part(3, rpy(0, 0, 60, degrees=True).apply([-1, 0.5, 0]) + [1, 0, 1], rpy(0, 0, 60, degrees=True), MOMENTS)],
        {"configuration": {"h": np.pi / 2, "s": 0.5}},
    ),
    "total mass and fused bodies": Robot(
        mjcf(
            '<body name="a"><freejoint/><geom type="sphere" size="0.5" pos="1 0 0"/><body name="b" pos="0 0 2">'
            '<geom type="sphere" '
            'size="0.5"/></body></body>',
            '<compiler settotalmass="4" fusestatic="true" alignfree="true"/>',
        ),
        [Part(2, (1, 0, 0), NONE, np.full(3, 0.2)), Part(2, (0, 0, 2), NONE, np.full(3, 0.2))],
    ),
}
