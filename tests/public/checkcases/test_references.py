"""References of check-cases against integrations that share no code with them: Taylor series in extended precision,
and DOP853 of SciPy. A case without one here fails."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co

CHECKED = 7  # times of each case
LONG = np.longdouble
EPSILON = np.zeros((3, 3, 3), LONG)
for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    EPSILON[i, j, k], EPSILON[i, k, j] = 1, -1
ORDER = 22


def value(case, name):
    return np.asarray(case.parameters[name][0], dtype=float)


def times_of(case):
    return np.unique(np.concatenate([[0.0], np.linspace(0.09, 1.0, CHECKED) * case.end]))


def crossed(A, B):
    """Return the coefficient of the product of two series, the cross product, of their highest order."""
    return np.einsum("ijk,nj,nk->i", EPSILON, A, B[::-1])


def series(inverse, inertia, rotors, torque, lever, w, g, q):
    """Return the Taylor coefficients of rates, vertical and quaternion of a body."""
    W, G, Q = np.zeros((ORDER + 1, 3), LONG), np.zeros((ORDER + 1, 3), LONG), np.zeros((ORDER + 1, 4), LONG)
    L = np.zeros((ORDER + 1, 3), LONG)
    W[0], G[0], Q[0], L[0] = w, g, q, inertia @ w + rotors
    for n in range(ORDER):
        moment = crossed(L[: n + 1], W[: n + 1]) + np.array([*np.cross(G[n], lever)])
        if n == 0:
            moment = moment + torque
        W[n + 1] = inverse @ moment / (n + 1)
        L[n + 1] = inertia @ W[n + 1]
        G[n + 1] = crossed(G[: n + 1], W[: n + 1]) / (n + 1)
        v, s, u = Q[: n + 1, 1:], Q[: n + 1, 0], W[n::-1][: n + 1]
        vector = s @ u + crossed(v, W[: n + 1])
        Q[n + 1] = np.concatenate([[-np.sum(v * u)], vector]) / (2 * (n + 1))
    return W, G, Q


def rotating_body(inertia, rates, times, *, attitude=(1, 0, 0, 0), rotors=(0, 0, 0), torque=(0, 0, 0), lever=(0, 0, 0)):
    """Return rates and quaternions at times of a body with a constant torque, rotors, and a weight."""
    inertia, w = np.asarray(inertia, LONG), np.asarray(rates, LONG)
    inverse = np.linalg.inv(inertia.astype(float)).astype(LONG)
    inverse = inverse @ (2 * np.eye(3) - inertia @ inverse)  # one step of Newton
    rotors, torque, lever, q = (np.asarray(v, LONG) for v in (rotors, torque, lever, attitude))
    q = q / np.sqrt(q @ q)
    a, b, c, d = q
    g = np.array([2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d])
    t, found = LONG(0), []
    for end in times:
        while True:
            W, G, Q = series(inverse, inertia, rotors, torque, lever, w, g, q)
            sizes = [np.abs(A[ORDER - k]).max() / max(np.abs(A[0]).max(), 1) for A in (W, G, Q) for k in (0, 1)]
            radius = min([float(s) ** (-1 / ORDER) for s in sizes if s > 0], default=math.inf)
            h = min(0.12 * radius, float(end - t))
            if h <= 0:
                break
            powers = LONG(h) ** np.arange(ORDER + 1)
            w, g, q = (powers @ A for A in (W, G, Q))
            q = q / np.sqrt(q @ q)
            t = t + LONG(h) if h < float(end - t) else LONG(end)
        found.append(np.concatenate([w, q]).astype(float))
    return dict(zip(("wx", "wy", "wz", "qw", "qx", "qy", "qz"), np.array(found).T, strict=True))


def integrated(field, y0, times, unit=1.0):
    """Return states at times by DOP853, in time units of the problem."""
    scaled = np.asarray(times) / unit
    run = solve_ivp(field, (0, scaled[-1]), y0, "DOP853", t_eval=scaled, rtol=3e-14, atol=1e-15)
    return run.y.T


def free(case, times):
    inertia = value(case, "inertia")
    return rotating_body(np.diag(inertia) if inertia.ndim == 1 else inertia, value(case, "rates"), times)


def rod(case, times):
    """A thin rod as the limit of a body: the moment about the axis has no effect."""
    J = float(value(case, "moment"))
    return rotating_body(np.diag([0.3 * J, J, J]), [0, value(case, "rate_y"), value(case, "rate_z")], times)


def gyrostat(case, times):
    return rotating_body(
        np.diag(value(case, "inertia")), value(case, "rates"), times, rotors=[0, 0, value(case, "rotor")]
    )


def spin_up(case, times):
    moments = [value(case, "transverse")] * 2 + [value(case, "axial")]
    return rotating_body(np.diag(moments), value(case, "rates"), times, torque=value(case, "torque"))


def top(case, times):
    half = float(value(case, "tilt")) / 2
    return rotating_body(
        np.diag(value(case, "inertia")),
        value(case, "rates"),
        times,
        attitude=(math.cos(half), math.sin(half), 0, 0),
        lever=value(case, "weight") * value(case, "centre"),
    )


def slew(case, times):
    """A loop over the samples of the computer, with a constant torque between them."""
    inertia, period, limit = value(case, "inertia"), float(value(case, "period")), float(value(case, "limit"))
    half = float(value(case, "angle")) / 2
    q, w, found = np.array([math.cos(half), *(math.sin(half) * np.array([2, -1, 2]) / 3)]), value(case, "rates"), []
    for k in range(round(case.end / period) + 1):
        u = -2 * value(case, "stiffness") * np.sign(q[0]) * q[1:] - value(case, "damping") * w
        inside = [t - k * period for t in times if k * period <= t < (k + 1) * period]
        run = rotating_body(np.diag(inertia), w, [*inside, period], attitude=q, torque=np.clip(u, -limit, limit))
        rows = np.array(list(run.values())).T
        found += [*rows[:-1]]
        w, q = rows[-1, :3], rows[-1, 3:]
    return dict(zip(("wx", "wy", "wz", "qw", "qx", "qy", "qz"), np.array(found).T, strict=True))


def about_third(angle, rate):
    zero = 0 * angle
    return {
        "wx": zero,
        "wy": zero,
        "wz": rate,
        "qw": np.cos(angle / 2),
        "qx": zero,
        "qy": zero,
        "qz": np.sin(angle / 2),
    }


def pitching(case, times, e=0.0):
    """Beletsky's equation with Kepler's equation solved by its derivative, E' = n/(1 - e cos E)."""
    A, B, C = value(case, "inertia")
    n, start = float(value(case, "mean_motion")), float(value(case, "pitch"))

    def field(t, y):
        angle, rate, E, f = y
        r = 1 - e * math.cos(E)
        return [rate, -1.5 * (B - A) / C * math.sin(2 * (angle - f)) / r**3, 1 / r, math.sqrt(1 - e * e) / r**2]

    y = integrated(field, [start, math.sqrt(1 - e * e) / (1 - e) ** 2, 0, 0], times, 1 / n)
    return about_third(y[:, 0], n * y[:, 1])


