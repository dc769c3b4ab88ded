"""Bodies from URDF, SDF and MJCF: their mass properties against sums of their parts, and files that are refused."""

import importlib.util
import os
import pickle
import re

import numpy as np
import pytest
import robots
from robots import ARM, BUS, BY_MUJOCO, MJCF, SDF, URDF, entity, joint, link, mjcf, reference, sdf

import coadjoint as co
from refusals import refused

MUJOCO = importlib.util.find_spec("mujoco") is not None
SUFFIXES = {"URDF": ".urdf", "SDF": ".sdf", "MJCF": ".xml"}
FILES = [
    *(pytest.param("URDF", robot, id=f"URDF, {name}") for name, robot in URDF.items()),
    *(pytest.param("SDF", robot, id=f"SDF, {name}") for name, robot in SDF.items()),
    *(pytest.param("MJCF", robot, id=f"MJCF, {name}") for name, robot in MJCF.items()),
]
ROUNDING = 1e-14  # some tens of roundings of sums of few terms, relative to the largest


@pytest.fixture
def without_mujoco(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == "mujoco" else find(name, *more))


def written(folder, kind, robot):
    path = folder / f"robot{SUFFIXES[kind]}"
    path.write_text(robot.text, encoding="utf-8")
    (folder / "part.xml").write_text(robots.PART_OF_MJCF, encoding="utf-8")
    (folder / "parts").mkdir()
    (folder / "parts" / "cube.obj").write_text(robots.CUBE, encoding="utf-8")
    return path


def assert_reads(path, robot):
    found = co.bodies.read(path, **robot.arguments)
    mass, centre, inertia = reference(robot.parts)
    size = np.abs(inertia).max()
    assert found.mass == pytest.approx(mass, rel=ROUNDING)
    assert np.abs(found.centre_of_mass - centre).max() <= ROUNDING * (1 + np.abs(centre).max())
    # The sums of the reference are about the origin.
    assert np.abs(found.inertia - inertia).max() <= ROUNDING * (size + 10 * mass * (centre @ centre))
    assert np.array_equal(found.inertia, found.inertia.T)
    assert np.abs(found.axes @ np.diag(found.moments) @ found.axes.T - found.inertia).max() <= ROUNDING * size
    assert np.linalg.det(found.axes) == pytest.approx(1.0) and (np.diff(found.moments) >= 0).all()
    assert str(path) in found.frame and found.units == "kg, m"


@pytest.mark.thinned(1)
@pytest.mark.parametrize("kind, robot", FILES)
def test_robots_are_the_sum_of_their_links(tmp_path, without_mujoco, kind, robot):
    assert_reads(written(tmp_path, kind, robot), robot)


@pytest.mark.skipif(not MUJOCO, reason="mujoco is not installed")
@pytest.mark.filterwarnings("ignore:.*robot.xml. MuJoCo. .*settotalmass.*deprecated")
@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", [*MJCF, *BY_MUJOCO])
def test_models_of_mujoco_are_the_sum_of_their_bodies(tmp_path, monkeypatch, capfd, name):
    robot = {**MJCF, **BY_MUJOCO}[name]
    (tmp_path / "current").mkdir()
    monkeypatch.chdir(tmp_path / "current")
    assert_reads(written(tmp_path, "MJCF", robot), robot)
    # MuJoCo prints its warnings and writes them here, unless they are taken.
    assert [*(tmp_path / "current").iterdir()] == [] and capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", BY_MUJOCO)
def test_what_mujoco_computes_is_refused_without_it(tmp_path, without_mujoco, name):
    with refused(ValueError, "robot.xml, line 1", "MuJoCo", "coadjoint[mujoco]"):
        co.bodies.read(written(tmp_path, "MJCF", BY_MUJOCO[name]), **BY_MUJOCO[name].arguments)


