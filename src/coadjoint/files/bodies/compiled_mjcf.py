"""MJCF compiled by MuJoCo: masses from shapes, default classes, meshes, and joints."""

from __future__ import annotations

from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from coadjoint.files.bodies.linkages import SLIDING, TURNING, UNITS, UNLIMITED, Joint, Link, Linkage
from coadjoint.files.bodies.poses import by_quaternion
from coadjoint.files.bodies.xml_elements import Element
from coadjoint.long_operations import warn_caller
from coadjoint.memory import UNCHECKED_BYTES
from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties, Pose, identity_pose, placed, turned

MAX_MESH_BYTES = 2**30
"""Largest file of a mesh (bytes)."""
MAX_COPIES = 10_000
"""Largest number of copies of <replicate>, those that it contains included."""
KEPT = ("compiler", "default", "asset", "worldbody", "option")
"""Elements of a model on which masses and poses depend; sensors, actuators, textures and plugins are not read."""
NO_RIGID_BODY = ("composite", "flexcomp", "flex", "deformable")
MERGING = ("fusestatic", "alignfree", "discardvisual", "strippath")
"""Attributes of <compiler> that join bodies, or turn their frames, or change the names of files."""
APPEARANCE = ("material", "texture", "plugin", "skin")


def linkage_by_mujoco(root: Element, path: Path) -> Linkage:
    """Return the bodies and joints of a model that MuJoCo compiles, without data of a simulation."""
    import mujoco

    text = _written(root)
    messages: list[str] = []
    others, files = mujoco.get_mju_user_warning(), _meshes(root, path)
    # Without a function for its warnings MuJoCo prints them, and writes them into a file in the current folder.
    mujoco.set_mju_user_warning(messages.append)
    try:
        model = mujoco.MjModel.from_xml_string(text, files)
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"{root.file}: MuJoCo: {' '.join(str(error).split())}") from None
    finally:
        mujoco.set_mju_user_warning(others)
    for warning in messages:
        warn_caller(f"{root.file}: MuJoCo: {' '.join(warning.split())}", UserWarning)

    def name_of(kind: Any, number: int, what: str) -> str:
        return mujoco.mj_id2name(model, kind, number) or f"{what} {number}"

    names = [name_of(mujoco.mjtObj.mjOBJ_BODY, k, "body") for k in range(model.nbody)]
    poses = [identity_pose()]
    for k in range(1, model.nbody):
        poses.append(poses[model.body_parentid[k]] @ _pose(model.body_pos[k], model.body_quat[k]))
    shown = [f"body {short(name, 60)} of {root.file}" for name in names]
    links = {
        names[k]: Link(shown[k], poses[k], partial(_properties, model, k, shown[k])) for k in range(1, model.nbody)
    }
    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): TURNING,
        int(mujoco.mjtJoint.mjJNT_SLIDE): SLIDING,
        int(mujoco.mjtJoint.mjJNT_BALL): "a ball",
        int(mujoco.mjtJoint.mjJNT_FREE): "free",
    }
    joints = {}
    for k in range(model.njnt):
        body = int(model.jnt_bodyid[k])
        anchor = turned(poses[body].rotation, model.jnt_pos[k]) + poses[body].position
        axis, zero = turned(poses[body].rotation, model.jnt_axis[k]), 0.0
        kind = kinds[int(model.jnt_type[k])]
        if kind in (TURNING, SLIDING):
            zero = float(model.qpos0[model.jnt_qposadr[k]])
        limits = (float(model.jnt_range[k, 0]), float(model.jnt_range[k, 1])) if model.jnt_limited[k] else UNLIMITED
        name = name_of(mujoco.mjtObj.mjOBJ_JOINT, k, "joint")
        joints[name] = Joint(kind, names[model.body_parentid[body]], names[body], anchor, axis, zero, limits=limits)
    if not links:
        root.refuse("has no <body>")
    return Linkage(root.file, links, joints, "frame of the world")


def _properties(model: Any, k: int, frame: str) -> MassProperties | None:
    """Return the mass properties of a body in its frame; None without mass."""
    mass = float(model.body_mass[k])
    if mass == 0.0:
        return None
    pose = _pose(model.body_ipos[k], model.body_iquat[k])
    shapes = [g for g in range(model.ngeom) if model.geom_bodyid[g] == k]
    # The radius of a plane, which has no end, is zero.
    ends = len(shapes) > 0 and all(model.geom_rbound[g] > 0.0 for g in shapes)
    away = [float(np.linalg.norm(model.geom_pos[g] - pose.position) + model.geom_rbound[g]) for g in shapes]
    own = MassProperties(mass, model.body_inertia[k], frame=frame, units=UNITS, radius=max(away) if ends else None)
    return placed(own, pose, frame)


def _pose(position: Any, quaternion: Any) -> Pose:
    rotation = by_quaternion(*map(float, quaternion))
    return Pose(np.eye(3) if rotation is None else rotation, np.array(position, dtype=np.float64))


def _written(root: Element) -> str:
    """Return the elements that matter as XML, in which MuJoCo finds no other files, plugins or large tables."""
    lines: list[str] = []
    pending: list[tuple[Element, int] | str] = [(root, 1)]
    while pending:
        entry = pending.pop()
        if isinstance(entry, str):
            lines.append(entry)
            continue
        element, copies = entry
        if element.tag in NO_RIGID_BODY:
            element.refuse("is deformable, and has no inertia of a rigid body; name a model without it")
        if element.tag == "replicate":
            copies *= max(1, int(min(element.number("count"), 1e9)))
            if copies > MAX_COPIES:
                element.refuse(f"makes {copies} copies; at most {MAX_COPIES} are read")
        if element.tag == "hfield":
            rows, columns = (element.number(key, 0.0) for key in ("nrow", "ncol"))
            if rows * columns > UNCHECKED_BYTES / 4:
                element.refuse("is larger than what is read; remove it")
        if element.tag in ("attach", "model"):
            element.refuse("is a model in another file, which is not read; write it here, as MuJoCo saves it")
        dropped = (*APPEARANCE, *(MERGING if element.tag == "compiler" else ()))
        attributes = {key: value for key, value in element.attributes.items() if key not in dropped}
        if element.tag == "mesh" and "file" in attributes:
            attributes.setdefault("name", PurePosixPath(attributes["file"]).stem)
        written = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
        lines.append(f"<{element.tag}{written}>")
        pending.append(f"</{element.tag}>")
        children = [child for child in element.children if child.tag not in APPEARANCE]
        if element.parent is None:
            children = [child for child in children if child.tag in KEPT]
        pending += [(child, copies) for child in reversed(children)]
    return "\n".join(lines)


def _meshes(root: Element, path: Path) -> dict[str, bytes]:
    """Return the files of the meshes and height fields of a model, by the names under which MuJoCo looks for them."""
    folders = {key: value for one in root.all("compiler") for key, value in one.attributes.items()}
    folder = folders.get("meshdir", folders.get("assetdir", ""))
    found: dict[str, bytes] = {}
    for asset in root.all("asset"):
        for mesh in asset.all("mesh", "hfield"):
            if "file" not in mesh.attributes:
                continue
            name = mesh.attributes["file"]
            file = path.parent / folder / name
            if PurePosixPath(name).is_absolute() or PurePosixPath(folder).is_absolute():
                mesh.refuse(f"is in {short(str(file), 60)}; give a path from the folder of the model")
            try:
                found[name] = content_of(file, MAX_MESH_BYTES, "a mesh", 8)
            except OSError as error:
                mesh.refuse(f"is in {short(name, 60)}, which cannot be read: {error}")
    return found
