"""Fit moments of inertia and a damping rate of a tumbling body to a log of quaternions, with their errors."""

from pathlib import Path

import numpy as np

import coadjoint as co

# A camera saw the attitude of a satellite every half second, with errors of 0.01 rad about each axis.
log = co.attitudes.read(Path(__file__).with_name("tumbling_log.csv"))
sigma = 0.01

# The guess. Attitudes do not determine the unit of the momentum: the second moment is given, others relative to it.
craft = co.systems.rigid_body(inertia=(1.1, 2.0, 2.4)).with_forces(co.forces.LinearDamping(0.02))
guess = co.prepare(craft, co.Splitting(order=4), step=0.05, attitude=True)
unknown = {"inertia": (0, 2), "LinearDamping.rate": True, "x0": True, "attitude0": True}
found = co.fit(
    guess,
    (1.05, 0.2, 0.55),
    log.t_span,
    {"attitude": log.rotation},
    unknown,
    t_eval=log.t,
    sigma={"attitude": sigma},
    attitude=log.rotation[0],
)
rate, error = found.values["LinearDamping.rate"], found.standard_deviation("LinearDamping.rate")
print(f"moments {found.values['inertia'][[0, 2]]} with errors {found.standard_deviation('inertia')[[0, 2]]}")
print(f"damping rate {rate:.4f} with the error {error:.4f}; {found}")

# The log was made by these numbers.
wrong = (found.values["inertia"] - (1.0, 2.0, 2.5))[[0, 2]]
assert np.all(np.abs(wrong) < 4 * found.standard_deviation("inertia")[[0, 2]])
assert abs(rate - 0.03) < 4 * error < 0.002
