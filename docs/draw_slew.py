"""Draw `docs/slew.png`, the run of `docs/satellite.md` with reaction wheels: ``python docs/draw_slew.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import coadjoint as co

PICTURE = Path(__file__).with_name("slew.png")


def draw() -> plt.Figure:
    """Return the error of the attitude, the speeds of the wheels, and the torques of their motors over time."""
    inertia = np.array([[4.0, 0.1, 0.0], [0.1, 5.0, 0.2], [0.0, 0.2, 6.0]])
    axes = np.array([(1, 0, 1), (0, 1, 1), (-1, 0, 1), (0, -1, 1)]) / np.sqrt(2)
    target = Rotation.from_euler("xyz", [30, -40, 80], degrees=True)
    law = co.forces.Pointing(0.3, 2.2, target, error="quaternion")
    motors = co.forces.ReactionWheels(law, period=0.25, max_torque=0.05, max_momentum=0.4)
    bus = co.systems.body(inertia, wheels=0.002 * axes).with_forces(motors)
    sol = co.integrate(bus, bus.state(wheel_speeds=[50, -50, 50, -50]), (0, 120), 0.125)
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.2), layout="constrained")
    panels[0].semilogy(sol.t, np.degrees((target.inv() * sol.rotation).magnitude()))
    panels[1].plot(sol.t, bus.wheel_speeds(sol.x))
    panels[2].plot(sol.t, sol.x[:, -4:], drawstyle="steps-post")
    titles = ("error of the attitude [degrees]", "speeds of the wheels [rad/s]", "torques of the motors [N m]")
    for panel, title in zip(panels, titles, strict=True):
        panel.set(xlabel="t [s]", title=title)
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
