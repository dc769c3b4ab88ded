"""Controlled bodies over time: errors of pointing, torques, wheels and gimbals."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import draw_over_time
from coadjoint.pictures.kinds.quantities import first_lines
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.runs.results.solution_attributes import are_rotations
from coadjoint.systems.forces.body_torque import Pointing
from coadjoint.systems.forces.sampled import Sampled

Floats = npt.NDArray[np.float64]

MAX_TIMES = 400  # points at which laws are evaluated, in Python
CONTROL_PICTURES = ("pointing error", "angular velocity", "torques", "wheel speeds", "gimbal angles")
"""Pictures of a controlled body, in place of the components of its state."""


def controllers(system: Any) -> list[Any]:
    """Return the forces of a system that control it: laws that point it, and those that are sampled."""
    return [force for force in system.forces if isinstance(force, Pointing | Sampled)]


@kind("pointing error", over_time=True)
def pointing_error(drawn: PlottedRun) -> Paint:
    """Show the angle between a body and the attitude wanted by its first `Pointing`, on a logarithmic scale."""
    A = drawn.rotation if drawn.unforced.has_attitude else None
    if A is None:
        raise CannotShow(f"the states of {drawn.unforced.name} have no attitude of one body")
    series = {"angle": np.stack([_angles(drawn.system_of(m), A[m], drawn.t) for m in range(len(A))])}

    def paint(axes: Any) -> None:
        draw_over_time(axes, drawn.t, series, drawn.dense, "angle [degrees]", "pointing error", drawn)
        if (series["angle"] > 0.0).any():
            axes.set_yscale("log")

    return paint


def _angles(system: Any, A: Floats, t: Floats) -> Floats:
    """Return the angles in degrees from attitudes (k, 3, 3) to the wanted ones, up to half a turn."""
    from scipy.spatial.transform import Rotation

    laws = [getattr(force, "law", force) for force in controllers(system)]
    law = next((law for law in laws if isinstance(law, Pointing) and np.any(law.stiffness)), None)
    if law is None:
        raise CannotShow(f"{system.name} has no co.forces.Pointing with a stiffness")
    wanted: Any = np.eye(3) if law.attitude is None else law.attitude
    D = np.stack([np.asarray(wanted(time)) for time in t.tolist()]) if callable(wanted) else np.asarray(wanted)
    proper, angles = are_rotations(A), np.full(len(A), np.nan)
    angles[proper] = Rotation.from_matrix((np.swapaxes(D, -2, -1) @ A)[proper]).magnitude()
    return np.degrees(angles)


@kind("torques", over_time=True)
def torques(drawn: PlottedRun) -> Paint:
    """Show the commands of controllers, at most eight: torques in the body frame, of motors, or rates of gimbals.

    Those that are held are shown as saved, of thrusters by their mean over a period; those of a `Pointing` at up to 400
    times.
    """
    if not controllers(drawn.system):
        raise CannotShow(f"{drawn.system.name} has no controller, such as co.forces.Pointing")
    held = all(isinstance(force, Sampled) for force in controllers(drawn.system))
    indices = np.arange(len(drawn.t)) if held else spread(len(drawn.t), MAX_TIMES)
    by_member = [_commands(drawn.system_of(m), drawn.x[m, indices], drawn.t[indices]) for m in range(len(drawn.x))]
    series = {name: np.stack([commands[name] for commands in by_member]) for name in by_member[0]}
    lines, shown = first_lines(series)
    label = " and ".join(dict.fromkeys(getattr(force, "command_name", "torque") for force in controllers(drawn.system)))
    return lambda axes: draw_over_time(axes, drawn.t[indices], lines, drawn.dense, label, label + shown, drawn)


def _commands(system: Any, x: Floats, t: Floats) -> dict[str, Floats]:
    """Return the commands of all controllers at states (k, n), by name and component."""
    found = {}
    forces = controllers(system)
    for label, force in zip(system.labels, system.forces, strict=True):
        if force not in forces:
            continue
        if isinstance(force, Sampled):
            values = force.held_at(system.unforced, x)
        else:
            fields = [force.field(system.unforced, state, time) for state, time in zip(x, t.tolist(), strict=True)]
            values = np.reshape(fields, x.shape)[:, :3]
        owner = f" [{label}]" if len(forces) > 1 else ""
        found.update({f"$N_{i + 1}$" + owner: values[:, i] for i in range(values.shape[1])})
    return found


@kind("wheel speeds", over_time=True)
def wheel_speeds(drawn: PlottedRun) -> Paint:
    """Show the speeds of reaction wheels relative to their body, in radians per time, at most eight."""
    return _of_rotors(drawn, "wheel_speeds", "wheels", r"\omega", "speed of the wheels")


@kind("gimbal angles", over_time=True)
def gimbal_angles(drawn: PlottedRun) -> Paint:
    """Show the gimbal angles of control-moment gyros in radians, without jumps, at most eight."""
    return _of_rotors(drawn, "gimbal_angles", "gyros", r"\delta", "gimbal angles")


def _of_rotors(drawn: PlottedRun, name: str, rotors: str, letter: str, title: str) -> Paint:
    if not len(getattr(drawn.unforced, rotors, ())):
        raise CannotShow(f"{drawn.unforced.name} has no {rotors}; co.systems.body({rotors}=...) has them")
    by_member = [getattr(drawn.system_of(m).unforced, name)(x) for m, x in enumerate(drawn.x)]
    values = np.stack(by_member)
    if name == "gimbal_angles":
        values = np.unwrap(values, axis=1)
    lines, shown = first_lines({f"${letter}_{i + 1}$": values[..., i] for i in range(values.shape[-1])})
    return lambda axes: draw_over_time(axes, drawn.t, lines, drawn.dense, title, title + shown, drawn)