def eccentric(case, times):
    return pitching(case, times, float(value(case, "eccentricity")))


def quaternion_rate(q, w):
    s, v = q[0], q[1:]
    return np.concatenate([[-v @ w], s * w + np.cross(v, w)]) / 2


def matrix(q):
    return Rotation.from_quat(np.roll(q / np.linalg.norm(q), -1)).as_matrix()


def pair(case, times, masses, moments, forces, y0, unit, size):
    """Two bodies: relative position and velocity, and of each the quaternion and the rates; scaled by size and unit."""
    reduced = masses.prod() / masses.sum()

    def field(t, y):
        r, v, q, w = y[:3], y[3:6], y[6:14].reshape(2, 4), y[14:].reshape(2, 3)
        force, torques = forces(r, [matrix(each) for each in q])
        spun = [(np.cross(moments[k] * w[k], w[k]) + torques[k]) / moments[k] for k in range(2)]
        return np.concatenate([v, force / reduced, *(quaternion_rate(q[k], w[k]) for k in range(2)), *spun])

    y = integrated(field, y0, times, unit)
    found = dict(zip(("rx", "ry", "rz"), size * y[:, :3].T, strict=True))
    found |= dict(zip(("vx", "vy", "vz"), size / unit * y[:, 3:6].T, strict=True))
    for k in range(2):
        q = y[:, 6 + 4 * k : 10 + 4 * k]
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        found |= {f"q{name}_{k + 1}": column for name, column in zip("wxyz", q.T, strict=True)}
        w = y[:, 14 + 3 * k : 17 + 3 * k] / unit
        found |= {f"w{name}_{k + 1}": column for name, column in zip("xyz", w.T, strict=True)}
    return found


