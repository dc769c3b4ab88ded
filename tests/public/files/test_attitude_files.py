"""Logs of attitudes: CSV, TUM and AEM read and written, C-kernels of SPICE, and fits of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

A = co.attitudes
RNG = np.random.default_rng(4)
T = 0.25 * np.arange(9)
TURNED = Rotation.random(9, random_state=5)
OMEGA = RNG.normal(0.0, 0.1, (9, 3))
X = TURNED.as_quat()
DATED = {"frame": "J2000", "epoch": "2026-03-01T12:00:00.125"}
CLOSE = 1e-9


def table(columns, names=None, separator=",", comment=""):
    lines = [separator.join(f"{x:.12g}" if isinstance(x, float) else str(x) for x in row) for row in columns]
    return "\n".join([*([comment] if comment else []), *([names] if names else []), *lines, ""])


def rows(quaternions, *others, t=T):
    return [[t_, *(float(x) for x in q), *more] for t_, q, *more in zip(t.tolist(), quaternions, *others, strict=True)]


W_FIRST = X[:, [3, 0, 1, 2]]
RATED = [[t, *w, *q] for t, w, q in zip(T.tolist(), OMEGA.tolist(), W_FIRST.tolist(), strict=True)]
IN_DEGREES = [[t, *np.degrees(w).tolist(), *q] for t, w, q in zip(T.tolist(), OMEGA, W_FIRST.tolist(), strict=True)]
DATES = [[f"2026-03-01T12:00:{t:06.3f}", *q] for t, q in zip(T.tolist(), W_FIRST.tolist(), strict=True)]
IN_TURNS = [[t, *(30 / np.pi * w).tolist(), *q] for t, w, q in zip(T.tolist(), OMEGA, W_FIRST.tolist(), strict=True)]
OTHER = {"time": "stamp", "quaternion": ["a", "b", "c", "d"]}
CSV = {
    "named": (table(rows(W_FIRST), "t,qw,qx,qy,qz"), {}),
    "named last": (table(rows(X), "time,qx,qy,qz,qw"), {}),
    "units and capitals": (table(rows(X), "Time [s], Qx [], Qy [], Qz [], Qw []"), {}),
    "plain letters": (table(rows(W_FIRST), "timestamp,w,x,y,z"), {}),
    "scalar named c": (table(rows(X), "t,q1,q2,q3,qc"), {}),
    "numbered from 0": (table(rows(W_FIRST), "t,q0,q1,q2,q3"), {"attitude": "wxyz"}),
    "numbered from 1": (table(rows(X), "t,q1,q2,q3,q4"), {"attitude": "xyzw"}),
    "no names, first": (table(rows(W_FIRST)), {"attitude": "wxyz"}),
    "no names, last": (table(rows(X)), {"attitude": "xyzw"}),
    "semicolons": (table(rows(W_FIRST), "t;qw;qx;qy;qz", ";"), {}),
    "tabs": (table(rows(W_FIRST), "t\tqw\tqx\tqy\tqz", "\t"), {}),
    "names in a comment": (table(rows(W_FIRST), comment="#t,qw,qx,qy,qz"), {}),
    "rates": (table(RATED, "t,wx,wy,wz,qw,qx,qy,qz"), {"rates": "rad/s"}),
    "rates with a unit": (table(RATED, "t,wx [rad/s],wy [rad/s],wz [rad/s],qw,qx,qy,qz"), {}),
    "rates with an ending": (table(RATED, "t_s,p_rad_s,q_rad_s,r_rad_s,qw,qx,qy,qz"), {"rates": "rad/s"}),
    "rates in degrees": (table(IN_DEGREES, "t,wx_dps,wy_dps,wz_dps,qw,qx,qy,qz"), {}),
    "rates that are left": (table(RATED, "t,wx,wy,wz,qw,qx,qy,qz"), {"rates": False}),
    "space to body": (table(rows(TURNED.inv().as_quat()), "t,qx,qy,qz,qw"), {"direction": "space to body"}),
    "nanoseconds": (table(rows(X, t=1e9 * T), "timestamp [ns],qx,qy,qz,qw"), {"time_unit": "ns"}),
    "milliseconds": (table(rows(X, t=1e3 * T), "t_ms,qx,qy,qz,qw"), {"time_unit": "ms"}),
    "dates": (table(DATES, "date,qw,qx,qy,qz"), {"time_system": "TAI"}),
    "milliseconds by name": (table(rows(X, t=1e3 * T), "t [ms],qx,qy,qz,qw"), {}),
    "minutes": (table(rows(X, t=T / 60.0), "Time (min),qx,qy,qz,qw"), {}),
    "spaces": (table(rows(W_FIRST), "t qw qx qy qz", " "), {}),
    "percent signs": (table(rows(W_FIRST), "t,qw,qx,qy,qz", comment="% made by others"), {}),
    "rates in turns a minute": (
        table(IN_TURNS, "t,wx [rpm],wy [rpm],wz [rpm],qw,qx,qy,qz"),
        {},
    ),
    "other names": (table(rows(W_FIRST), "stamp,a,b,c,d"), {"columns": OTHER, "attitude": "wxyz"}),
    "other names, last": (table(rows(X), "stamp,a,b,c,d"), {"columns": OTHER, "attitude": "xyzw"}),
    "other names one by one": (
        table(rows(X, t=1e3 * T), "stamp,a,b,c,d"),
        {"columns": {"t": "stamp[ms]", "qx": "a", "qy": "b", "qz": "c", "qw": "d"}},
    ),
    "other names as text": (table(rows(X, t=1e3 * T), "stamp,a,b,c,d"), {"columns": "t=stamp[ms],qx=a,qy=b,qz=c,qw=d"}),
    "other names in their order": (table(rows(X, T), "stamp,a,b,c,d,e"), {"columns": "t,qx,qy,qz,qw,-"}),
    "no names, listed": (table(rows(X, T)), {"columns": "t,qx,qy,qz,qw,-"}),
    "rates of other names": (
        table(IN_DEGREES, "t,u,v,w,qw,qx,qy,qz"),
        {"columns": {"rates": ["u[deg/s]", "v[deg/s]", "w[deg/s]"]}},
    ),
    "a unit in a name of another": (
        table(rows(W_FIRST, t=1e3 * T), "clock_ms,qw,qx,qy,qz"),
        {"columns": {"time": "clock_ms"}},
    ),
    "a unit of a name as text": (
        table(rows(W_FIRST, t=1e6 * T), "logStampUs,qw,qx,qy,qz"),
        {"columns": "t=logStampUs"},
    ),
    "a unit beside a name": (table(rows(W_FIRST), "clock_ms,qw,qx,qy,qz"), {"columns": {"time": "clock_ms[s]"}}),
    "units in names of rates": (
        table(IN_TURNS, "t,roll_rpm,pitch_rpm,yaw_rpm,qw,qx,qy,qz"),
        {"columns": {"rates": ["roll_rpm", "pitch_rpm", "yaw_rpm"]}},
    ),
    "signs": (table(rows(W_FIRST * np.array([1.0, -1.0] * 4 + [1.0])[:, None]), "t,qw,qx,qy,qz"), {}),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("case", CSV)
def test_tables(tmp_path, case):
    text, options = CSV[case]
    path = tmp_path / "log.csv"
    path.write_text(text)
    log = A.read(path, **options)
    assert (log.rotation * TURNED.inv()).magnitude().max() < CLOSE
    assert np.abs(log.t - T).max() < 1e-12 * 60.0  # of the digits that are written, in minutes
    rated = "rates" in case and options.get("rates") is not False
    assert (log.angular_velocity is not None) == rated
    if rated:
        assert np.abs(log.angular_velocity - OMEGA).max() < 1e-9
    if case == "rates":
        degrees = A.read(path, rates="deg/s").angular_velocity
        assert np.abs(np.degrees(degrees) - OMEGA).max() < 1e-9
    if case == "dates":
        assert str(log.epoch) == "2026-03-01T12:00:00 TAI"


def test_tum(tmp_path):
    text = table([[t, 1.0, 2.0, 3.0, *q] for t, q in zip(T.tolist(), X.tolist(), strict=True)], separator=" ")
    path = tmp_path / "trajectory.txt"
    path.write_text("# timestamp tx ty tz qx qy qz qw\n" + text)
    with refused(ValueError, "trajectory.txt", "format"):
        A.read(path)
    log = A.read(path, format="tum")
    assert (log.rotation * TURNED.inv()).magnitude().max() < CLOSE
    with refused(ValueError, "TUM", "xyzw"):
        A.read(path, format="tum", attitude="wxyz")


def aem(kind="QUATERNION", version="2.0", columns=X, tail="", **metadata):
    known = {
        "OBJECT_NAME": "SAT",
        "OBJECT_ID": "2026-001A",
        "REF_FRAME_A": "EME2000",
        "REF_FRAME_B": "SC_BODY_1",
        "TIME_SYSTEM": "UTC",
        "START_TIME": "2026-03-01T12:00:00.000",
        "STOP_TIME": "2026-03-01T12:00:02.000",
        "ATTITUDE_TYPE": kind,
        **metadata,
    }
    lines = "\n".join(f"{name} = {value}" for name, value in known.items() if value is not None)
    data = "\n".join(
        f"2026-03-01T12:00:{t:06.3f} " + " ".join(f"{x:.12f}" for x in row)
        for t, row in zip(T.tolist(), columns, strict=True)
    )
    return (
        f"CCSDS_AEM_VERS = {version}\nCREATION_DATE = 2026-02-28T01:02:03\nORIGINATOR = TEST\n"
        f"META_START\nCOMMENT no data yet\n{lines}\nMETA_STOP\nDATA_START\n{data}\nDATA_STOP\n{tail}"
    )


OLD, BACK = {"version": "1.0"}, TURNED.inv().as_quat()
SWAPPED = {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "EME2000"}
SPUN = np.concatenate([X, np.degrees(OMEGA)], axis=1)
IN_SPACE = np.concatenate([X, np.degrees(TURNED.apply(OMEGA))], axis=1)
REVERSED = np.concatenate([BACK, -np.degrees(OMEGA)], axis=1)
AEM = {
    "plain": {},
    "from the body": {"columns": BACK, **SWAPPED},
    "version 1, last": {**OLD, "QUATERNION_TYPE": "LAST", "ATTITUDE_DIR": "A2B"},
    "version 1, first": {**OLD, "QUATERNION_TYPE": "FIRST", "ATTITUDE_DIR": "A2B", "columns": W_FIRST},
    "version 1, back": {**OLD, "QUATERNION_TYPE": "LAST", "ATTITUDE_DIR": "B2A", "columns": BACK},
    "version 1, back from the body": {**OLD, "QUATERNION_TYPE": "LAST", "ATTITUDE_DIR": "B2A", **SWAPPED},
    "derivatives": {"kind": "QUATERNION/DERIVATIVE", "columns": np.concatenate([X, 0.0 * X], axis=1)},
    "rates of version 1": {
        **OLD,
        "kind": "QUATERNION/RATE",
        "QUATERNION_TYPE": "LAST",
        "ATTITUDE_DIR": "A2B",
        "RATE_FRAME": "REF_FRAME_B",
        "columns": SPUN,
    },
    "rates in the body": {"kind": "QUATERNION/ANGVEL", "columns": SPUN, "ANGVEL_FRAME": "SC_BODY_1"},
    "rates in space": {"kind": "QUATERNION/ANGVEL", "columns": IN_SPACE, "ANGVEL_FRAME": "EME2000"},
    "rates of space": {"kind": "QUATERNION/ANGVEL", "columns": REVERSED, "ANGVEL_FRAME": "SC_BODY_1", **SWAPPED},
    "interpolation": {"INTERPOLATION_METHOD": "HERMITE", "INTERPOLATION_DEGREE": "7", "CENTER_NAME": "EARTH"},
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("case", AEM)
def test_messages(tmp_path, case):
    path = tmp_path / "attitude.txt"
    path.write_text(aem(**AEM[case]))
    log = A.read(path)
    assert (log.rotation * TURNED.inv()).magnitude().max() < CLOSE
    assert (log.frame, log.body) == ("EME2000", "SC_BODY_1") and np.abs(log.t - T).max() < 1e-12
    assert str(log.epoch) == "2026-03-01T12:00:00 UTC"
    rated = AEM[case].get("kind") == "QUATERNION/ANGVEL"
    assert (log.angular_velocity is not None) == rated
    if rated:
        assert np.abs(log.angular_velocity - OMEGA).max() < 1e-10


def test_the_quaternion_of_the_standard(tmp_path):
    """Frame B turned by 90 degrees about z from A: a vector along x of A is along -y of B (annex F2.2)."""
    path = tmp_path / "a.aem"
    path.write_text(aem(columns=np.tile([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], (9, 1))))
    attitude = A.read(path).rotation[0].as_matrix()
    assert np.allclose(attitude.T @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=CLOSE)


@pytest.mark.parametrize("rates", [None, OMEGA], ids=["attitudes", "rates"])
@pytest.mark.parametrize("suffix", [".csv", ".tum", ".aem"])
def test_round_trips(tmp_path, suffix, rates):
    log = A.AttitudeLog(T - 0.3, TURNED, rates, **DATED)
    path = tmp_path / f"log{suffix}"
    for _ in range(2):  # it is replaced
        A.write(path, log, object_name="SAT")
    again = A.read(path)
    assert (again.rotation * TURNED.inv()).magnitude().max() < 1e-15
    shift = again.t[0] + 0.3
    assert np.abs(again.t - shift - (T - 0.3)).max() < 1e-9
    if suffix == ".csv":
        assert (again.frame, again.body, again.epoch) == (log.frame, log.body, log.epoch)
    if suffix == ".aem":
        assert abs(again.epoch.seconds_to(A.AttitudeLog(T, TURNED, **DATED).epoch) - 0.3) < 1e-6
        assert again.frame == "J2000"
    if rates is not None and suffix != ".tum":
        assert np.abs(again.angular_velocity - rates).max() < 1e-15
    if rates is not None and suffix == ".csv":
        with refused(ValueError, "deg/s", "rad/s"):
            A.read(path, rates="deg/s")
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_logs_of_solutions():
    sat = co.systems.body((1.0, 2.0, 2.5))
    start = sat.state(TURNED[0], (0.1, 0.2, 0.3))
    sol = co.integrate(sat, start, (0.0, 4.0), 0.25)
    log = A.AttitudeLog.of(sol)
    assert np.array_equal(log.t, sol.t) and np.array_equal(log.angular_velocity, sol.angular_velocity)
    back = A.AttitudeLog.of(co.integrate(sat, sol.x[-1], (4.0, 0.0), 0.25))
    assert back.t_span == (0.0, 4.0) and (back.rotation * log.rotation.inv()).magnitude().max() < 1e-3
    together = co.integrate(sat, np.stack([start, start]), (0.0, 4.0), 0.25)
    with refused(ValueError, "one member"):
        A.AttitudeLog.of(together)


@pytest.mark.parametrize("rates", [None, OMEGA], ids=["attitudes", "rates"])
def test_kernels_of_spice(tmp_path, rates):
    """Read back by SPICE: the matrix from J2000 to the body, and the angular velocity in J2000."""
    spice = pytest.importorskip("spiceypy")
    log = A.AttitudeLog(T + 3.0, TURNED, rates, **DATED)
    path = tmp_path / "attitude.bc"
    for _ in range(2):
        A.write(path, log, instrument=-999000)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["attitude.bc", "attitude.tsc"]
    # TDB of 2026-03-01 12:00:03.125 UTC, 69.184 s behind TT, whose second is that of TDB within 2 ms.
    et = (np.datetime64("2026-03-01T12:00:03.125") - np.datetime64("2000-01-01T12:00:00")) / np.timedelta64(
        1, "s"
    ) + 69.184
    for kernel in ("attitude.tsc", "attitude.bc"):
        spice.furnsh(str(tmp_path / kernel))
    try:
        assert abs(spice.scs2e(-999, "1/0:0") - et) < 2e-3
        start = spice.scs2e(-999, "1/0:0")
        for k, t in enumerate(T):
            tick = spice.sce2c(-999, start + t)
            if rates is None:
                C, _ = spice.ckgp(-999000, tick, 1.0, "J2000")[:2]
            else:
                C, spin = spice.ckgpav(-999000, tick, 1.0, "J2000")[:2]
                assert np.abs(TURNED[k].as_matrix().T @ spin - OMEGA[k]).max() < 1e-12
            assert np.abs(C - TURNED[k].as_matrix().T).max() < 1e-12
        halfway, _ = spice.ckgp(-999000, spice.sce2c(-999, start + 0.125), 1.0, "J2000")[:2]
        middle = TURNED[0] * Rotation.from_rotvec(0.5 * (TURNED[0].inv() * TURNED[1]).as_rotvec())
        assert np.abs(halfway - middle.as_matrix().T).max() < 1e-6  # of a microsecond of its clock
    finally:
        spice.kclear()
    with refused(ValueError, "instrument"):
        A.write(path, log)
    with refused(ValueError, "instrument", "5"):
        A.write(path, log, instrument=5)
    with refused(ValueError, "TEME"):
        A.write(path, A.AttitudeLog(T, TURNED, frame="TEME", epoch="2026-03-01"), instrument=-999000)


def test_a_fit_of_a_log(tmp_path):
    """Moments, momentum and attitude at the start, from a file with noise, at its own times."""
    rng, sigma, inertia = np.random.default_rng(8), 1e-3, np.array([1.0, 2.0, 2.5])
    body = lambda moments: co.prepare(co.systems.body(moments), co.Splitting(order=4), 0.05)  # noqa: E731
    times = np.unique(np.round(rng.uniform(0.0, 20.0, 60), 3))
    times = np.concatenate([[0.0], times[times > 0.01], [20.0]])
    ready = body(inertia)
    start = ready.system.state(TURNED[0], (0.9, 0.2, 0.3))
    truth = ready.run(start, (0.0, 20.0), t_eval=times)
    noisy = truth.rotation * Rotation.from_rotvec(sigma * rng.standard_normal((len(times), 3)))
    A.write(tmp_path / "log.csv", A.AttitudeLog(times, noisy))
    log = A.read(tmp_path / "log.csv")
    guess = body((1.05, 2.0, 2.45))
    first = guess.system.state(log.rotation[0], (0.88, 0.2, 0.3))

    def seen(x):
        return guess.system.attitudes(x)

    found = co.fit(
        guess,
        first,
        log.t_span,
        {"seen": log.rotation.as_matrix()},
        {"inertia": (0, 2), "x0": (0, 1, 2)},
        t_eval=log.t,
        sigma={"seen": sigma},
        observe={"seen": seen},
    )
    error = np.abs(found.values["inertia"] - inertia)[[0, 2]]
    assert (error < 5 * found.standard_deviation("inertia")[[0, 2]]).all() and (error < 0.01).all()


WRONG = {
    "no order": (table(rows(X)), {}, ("wxyz", "xyzw", "attitude=")),
    "numbered": (table(rows(X), "t,q0,q1,q2,q3"), {}, ("q0", "wxyz", "xyzw")),
    "contradiction": (table(rows(X), "t,qx,qy,qz,qw"), {"attitude": "wxyz"}, ("wxyz", "qx, qy, qz, qw")),
    "an unknown order": (table(rows(X)), {"attitude": "zyxw"}, ("zyxw",)),
    "no time": (table(rows(X), "a,qx,qy,qz,qw"), {}, ("named", "'a'")),
    "no quaternion": (table(rows(X), "t,a,b,c,d"), {}, ("'a'", "columns=", "qw=NAME")),
    "six columns": (table([[*row, 1.0] for row in rows(X)]), {"attitude": "wxyz"}, ("6 columns",)),
    "a short row": (table([*rows(X), [9.0, 1.0]], "t,qx,qy,qz,qw"), {}, ("line 11", "2 columns")),
    "text": (table([*rows(X), [9.0, "x", 0, 0, 1]], "t,qx,qy,qz,qw"), {}, ("line 11", "'x'")),
    "NaN": (table([*rows(X), [9.0, "nan", 0, 0, 1]], "t,qx,qy,qz,qw"), {}, ("line 11", "nan")),
    "degrees": (table([*rows(X), [9.0, 10.0, 20.0, 30.0, 0.0]], "t,qx,qy,qz,qw"), {}, ("line 11", "37.4")),
    "zero": (table([*rows(X), [9.0, 0, 0, 0, 0]], "t,qx,qy,qz,qw"), {}, ("line 11", "unit")),
    "times": (table([*rows(X), [1.0, 0, 0, 0, 1]], "t,qx,qy,qz,qw"), {}, ("line 11", "ascend")),
    "a unit": (table(rows(X), "t [ms],qx,qy,qz,qw"), {"time_unit": "s"}, ("ms", "time_unit")),
    "an unknown unit of time": (table(rows(X), "t [years],qx,qy,qz,qw"), {}, ("years", "ms")),
    "a name twice": (table(rows(X, X[:, 0]), "t,qx,qy,qz,qw,qx"), {}, ("'qx'", "rename")),
    "groups in digits": (table([*rows(X), ["1_0", 0, 0, 0, 1]], "t,qx,qy,qz,qw"), {}, ("line 11", "1_0")),
    "a column that is missing": (table(rows(X), "t,a,b,c,d"), {"columns": {"qw": "e"}}, ("'e'", "a, b, c, d")),
    "an unknown column": (table(rows(X), "t,qx,qy,qz,qw"), {"columns": {"qv": "qx"}}, ("qv",)),
    "a part of a quaternion": (table(rows(X), "t,qx,qy,qz,d"), {"columns": {"qw": "d"}}, ("qx, qy, qz",)),
    "a column for two": (table(rows(X), "t,a,b,c,d"), {"columns": "qw=a,qx=a,qy=b,qz=c"}, ("once",)),
    "a quaternion without order": (table(rows(X), "stamp,a,b,c,d"), {"columns": OTHER}, ("wxyz", "xyzw")),
    "three of four": (
        table(rows(X), "t,a,b,c,d"),
        {"columns": {"quaternion": ["a", "b", "c"]}, "attitude": "xyzw"},
        ("4 columns",),
    ),
    "a part of the rates": (table(RATED, "t,u,wy,wz,qw,qx,qy,qz"), {"columns": {"wx": "u[rad/s]"}}, ("wy, wz",)),
    "columns for an AEM": (aem(), {"columns": {"t": "stamp"}}, ("columns", "AEM")),
    "a date twice": (
        table(DATES, "date,qw,qx,qy,qz", comment="# t = 0 at 2026-03-01T12:00:00 UTC"),
        {},
        ("dates", "comment"),
    ),
    "a direction of a comment": (
        table(rows(X), "t,qx,qy,qz,qw", comment="# attitude from the body, SC_BODY_1, to space, J2000; t in seconds"),
        {"direction": "space to body"},
        ("comment", "body to space"),
    ),
    "a quaternion in two units": (table(RATED, "t,a,b,qw [1],qw [-],qx,qy,qz"), {}, ("'qw'", "rename")),
    "an epoch that is none": (table(rows(X), "t,qx,qy,qz,qw", comment="# t = 0 at noon UTC"), {}, ("noon",)),
    "a unit at the end": (table(rows(X), "t_ms,qx,qy,qz,qw"), {"time_unit": "us"}, ("ms", "us", "time_unit")),
    "rates without a unit": (table(RATED, "t,wx,wy,wz,qw,qx,qy,qz"), {}, ("'wx'", "rates='rad/s'", "rates=False")),
    "rates in two units": (table(RATED, "t,wx [deg/s],wy [rad/s],wz,qw,qx,qy,qz"), {}, ("deg/s", "rad/s", "wz")),
    "rates in turns": (table(RATED, "t,wx [rpm],wy [rpm],wz [rpm],qw,qx,qy,qz"), {"rates": "rad/s"}, ("rpm", "wx")),
    "other rates": (
        table(RATED, "t,wx [deg/s],wy [deg/s],wz [deg/s],qw,qx,qy,qz"),
        {"rates": "rad/s"},
        ("deg/s", "rad/s"),
    ),
    "no rates": (table(rows(X), "t,qx,qy,qz,qw"), {"rates": "rad/s"}, ("wx",)),
    "a unit of rates": (table(RATED, "t,wx,wy,wz,qw,qx,qy,qz"), {"rates": "furlong"}, ("furlong",)),
    "a direction": (table(rows(X), "t,qx,qy,qz,qw"), {"direction": "inverse"}, ("inverse", "direction")),
    "names alone": ("t,qx,qy,qz,qw\n", {}, ("no rows",)),
    "comments alone": ("# nothing\n", {}, ("no rows",)),
    "nothing": ("", {}, ("empty",)),
    "a unit that may be another": (
        table(rows(X), "clock_h,qx,qy,qz,qw"),
        {"columns": {"time": "clock_h"}},
        ("'clock_h'", "clock_h[h]", "clock_h[s]"),
    ),
    "a unit beside time_unit": (
        table(rows(X), "clock_ms,qx,qy,qz,qw"),
        {"columns": {"time": "clock_ms"}, "time_unit": "s"},
        ("'ms'", "time_unit"),
    ),
    "an unknown group": (
        table(RATED, "t,wx,wy,wz,qw,qx,qy,qz"),
        {"columns": {"angular_velocity": ["wx", "wy", "wz"]}},
        ("'angular_velocity'", "time, quaternion, rates", "qw, wx"),
    ),
    "a segment": (table(rows(X), "t,qx,qy,qz,qw"), {"segment": 0}, ("segment",)),
    "Euler angles": (aem("EULER_ANGLE"), {}, ("EULER_ANGLE", "QUATERNION")),
    "two frames of space": (aem(REF_FRAME_B="ICRF"), {}, ("ICRF", "SC_BODY_1")),
    "no direction": (aem(**OLD, QUATERNION_TYPE="LAST"), {}, ("ATTITUDE_DIR",)),
    "an old keyword": (aem(QUATERNION_TYPE="FIRST"), {}, ("version 2.0", "last")),
    "a length": (aem(columns=2.0 * X), {}, ("line 16", "unit")),
    "columns": (aem(columns=SPUN), {}, ("line 16", "7 numbers")),
    "an order for an AEM": (aem(), {"attitude": "xyzw"}, ("attitude", "AEM")),
    "XML": ("<?xml version='1.0'?><aem/>", {}, ("XML",)),
    "no frame of rates": (aem("QUATERNION/ANGVEL", columns=SPUN), {}, ("ANGVEL_FRAME",)),
}


@pytest.mark.parametrize("case", WRONG)
def test_refused_logs(tmp_path, case):
    text, options, named = WRONG[case]
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with refused(ValueError, *named):
        A.read(path, **options)


def test_damaged_files_are_read_or_refused(tmp_path):
    """Bytes that are changed, cut, or put in: a ValueError of one line, and nothing else."""
    rng, path, outcomes = np.random.default_rng(9), tmp_path / "log.csv", set()
    texts = [aem(**AEM[case]) for case in AEM] + [text for text, _ in CSV.values()]
    parts = (b"nan", b"1e999", b"META_STOP\n", b"9" * 200, b'"', b"\x00", b"\xff", b"0001-01-01T00:00:00 ", b"\n", b",")
    for _ in range(200):
        content = bytearray(texts[rng.integers(len(texts))].encode())
        at, kind = int(rng.integers(len(content))), rng.integers(3)
        if kind == 0:
            content[at] = rng.integers(256)
        elif kind == 1:
            del content[at : at + int(rng.integers(1, 30))]
        else:
            content[at:at] = parts[rng.integers(len(parts))]
        path.write_bytes(content)
        try:
            log = A.read(path)
            assert np.isfinite(log.t).all() and np.isfinite(log.rotation.as_matrix()).all()
            outcomes.add("read")
        except ValueError as refusal:
            assert "\n" not in str(refusal)
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


def test_refused_writing(tmp_path):
    log = A.AttitudeLog(T, TURNED, **DATED)
    with refused(TypeError, "AttitudeLog"):
        A.write(tmp_path / "a.csv", TURNED)
    with refused(ValueError, "frame", "AEM"):
        A.write(tmp_path / "a.aem", A.AttitudeLog(T, TURNED, epoch="2026-03-01"))
    with refused(ValueError, "epoch", "AEM"):
        A.write(tmp_path / "a.aem", A.AttitudeLog(T, TURNED, frame="J2000"))
    with refused(ValueError, "object_name"):
        A.write(tmp_path / "a.aem", log, object_name="A\nDATA_STOP")
    with refused(Exception, ".csv", ".aem"):
        A.write(tmp_path / "a.txt", log)
    with refused(ValueError, "leap second"):
        A.write(tmp_path / "a.aem", A.AttitudeLog(T, TURNED, frame="J2000", epoch="2016-12-31T23:59:59"))
    with refused(ValueError, "ascend"):
        A.AttitudeLog(T[::-1], TURNED)
    with refused(ValueError, "9"):
        A.AttitudeLog(T, TURNED[:4])
    assert not [*tmp_path.iterdir()]


@pytest.mark.thinned(1)
@pytest.mark.parametrize("unit, size", [("s", 1.0), ("ms", 1e-3), ("ns", 1e-9), ("min", 60.0), ("h", 3600.0)])
def test_units_of_time_and_directions_of_tum(tmp_path, unit, size):
    """By the arguments alone, since the format says neither."""
    back, path = TURNED.inv().as_quat(), tmp_path / "log.tum"
    path.write_text(
        table([[t, 0.0, 0.0, 0.0, *q] for t, q in zip((T / size).tolist(), back.tolist(), strict=True)], None, " ")
    )
    log = A.read(path, time_unit=unit, direction="space to body")
    np.testing.assert_allclose(log.t, T, rtol=1e-11)
    assert (log.rotation * TURNED.inv()).magnitude().max() < CLOSE


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "unit, turns",
    [("rad/s", 0.5 / np.pi), ("deg/s", 1 / 360), ("rpm", 1 / 60), ("rev/s", 1), ("Hz", 1), ("deg/h", 1 / 1296000)],
)
def test_units_of_rates(tmp_path, unit, turns):
    """In revolutions per second; named by the argument or by the columns."""
    path, columns = tmp_path / "log.csv", RATED @ np.diag([1.0, *[0.5 / np.pi / turns] * 3, *[1.0] * 4])
    for names, options in (("wx,wy,wz", {"rates": unit}), (",".join(f"w{a} [{unit}]" for a in "xyz"), {})):
        path.write_text(table(columns.tolist(), f"t,{names},qw,qx,qy,qz"))
        np.testing.assert_allclose(A.read(path, **options).angular_velocity, OMEGA, rtol=1e-10)