def test_the_sign_of_products_is_that_of_the_tensor(tmp_path):
    """Two masses on the diagonal x = y: the integral of x y dm is positive, and the entry of the file negative."""
    path = tmp_path / "pair.urdf"
    path.write_text(f'<robot name="r">{link("a", 2, (2, -2, 0, 2, 0, 4))}</robot>')
    found = co.bodies.read(path)
    points = np.array([[1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
    assert found.inertia[0, 1] == -(points[:, 0] * points[:, 1]).sum() == -2.0
    assert np.abs(found.axes[:, 0]) == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0])
    assert found.moments == pytest.approx([0.0, 4.0, 4.0], abs=1e-15)
    assert "-integral of x y dm" in repr(found) and "-integral of x y dm" in found._repr_html_()


URDF_OF = '<robot name="r">{}</robot>'.format
MASSLESS = '<link name="b"/>'
REFUSED = {
    "doctype": (".urdf", '<!DOCTYPE robot [<!ENTITY a "1">]><robot name="&a;"/>', ["line 1", "DOCTYPE"]),
    "external entity": (".urdf", '<!DOCTYPE r SYSTEM "file:///etc/passwd">\n<robot name="r"/>', ["line 1", "DOCTYPE"]),
    "undefined entity": (".urdf", '<robot name="&a;"/>', ["no XML", "undefined entity"]),
    "no XML": (".sdf", "<sdf><model></sdf>", ["no XML", "mismatched"]),
    "empty": (".xml", "", ["no XML"]),
    "another root": (".xml", "<html/>", ["<html>", "<robot>", "<sdf>", "<mujoco>"]),
    "depth": (".xml", "<mujoco>" + "<body>" * 300 + "</body>" * 300 + "</mujoco>", ["nested deeper than 256"]),
    "xacro": (".urdf", URDF_OF('<xacro:arm xmlns:xacro="x" side="left"/>'), ["<xacro:arm>", "expand"]),
    "expression": (".urdf", URDF_OF(link("a", "${m}", BUS)), ["<mass>", "value=", "${m}", "xacro"]),
    "word": (".urdf", URDF_OF(link("a", "heavy", BUS)), ["line 1", "<mass>", "heavy", "1 finite number"]),
    "underscore": (".urdf", URDF_OF(link("a", "1_0", BUS)), ["<mass>", "1_0"]),
    "not a number": (".urdf", URDF_OF(link("a", "nan", BUS)), ["<mass>", "nan"]),
    "overflow": (".urdf", URDF_OF(link("a", "1e999", BUS)), ["<mass>", "1e999", "too large"]),
    "missing entry": (".urdf", URDF_OF(link("a", 1, BUS).replace("ixz", "izx")), ["<inertia>", "no attribute ixz"]),
    "no mass element": (".urdf", URDF_OF(link("a", 1, BUS).replace("mass", "weight")), ["<inertial>", "no <mass>"]),
    "zero mass": (".urdf", URDF_OF(link("a", 0, BUS)), ["<inertial>", "mass 0"]),
    "negative mass": (".urdf", URDF_OF(link("a", -2, BUS)), ["<inertial>", "mass -2"]),
    "no masses": (".urdf", URDF_OF('<link name="a"/>'), ["no link with a mass"]),
    "triangle": (".urdf", URDF_OF(link("arm", 1, (1, 0, 0, 1, 0, 2.1))), ["'arm'", "2.1", "exceeds the sum"]),
    "products": (".urdf", URDF_OF(link("arm", 1, (1, 2, 0, 1, 0, 1))), ["'arm'", "negative", "signs of the products"]),
    "two roots": (".urdf", URDF_OF(link("a", 1, BUS) + link("b", 1, BUS)), ["2 links that are no child"]),
    "loop": (
        ".urdf",
        URDF_OF(
            MASSLESS
            + link("bus", 1, BUS)
            + link("arm", 1, BUS)
            + joint("fixed")
            + joint("fixed", name="k", parent="arm", child="bus")
        ),
        ["closed loop"],
    ),
    "no link": (".urdf", URDF_OF(""), ["no <link>"]),
    "same names": (".urdf", URDF_OF(link("a", 1, BUS) * 2), ["name='a'", "the name of line 1"]),
    "unknown link": (".urdf", URDF_OF(link("bus", 1, BUS) + joint("fixed")), ["name='j'", "'arm'", "not in the file"]),
    "joint type": (".urdf", URDF_OF("".join(robots.TWO) + joint("hinge")), ["'hinge'", "revolute"]),
    "two orientations": (
        ".urdf",
        URDF_OF(link("a", 1, BUS, '<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>')),
        ["rpy and quat_xyzw"],
    ),
    "default inertia": (".sdf", sdf('<model name="m"><link name="a"/></model>'), ["name='a'", "no <inertial>", "1 kg"]),
    "default moment": (
        ".sdf",
        sdf(f'<model name="m">{entity("a", 1, (1, 0, 0, None, 0, 1))}</model>'),
        ["<inertia>", "no <iyy>"],
    ),
    "automatic": (
        ".sdf",
        sdf('<model name="m"><link name="a"><inertial auto="true"/></link></model>'),
        ["<inertial>", "auto"],
    ),
    "include": (
        ".sdf",
        sdf("<world name='w'><include><uri>model://x</uri></include></world>"),
        ["<include>", "another file"],
    ),
    "added mass": (
        ".sdf",
        sdf(f'<model name="m">{entity("a", 1, BUS, inertial_pose="<fluid_added_mass/>")}</model>'),
        ["<fluid_added_mass>", "kirchhoff_body"],
    ),
    "which model": (".sdf", sdf('<model name="m"/><model name="n"/>'), ["2 models", "'m', 'n'", "link=MODEL"]),
    "pose of itself": (
        ".sdf",
        sdf(f'<model name="m">{entity("a", 1, BUS, """<pose relative_to="a"/>""")}</model>'),
        ["relative to itself"],
    ),
    "pose of nothing": (
        ".sdf",
        sdf(f'<model name="m">{entity("a", 1, BUS, """<pose relative_to="b"/>""")}</model>'),
        ["'b'", "not in its model"],
    ),
    "numbers of a pose": (
        ".sdf",
        sdf(f'<model name="m">{entity("a", 1, BUS, "<pose>1 2 3</pose>")}</model>'),
        ["<pose>", "6 finite numbers"],
    ),
    "two models of one name": (".sdf", sdf('<model name="m"/>\n<model name="m"/>'), ["line 3", "name of line 2"]),
    "no body": (".xml", mjcf(""), ["no <body>"]),
    "many elements": (".xml", "<mujoco>" + "<a/>" * 200_000 + "</mujoco>", ["more than 200000 elements"]),
    "two inertias": (
        ".xml",
        mjcf('<body name="a"><inertial pos="0 0 0" quat="1 0 0 0" mass="1" fullinertia="1 1 1 0 0 0"/></body>'),
        ["fullinertia"],
    ),
    "outside": (".xml", mjcf('<include file="../x.xml"/>'), ["<include>", "outside of the folder"]),
    "included twice": (".xml", mjcf('<include file="robot.xml"/>'), ["<include>", "again"]),
}


@pytest.mark.parametrize("suffix, text, named", REFUSED.values(), ids=REFUSED)
def test_files_are_refused_with_their_element(tmp_path, suffix, text, named):
    path = tmp_path / f"robot{suffix}"
    path.write_text(text, encoding="utf-8")
    with refused(ValueError, str(path), *named):
        co.bodies.read(path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.skipif(not MUJOCO, reason="mujoco is not installed")
@pytest.mark.parametrize(
    "inside, before, named",
    [
        ('<composite type="cable" count="5 1 1" curve="l" size="1"/>', "", ["<composite>", "deformable"]),
        (
            '<replicate count="1000"><replicate count="1000"><body/></replicate></replicate>',
            "",
            ["<replicate>", "copies"],
        ),
        (
            '<body><geom type="hfield" hfield="h"/></body>',
            '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
            ["<hfield", "larger"],
        ),
        (
            '<body><geom type="mesh" mesh="c"/></body>',
            '<asset><mesh name="c" file="/etc/hostname"/></asset>',
            ["<mesh", "path"],
        ),
        (
            '<body><geom type="mesh" mesh="c"/></body>',
            '<asset><mesh name="c" file="none.stl"/></asset>',
            ["<mesh", "none.stl"],
        ),
        ('<body><freejoint/><geom size="0"/></body>', "", ["MuJoCo", "size"]),
        ('<body><geom size="1"/></body>', '<asset><model name="x" file="y.xml"/></asset>', ["<model", "another file"]),
    ],
)
def test_models_are_refused_with_their_element(tmp_path, inside, before, named):
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(inside, before), encoding="utf-8")
    with refused(ValueError, str(path), *named):
        co.bodies.read(path)


@pytest.mark.parametrize("value, refuses", [(1.0009, False), (1.0011, True)])
def test_moments_may_be_rounded_to_three_digits(tmp_path, value, refuses):
    """A plate has a moment that is the sum of the others, which files round."""
    path = tmp_path / "plate.urdf"
    path.write_text(URDF_OF(link("a", 1, (0.5, 0, 0, 0.5, 0, value))))
    if refuses:
        with refused(ValueError, "no body has"):
            co.bodies.read(path)
    else:
        assert co.bodies.read(path).moments[2] == value


SHAPES = {
    "box": ('<box size="2 2 1"/>', 1.5),
    "sphere": ('<sphere radius="1.5"/>', 1.5),
    "cylinder": ('<cylinder radius="0.9" length="2.4"/>', 1.5),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_moment_beyond_the_shape_warns(tmp_path, shape):
    """Masses at the largest distance from the centre have the largest moment; its 2 kg in other units have more."""
    text, radius = SHAPES[shape]
    around = f'<collision><origin xyz="0.1 0 0" rpy="0 0 1"/><geometry>{text}</geometry></collision>'
    path, limit = tmp_path / "robot.urdf", 2 * (radius + 0.1) ** 2
    for moment, warns in ((0.999 * limit, False), (1.001 * limit, True), (1000 * limit, True)):
        path.write_text(URDF_OF(link("a", 2, (moment, 0, 0, moment, 0, moment), more=around)))
        if warns:
            with pytest.warns(UserWarning, match="'a' of .*robot.urdf, line 1 has the moment .*ends at 1.6") as noticed:
                co.bodies.read(path)
            assert len(noticed) == 1 and noticed[0].filename == __file__
        else:
            co.bodies.read(path)
    # The ends of a mesh are not known.
    path.write_text(path.read_text().replace(text, '<mesh filename="package://x/y.dae"/>'))
    co.bodies.read(path)


@pytest.mark.parametrize(
    "arguments, error, named",
    [
        ({"link": "bsu"}, ValueError, ["robot.urdf", "'bsu'", "'bus'"]),
        ({"link": 1}, ValueError, ["link"]),
        ({"link": "bus", "configuration": {"j": 1.0}}, ValueError, ["configuration", "leave it out"]),
        ({"configuration": {"k": 1.0}}, ValueError, ["joint", "'k'"]),
        ({"configuration": {"j": "1"}}, TypeError, ["configuration['j']"]),
        ({"configuration": {"j": np.nan}}, ValueError, ["configuration['j']"]),
        ({"configuration": 1.0}, TypeError, ["configuration", "names of joints"]),
        ({"configuration": {"fixed": 1.0}}, ValueError, ["'fixed'"]),
        ({"scale": 1.0}, ValueError, ["scale", "leave it out"]),
        ({"mass": 1.0}, ValueError, ["mass", "leave it out"]),
        ({"density": 1.0}, ValueError, ["density", "leave it out"]),
        ({"links": "bus"}, TypeError, ["links", "link="]),
    ],
)
def test_arguments_are_refused(tmp_path, arguments, error, named):
    path = tmp_path / "robot.urdf"
    more = joint("fixed", name="fixed", child="tip") + link("tip", 1, BUS)
    path.write_text(URDF_OF("".join(robots.TWO) + joint("revolute") + more))
    with refused(error, *named):
        co.bodies.read(path, **arguments)


def limited_urdf(kind, limit):
    return URDF_OF("".join(robots.TWO) + joint(kind, more=limit))


def limited_sdf(kind, limit):
    return sdf(
        f'<model name="m">{robots.SDF_BUS}{robots.SDF_ARM}{robots.moving(kind, f"<xyz>0 0 1</xyz>{limit}")}</model>'
    )


def limited_mjcf(text):
    return mjcf(f'<body name="a"><joint name="j" {text}/><inertial pos="1 0 0" {robots.PLAIN}/></body>')


UPPER, SDF_UPPER = '<limit lower="-0.5" upper="2"/>', "<limit><lower>-0.5</lower><upper> 2 </upper></limit>"
FOLLOWER = (
    "".join(robots.TWO)
    + link("led", 1, BUS)
    + joint("revolute", name="led", child="led")
    + joint("revolute", more=f'<mimic joint="led" multiplier="3"/>{UPPER}')
)
LIMITED = {
    "revolute": (".urdf", limited_urdf("revolute", UPPER), (-0.5, 0.0, 2.0), (-0.6, 3.0)),
    "prismatic": (".urdf", limited_urdf("prismatic", UPPER), (2.0,), (2.01,)),
    "one is written": (".urdf", limited_urdf("revolute", '<limit upper="2"/>'), (0.0, 2.0), (-0.1, 3.0)),
    "none is written": (".urdf", limited_urdf("revolute", '<limit effort="1" velocity="1"/>'), (-9.0, 9.0), ()),
    "continuous": (".urdf", limited_urdf("continuous", UPPER), (-9.0, 9.0), ()),
    "zero is beyond": (".urdf", limited_urdf("revolute", '<limit lower="1" upper="2"/>'), (None, 1.0), (0.0,)),
    "a joint that follows": (".urdf", URDF_OF(FOLLOWER), (None, 2.0 / 3.0), (1.0, -0.2)),
    "SDF": (".sdf", limited_sdf("revolute", SDF_UPPER), (-0.5, 2.0), (-0.6, 3.0)),
    "SDF, infinite": (".sdf", limited_sdf("revolute", SDF_UPPER.replace("-0.5", "-inf")), (-9.0,), (3.0,)),
    "SDF, upper alone": (".sdf", limited_sdf("prismatic", "<limit><upper>2</upper></limit>"), (-9.0,), (3.0,)),
    "SDF, continuous": (".sdf", limited_sdf("continuous", SDF_UPPER), (-9.0, 9.0), ()),
    "MJCF": (".xml", limited_mjcf('range="-90 90"'), (-np.pi / 2, np.pi / 2), (1.6, -1.6)),
    "MJCF, a reference": (".xml", limited_mjcf('range="0 90" ref="30"'), (None, 0.0, np.pi / 2), (1.6, -0.1)),
    "MJCF, unlimited": (".xml", limited_mjcf('range="-90 90" limited="false"'), (9.0,), ()),
    "MJCF, slider": (".xml", limited_mjcf('type="slide" range="-0.5 2"'), (2.0,), (3.0,)),
}


@pytest.mark.parametrize("case", LIMITED)
def test_positions_beyond_limits_are_refused(tmp_path, case):
    """Also of a joint that follows; a position that was not given is that of the file."""
    suffix, text, within, beyond = LIMITED[case]
    if suffix == ".xml" and not MUJOCO:
        pytest.skip("mujoco is not installed")
    path = tmp_path / f"robot{suffix}"
    path.write_text(text)
    moved = "led" if case == "a joint that follows" else "j"
    for position in within:
        co.bodies.read(path, configuration=None if position is None else {moved: position})
    for position in beyond:
        with refused(ValueError, path.name, f"configuration['{moved}'] is {position:g}", "'j'", "limits this joint"):
            co.bodies.read(path, configuration={moved: position})


@pytest.mark.parametrize(
    "name, named", [("a.step", "suffix"), ("a.usd", "suffix"), ("a.xacro", "xacro"), ("a.udrf", ".urdf"), ("a", "''")]
)
def test_other_files_are_refused(tmp_path, name, named):
    with refused(ValueError, name, named):
        co.bodies.read(tmp_path / name)
    with pytest.raises(OSError):
        co.bodies.read(tmp_path / "none.urdf")
    with refused(TypeError, "path"):
        co.bodies.read(1)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "robot.urdf")
    with pytest.raises(OSError, match="no regular file"):
        co.bodies.read(tmp_path / "robot.urdf")


def test_large_files_are_not_read(tmp_path):
    path = tmp_path / "robot.urdf"
    with open(path, "wb") as file:
        file.truncate(2**26 + 1)
    with refused(ValueError, str(path), "at most"):
        co.bodies.read(path)


def test_long_chains_of_frames_are_read(tmp_path):
    path, count = tmp_path / "robot.sdf", 1500
    frames = [f'<frame name="f{k}"><pose relative_to="f{k + 1}">1 0 0 0 0 0</pose></frame>' for k in range(count)]
    last, body = f'<frame name="f{count}"/>', entity("a", 1, BUS, '<pose relative_to="f0"/>')
    path.write_text(sdf(f'<model name="m">{"".join(frames)}{last}{body}</model>'))
    assert co.bodies.read(path).centre_of_mass[0] == count


def test_files_that_include_each_other_are_bounded(tmp_path):
    for k in range(120):
        inner = "<body>" * 200 + f'<include file="f{k + 1}.xml"/>' + "</body>" * 200
        (tmp_path / f"f{k}.xml").write_text(f"<mujoco><worldbody>{inner}</worldbody></mujoco>")
    with refused(ValueError, "f1.xml", "nested deeper"):
        co.bodies.read(tmp_path / "f0.xml")


def test_a_fixed_joint_that_mimics_is_fixed(tmp_path):
    path = tmp_path / "robot.urdf"
    led = joint("revolute", name="led", child="tip") + link("tip", 1, BUS)
    path.write_text(URDF_OF("".join(robots.TWO) + led + joint("fixed", more='<mimic joint="led" offset="1"/>')))
    at_rest = co.bodies.read(path)
    path.write_text(path.read_text().replace('<mimic joint="led" offset="1"/>', ""))
    assert np.array_equal(co.bodies.read(path).inertia, at_rest.inertia)


def test_a_wrong_link_does_not_hide_another(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF_OF(robots.TWO[0] + link("arm", 1, (1, 0, 0, 1, 0, 3)) + joint("fixed")))
    assert co.bodies.read(path, link="bus").mass == 12
    with refused(ValueError, "'arm'"):
        co.bodies.read(path)


def test_a_closed_loop_of_sdf_is_read_as_it_is_written(tmp_path):
    path = tmp_path / "robot.sdf"
    axis = "<xyz>0 0 1</xyz>"
    both = robots.moving("revolute", axis) + robots.moving("revolute", axis, parent="world").replace('"j"', '"k"')
    path.write_text(sdf(f'<model name="m">{robots.SDF_BUS}{robots.SDF_ARM}{both}</model>'))
    assert co.bodies.read(path).mass == co.bodies.read(path, configuration={"j": 0.0}).mass == 14
    with refused(ValueError, str(path), "closed loop"):
        co.bodies.read(path, configuration={"j": 0.1})


def test_the_reach_of_a_shape_is_from_the_centre_of_mass(tmp_path):
    """A ball about the origin of a link, and its centre of mass one metre away: matter is within 1.5 m."""
    path, ball = tmp_path / "robot.urdf", '<collision><geometry><sphere radius="0.5"/></geometry></collision>'
    at, limit = '<origin xyz="1 0 0"/>', 2 * 1.5**2
    path.write_text(URDF_OF(link("a", 2, tuple(0.999 * limit * v for v in (1, 0, 0, 1, 0, 1)), at, ball)))
    assert co.bodies.read(path).radius == 1.5
    # About the centre of mass the same ball is too small.
    path.write_text(path.read_text().replace("<collision>", f"<collision>{at}"))
    with pytest.warns(UserWarning, match="ends at 0.5"):
        co.bodies.read(path)


def test_the_reach_of_links_is_known_if_that_of_each_is(tmp_path):
    path, box = tmp_path / "robot.urdf", '<visual><geometry><box size="2 2 1"/></geometry></visual>'
    arm = link("arm", 12, ARM, '<origin xyz="0.1 0 0.8"/>', box)
    path.write_text(URDF_OF(link("bus", 12, BUS, '<origin xyz="0.1 0 -0.2"/>', box) + arm + joint("fixed")))
    links = [co.bodies.read(path, link=name) for name in ("bus", "arm")]
    assert co.bodies.read(path).radius == pytest.approx(0.5 + max(one.radius for one in links), rel=1e-15)
    path.write_text(URDF_OF(robots.TWO[0] + arm + joint("fixed")))
    assert co.bodies.read(path, link="arm").radius == links[1].radius
    assert co.bodies.read(path).radius is None


# In systems.


@pytest.fixture
def sat(tmp_path):
    path = tmp_path / "sat.urdf"
    path.write_text(URDF["turned axes of an inertial"].text)
    return co.bodies.read(path)


@pytest.mark.parametrize("name", ["body", "rigid_body", "gyrostat", "satellite_on_orbit"])
def test_systems_take_a_body_as_its_tensor(sat, name):
    make = getattr(co.systems, name)
    taken, plain = make(sat), make(sat.inertia)
    assert taken.parameters == plain.parameters
    x = np.linspace(0.5, 1.5, taken.dim)
    assert np.array_equal(taken.vector_field(x), plain.vector_field(x))
    again = co.systems.get(name, **taken.parameters)
    assert np.array_equal(again.vector_field(x), plain.vector_field(x))


def test_a_satellite_has_the_mass_of_its_body(sat):
    assert co.systems.satellite(sat, mass=3.0).parameters["mass"] == 3.0
    with refused(ValueError, "mass is 100", "mass 3"):
        co.systems.satellite(sat)


def test_bodies_and_their_masses(sat):
    moon = co.bodies.MassProperties(2.0, (0.1, 0.2, 0.25))
    for make in (co.systems.bodies, co.systems.gravitating_bodies):
        pair = make([sat, moon])
        assert pair.parameters["masses"] == (3.0, 2.0) == make(iter([sat, moon]), (3.0, 2.0)).parameters["masses"]
        assert np.array_equal(pair.parameters["inertias"][0], sat.inertia)
        assert make([sat, (1, 1, 1)], (3.0, 5.0)).parameters["masses"] == (3.0, 5.0)
        with refused(ValueError, "masses[1] is 5", "inertias[1]", "mass 2"):
            make([sat, moon], (3.0, 5.0))
        with refused(ValueError, "masses", "inertias[1]"):
            make([sat, (1, 1, 1)])


@pytest.mark.parametrize("name", ["heavy_top", "kirchhoff_body"])
def test_an_inertia_of_another_kind_is_refused(sat, name):
    with refused(TypeError, "inertia", "centre of mass", "about(point)"):
        getattr(co.systems, name)(sat)


def test_a_top_has_the_inertia_about_its_pivot(sat):
    pivot = np.array([0.0, 0.1, -0.5])
    d = sat.centre_of_mass - pivot
    assert sat.about(pivot) == pytest.approx(sat.inertia + 3 * (d @ d * np.eye(3) - np.outer(d, d)), rel=1e-14)
    co.systems.heavy_top(sat.about(pivot), 3 * 9.81 * d)
    with refused(ValueError, "point"):
        sat.about((0, 1))


def test_the_free_body_of_a_file(sat):
    """A run in the axes of the file, and the same motion in principal axes by the closed form of moments."""
    system, principal = co.systems.body(sat), co.systems.body(sat.moments)
    omega = np.array([0.3, 1.0, 0.2])
    sol = co.integrate(system, system.state(angular_velocity=omega), (1, 6), 0.05, co.Splitting(parts="free_body"))
    exact = principal.exact(principal.state(sat.axes, angular_velocity=sat.axes.T @ omega), 5.0)
    assert system.attitudes(sol.x[-1]) == pytest.approx(principal.attitudes(exact) @ sat.axes.T, abs=1e-12)


def test_mass_properties_are_values(sat):
    copy = pickle.loads(pickle.dumps(sat))
    assert repr(copy) == repr(sat) and np.array_equal(copy.inertia, sat.inertia)
    with pytest.raises(ValueError, match="read-only"):
        sat.inertia[0, 0] = 1.0
    with pytest.raises(AttributeError, match="mass"):
        sat.mass = 1.0
    assert re.match(r"MassProperties\(mass=3, ", repr(sat))


@pytest.mark.parametrize("unit", [1e-30, 1e-7, 1.0, 1e30])
def test_mass_properties_in_any_units(unit):
    body = co.bodies.MassProperties(2 * unit, unit * robots.tensor(*BUS), radius=1.0)
    assert body.moments / unit == pytest.approx(np.linalg.eigvalsh(robots.tensor(*BUS)), rel=1e-14)
    with refused(ValueError, "no body has"):
        co.bodies.MassProperties(unit, unit * np.array([1.0, 1.0, 2.1]))
    with pytest.warns(UserWarning, match="units of mass and length"):
        co.bodies.MassProperties(0.4 * unit, unit * robots.tensor(*BUS), radius=1.0)


@pytest.mark.parametrize(
    "arguments, named",
    [
        ({"mass": 0.0}, "mass"),
        ({"inertia": (1, 2)}, "shape (2,)"),
        ({"inertia": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]}, "not symmetric"),
        ({"inertia": (1, 2, np.nan)}, "inertia[2]"),
        ({"centre_of_mass": (1, 2)}, "centre_of_mass"),
        ({"radius": -1.0}, "radius"),
        ({"third_moments": np.zeros((3, 3, 3))}, "both or neither"),
        ({"third_moments": np.zeros((3, 3)), "fourth_moments": np.zeros((3,) * 4)}, "third_moments has shape"),
        (
            {"third_moments": np.eye(27)[1].reshape(3, 3, 3), "fourth_moments": np.zeros((3,) * 4)},
            "third_moments is not symmetric",
        ),
    ],
)
def test_wrong_mass_properties_are_refused(arguments, named):
    with refused(ValueError, named):
        co.bodies.MassProperties(**{"mass": 1.0, "inertia": (1, 1, 1), **arguments})