def asteroids(case, times):
    """In units of the distance, the total mass and the gravitational constant."""
    m, distance = value(case, "masses"), float(value(case, "distance"))
    unit = math.sqrt(distance**3 / (float(value(case, "G")) * m.sum()))
    squares = (value(case, "extents") / 2 / distance) ** 2
    shares = m / m.sum()
    moments = shares[:, None] * np.array([[b + c, a + c, a + b] for a, b, c in squares]) / 5
    assert np.allclose(moments * m.sum() * distance**2, value(case, "inertia"), rtol=1e-14)

    def forces(r, A):
        s = np.linalg.norm(r)
        force, torques = -shares.prod() * r / s**3, []
        for k in range(2):
            mass, I, b = shares[1 - k], moments[k], A[k].T @ r
            # V = -mass ((tr I) s^-3 - 3 b . I b s^-5)/2
            gradient = -mass / 2 * (-3 * I.sum() * r / s**5 - 6 * A[k] @ (I * b) / s**5 + 15 * (b @ (I * b)) * r / s**7)
            force = force - gradient
            torques.append(3 * mass * np.cross(b, I * b) / s**5)
        return force, torques

    tilt, libration = float(value(case, "tilt")) / 2, float(value(case, "libration")) / 2
    rate = 2 * math.pi * unit
    y0 = [1, 0, 0, 0, rate / value(case, "period"), 0]
    y0 += [math.cos(tilt), math.sin(tilt), 0, 0, math.cos(libration), 0, 0, math.sin(libration)]
    y0 += [0, 0, rate / value(case, "spin"), 0, 0, rate / value(case, "period")]
    return pair(case, times, shares, moments, forces, np.array(y0, dtype=float), unit, distance)


def dimer(case, times):
    """In the units of the source."""
    sites, q, m = value(case, "sites"), value(case, "charges"), value(case, "site_masses")
    places = sites - m @ sites / m.sum()
    squares = places**2
    moments = (
        m @ np.array([squares[:, 1] + squares[:, 2], squares[:, 0] + squares[:, 2], squares[:, 0] + squares[:, 1]]).T
    )
    epsilon, sigma, coulomb = (float(value(case, name)) for name in ("epsilon", "sigma", "coulomb"))

    def forces(r, A):
        apart = r + (places @ A[1].T)[None, :, :] - (places @ A[0].T)[:, None, :]
        s = np.linalg.norm(apart, axis=2)
        size = coulomb * np.outer(q, q) / s**3
        size[0, 0] += 24 * epsilon * (2 * (sigma / s[0, 0]) ** 12 - (sigma / s[0, 0]) ** 6) / s[0, 0] ** 2
        force = size[:, :, None] * apart  # on the sites of the second molecule
        first, second = -force.sum(axis=1), force.sum(axis=0)
        return force.sum(axis=(0, 1)), [np.cross(places, f @ M).sum(axis=0) for f, M in ((first, A[0]), (second, A[1]))]

    turned = np.roll(Rotation.from_rotvec(value(case, "attitudes")).as_quat(), 1, axis=1)
    y0 = np.concatenate([value(case, "separation"), np.zeros(3), turned.ravel(), value(case, "rates").ravel()])
    return pair(case, times, np.array([m.sum()] * 2), np.array([moments] * 2), forces, y0, 1e-12, 1e-9)


def rotating_field(case, times):
    gamma, B0, B1, rate = (float(value(case, name)) for name in ("gamma", "static", "rotating", "rate"))

    def field(t, s):
        return gamma / abs(rate) * np.cross(s, [B1 * math.cos(t), math.copysign(B1, rate) * math.sin(t), B0])

    return dict(zip(("sx", "sy", "sz"), integrated(field, [0, 0, 1], times, 1 / abs(rate)).T, strict=True))


def damped(case, times):
    gamma, B, alpha, tilt = (float(value(case, name)) for name in ("gamma", "field", "alpha", "tilt"))

    def field(t, m):
        x, y, z = m
        return [
            -(y + alpha * x * z) / (1 + alpha**2),
            (x - alpha * y * z) / (1 + alpha**2),
            alpha * (x * x + y * y) / (1 + alpha**2),
        ]

    y = integrated(field, [math.sin(tilt), 0, math.cos(tilt)], times, 1 / (gamma * B))
    return dict(zip(("sx", "sy", "sz"), y.T, strict=True))


def chain(case, times):
    J, D, K, B = (float(value(case, name)) / 1e12 for name in ("exchange", "asymmetric", "easy", "field"))

    def field(t, y):
        s = y.reshape(8, 3)
        b = np.zeros_like(s)
        b[:-1] += J * s[1:]
        b[1:] += J * s[:-1]
        z = np.array([0, 0, 1.0])
        b[:-1] -= D * np.cross(s[1:], z)  # of D z . (s_i x s_j) by s_i
        b[1:] -= D * np.cross(z, s[:-1])
        b[:, 2] += 2 * K * s[:, 2] + B
        return np.cross(s, b).ravel()

    k = np.arange(1, 9)
    polar, azimuth = 0.3 + 0.35 * k, 0.9 * k
    y0 = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]).ravel()
    names = [f"s{axis}_{k}" for k in range(1, 9) for axis in "xyz"]
    return dict(zip(names, integrated(field, y0, times, 1e-12).T, strict=True))


def rossby_haurwitz(case, times):
    """The wave as two spherical harmonics, of which that of degree m + 1 moves by the dispersion relation of Rossby's
    waves on a rotation in bulk; Legendre functions by mpmath."""
    import mpmath

    rotation, zonal, amplitude, m = (
        value(case, name).item() for name in ("rotation", "zonal", "amplitude", "wavenumber")
    )
    degree = int(m) + 1
    eigenvalue = degree * (degree + 1)
    # In axes that turn with the zonal current, of the rate zonal, the sphere turns by rotation + zonal.
    speed = zonal - 2 * (rotation + zonal) / eigenvalue
    found = {}
    for k, (latitude, longitude) in enumerate(
        np.radians([[10, 0], [30, 0], [45, 20], [60, 75], [-45, 130], [-20, 300]]), 1
    ):
        mu = math.sin(latitude)
        at_half = mpmath.legenp(degree, m, 0.5) / (0.5 * 0.75 ** (m / 2))
        wave = float(mpmath.legenp(degree, m, mu) / at_half)
        found[f"zeta_{k}"] = 2 * zonal * mu - eigenvalue * amplitude * wave * np.cos(m * (longitude - speed * times))
    return found


INDEPENDENT = {
    "brick": free,
    "coning": free,
    "damped_spin": damped,
    "eccentric_libration": eccentric,
    "free_body": free,
    "free_body_products": free,
    "gyrostat": gyrostat,
    "kovalevskaya_top": top,
    "lagrange_top": top,
    "middle_axis_flip": free,
    "pitch_libration": pitching,
    "rod": rod,
    "rossby_haurwitz": rossby_haurwitz,
    "slew": slew,
    "spin_chain": chain,
    "spin_in_rotating_field": rotating_field,
    "spin_up": spin_up,
    "two_asteroids": asteroids,
    "water_dimer": dimer,
}


LONG_RUNS = {"eccentric_libration", "water_dimer"}  # of some seconds, by DOP853 and the compiler
NAMES = [pytest.param(name, marks=[pytest.mark.long] if name in LONG_RUNS else []) for name in co.checkcases.names()]


@pytest.mark.parametrize("name", NAMES)
def test_references_agree_with_independent_integrations(name):
    """To the accuracy that is stated, at times that are not the sampled ones; and both orders, if it is integrated."""
    case = co.checkcases.get(name)
    times = times_of(case)
    independent = INDEPENDENT[name](case, times)
    found = case.compare({"t": times, **independent}, tolerance=case.accuracy)
    assert {each.name for each in found.errors} >= {quantity.name for quantity in case.quantities}
    assert found.passed, str(found)
    spread = case.spread()
    assert spread < case.accuracy and (spread > 0.0) == ("order" in case.basis)
