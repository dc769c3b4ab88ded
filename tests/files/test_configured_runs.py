"""Keys of configuration files reach the run, the archive, the estimates and the dry run."""

import dataclasses
import inspect
import types

import numpy as np
import pytest
from configuration_files import OWN, READY_MADE

import coadjoint as co
from coadjoint import cli
from coadjoint.files.configuration import configuration as configurations
from coadjoint.files.configuration import dry_run as planning
from coadjoint.files.configuration import loading
from coadjoint.files.configuration.configuration import CONFIGURATION
from coadjoint.files.configuration.dry_run import plan
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.datasets.content_checksum import CHECKSUM
from coadjoint.files.datasets.export import rebuild
from coadjoint.runs import prepared_run
from coadjoint.runs.times import times_of

FULL = """
[system]
name = "rigid_body"
[system.parameters]
inertia = [1.0, 2.0, 2.5]
[initial]
x = [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3], [0.1, -0.2, 1.0], [0.3, 0.4, -1.0]]
attitude = true
[method]
name = "Splitting"
order = 4
[run]
t_span = [2, -1]
step = 0.125
save_every = 3
watch = false
threads = 2
[observe]
"x1 x2" = "x1*x2"
[output]
file = "a.nc"
figure = "a.png"
movie = "a.gif"
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def load_text(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "run.toml").write_text(text)
        return load("run.toml")

    return load_text


def test_every_key_is_in_the_configuration(read):
    found = read(FULL, ("threads = 2", "threads = 2\nworkers = 3"))
    assert found.system.parameters == {"inertia": (1.0, 2.0, 2.5)} and np.shape(found.x0) == (4, 3)
    assert (found.t_span, found.step, found.save_every) == ((2.0, -1.0), 0.125, 3)
    assert (found.threads, found.workers, found.watch, found.attitude) == (2, 3, False, True)
    assert (found.output, found.archive, found.figure, found.movie) == ("a.nc", None, "a.png", "a.gif")
    assert list(found.observe) == ["x1 x2"] and found.method == co.Splitting(order=4)
    assert (found.t_eval, found.events, found.choice, found.swept) == (None, (), None, {})
    assert read(READY_MADE + '[output]\narchive = "a.zarr"\n').archive == "a.zarr"


def test_every_setting_reaches_the_run(read, monkeypatch):
    """Distinct values show settings that are dropped or exchanged."""
    found = read(FULL)
    given = {}
    monkeypatch.setattr(configurations, "with_choice", lambda solution, choice: (solution, choice))
    monkeypatch.setattr(configurations.Configuration, "check_memory", lambda self: None)
    values = {field.name: f"the {field.name}" for field in dataclasses.fields(found) if field.name != "workers"}
    marked = dataclasses.replace(found, **values)

    def spy(name, wanted):
        def call(*arguments, **kwargs):
            given[name] = inspect.signature(wanted).bind(*arguments, **kwargs).arguments
            return name

        return call

    monkeypatch.setattr(configurations, "integrate", spy("integrate", co.integrate))
    monkeypatch.setattr(prepared_run, "PreparedRun", spy("ready", prepared_run.PreparedRun))
    assert marked.integrate(progress="the progress") == ("integrate", "the choice") and marked.ready() == "ready"
    for keys in given.values():
        assert keys == {key: f"the {key}" for key in keys}
    assert {"attitude", "watch", "observe", "threads", "system", "method", "step"} == set(given["ready"])
    assert set(given["integrate"]) == set(given["ready"]) | {
        "x0", "t_span", "save_every", "t_eval", "events", "progress"
    }  # fmt: skip


def test_archive_contains_the_whole_run(read, tmp_path, capsys):
    over = '[sweep.over]\n"system.parameters.inertia[2]" = [2.5, 2.25]\n"initial.x[0]" = [1.0, 0.5]\n'
    found = read(FULL + over, (
        "x = [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3], [0.1, -0.2, 1.0], [0.3, 0.4, -1.0]]", "x = [1.0, 0.1, 0.5]"
    ))  # fmt: skip
    sol = found.integrate()
    stored = found.integrate(archive=tmp_path / "run.zarr", progress=True)
    assert "steps (100 %)" in capsys.readouterr().err
    for name in ("t", "x", "energy", "attitude"):
        assert np.array_equal(getattr(stored, name), getattr(sol, name))
    assert stored.t.tolist() == [2.0 - 0.375 * k for k in range(9)] and not stored.watched
    assert np.array_equal(stored.observed["x1 x2"], sol.x[..., 0] * sol.x[..., 1])
    again = co.open_archive(tmp_path / "run.zarr").to_xarray()
    assert again["swept_inertia_2"].values.tolist() == [2.5, 2.5, 2.25, 2.25]
    assert again["swept_x_0"].values.tolist() == sol.x[0, :, 0].tolist() == [1.0, 0.5] * 2
    assert again.attrs[CONFIGURATION] == found.text == (tmp_path / "run.toml").read_text()


@pytest.mark.parametrize(
    "lines", ["t_eval = [0.25, 0.5]\n", '[events.flip]\ng = "x2"\n', 't_eval = [0.5]\n[events.flip]\ng = "x2"\n']
)
def test_options_without_archive_support_are_refused(read, tmp_path, lines):
    with pytest.raises(ConfigurationError, match=r"^run.toml: (run.t_eval|events): an archive"):
        read(READY_MADE + lines).integrate(archive=tmp_path / "run.zarr")
    assert cli.main(["run", "run.toml", "--archive", "run.zarr"]) == 2
    assert not (tmp_path / "run.zarr").exists()
    with pytest.raises(ConfigurationError, match="an archive"):
        read(READY_MADE + lines + '[output]\narchive = "run.zarr"\n')


MANY = "x = [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3]]"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ((), "one state"),
        ((("x = [1.0, 0.1, 0.5]", MANY), ("workers = 2", "workers = 2\nt_eval = [0.5]")), "neither t_eval nor"),
        ((("x = [1.0, 0.1, 0.5]", MANY), ("workers = 2", 'workers = 2\n[events.flip]\ng = "x1"')), "neither t_eval"),
        ((("x = [1.0, 0.1, 0.5]", MANY), ("workers = 2", "workers = 0")), "must be 1 or more, not 0"),
    ],
)
def test_workers_require_members_saved_at_steps(read, changes, message):
    with pytest.raises(ConfigurationError, match=f"^run.toml: run.workers: .*{message}"):
        read(READY_MADE + "workers = 2\n", *changes)
    assert read(READY_MADE + "workers = 2\n", ("x = [1.0, 0.1, 0.5]", MANY)).workers == 2


def test_workers_require_their_package(read, monkeypatch):
    needed = []
    monkeypatch.setattr(loading, "require_packages", lambda feature, *packages: needed.append((feature, packages)))
    read(READY_MADE + "workers = 2\n", ("x = [1.0, 0.1, 0.5]", MANY))
    assert ("workers", ("distributed",)) in needed


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (("save_every = 3", "save_every = 1"),),
        (("attitude = true", "attitude = false"),),
        (("save_every = 3", "t_eval = [1.9, 1.5, 0.2, -0.3]"),),
        (('"x1 x2" = "x1*x2"', "\n".join(f'o{k} = "x1*x2"' for k in range(9))),),
    ],
    ids=["all", "every step", "no attitude", "times", "observed"],
)
def test_memory_check_covers_the_saved_arrays(read, monkeypatch, changes):
    """Less memory than the saved arrays is refused; three times as much is enough."""
    found = read(FULL, *changes)
    sol = found.integrate()
    saved = [sol.x, sol.energy, *sol.casimirs.values(), *sol.observed.values()]
    needed = sum(array.nbytes for array in saved) + (0 if sol.attitude is None else sol.attitude.nbytes)
    monkeypatch.setattr(configurations, "available", lambda: needed - 1)
    for start in (found.integrate, lambda: plan(found)):
        with pytest.raises(ConfigurationError, match=r"^run.toml: run.save_every: the saved states do not fit"):
            start()
    monkeypatch.setattr(configurations, "available", lambda: 3 * needed)
    found.check_memory()


def test_dataset_contains_the_configuration(read):
    found = read(READY_MADE)
    sol = found.integrate()
    dataset = found.dataset(sol)
    assert CHECKSUM in sol.to_xarray().attrs and CHECKSUM not in dataset.attrs
    assert dataset.attrs[CONFIGURATION] == READY_MADE
    assert {key: value for key, value in dataset.attrs.items() if key != CONFIGURATION} == {
        key: value for key, value in sol.to_xarray().attrs.items() if key != CHECKSUM
    }


def test_accuracy_with_attitude_is_chosen_for_both(read):
    text = READY_MADE.replace("step = 0.1", "accuracy = 1e-6").replace("0.5]", "0.5]\nattitude = true")
    found, body = read(text), co.systems.rigid_body((1.0, 2.0, 2.5))
    x0, span, method = (1.0, 0.1, 0.5), (0.0, 1.0), co.Splitting(order=4)
    assert found.choice == co.choose(body, x0, span, 1e-6, methods=method, attitude=True)
    assert found.choice.cost > co.choose(body, x0, span, 1e-6, methods=method).cost


# Hamiltonians, algebras and their parts.


def test_quadratic_energy_terms(read):
    x = np.array([1.0, 2.0, 4.0])
    for lines, energy in (
        ("M = 2.0", x @ x),
        ("M = [1, 0.5, 0.25]\nconstant = -2.5", 1.5 + 2.0 - 2.5),
        ("linear = [1, 2, 3]", 17.0),
        ("linear = [1, 2, 3]\nconstant = 1", 18.0),
        ("M = [[0, 1, 0], [1, 0, 0], [0, 0, 2]]\nlinear = [0, 0, 1]", 2.0 + 16.0 + 4.0),
    ):
        assert read(OWN, ("M = [1.0, 0.5, 0.25]", lines)).system.energy(x) == energy
    for key in ("M = 1.0", "linear = [0, 0, 1]", "constant = 1.0"):
        with pytest.raises(ConfigurationError, match=rf"hamiltonian.{key.split()[0]}: is given with polynomial"):
            read(OWN, ("M = [1.0, 0.5, 0.25]", f'polynomial = "x1^2"\n{key}'))


def test_basis_names(read):
    names = 'basis = ["a", "b", "c"]\nbrackets = ["[a, b] = c", "[b, c] = a", "[c, a] = b"]'
    text = OWN.replace('brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]', names)
    for lines in (text, text.replace("dim = 3\n", "")):
        found = read(lines)
        assert found.system.algebra.basis == ("a", "b", "c") and found.system.algebra.dim == 3


@pytest.mark.parametrize("casimirs", [None, "", '"|x|^2" = "x1^2 + x2^2 + x3^2"'])
def test_casimirs_are_computed_only_by_default(read, casimirs):
    table = '[casimirs]\n"|x|^2" = "x1^2 + x2^2 + x3^2"\n'
    found = read(OWN, (table, "" if casimirs is None else f"[casimirs]\n{casimirs}\n"))
    wanted = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25])).casimirs
    assert len(found.system.casimirs) == (len(wanted) if casimirs is None else bool(casimirs))


@pytest.mark.parametrize(
    ("text", "changes", "message"),
    [
        (READY_MADE, [("[system]", 'name = "a"\n[system]')], "name: belongs to [algebra]"),
        (READY_MADE, [("[initial]", "[hamiltonian]\nM = 1.0\n[initial]")], "hamiltonian: belongs to [algebra]"),
        (READY_MADE, [("[initial]", '[casimirs]\na = "x1"\n[initial]')], "casimirs: belongs to [algebra]"),
        (OWN, [("dim = 3\n", 'name = "so(3)"\ndim = 3\n')], "algebra.name: is for an algebra of the catalogue; "),
        (OWN, [("brackets = ", "parameters = "), ('["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]', "{}")],
         "algebra.brackets: is missing; give it with dim, or a name"),
        (OWN, [("dim = 3\n", 'basis = ["a", "b", "c"]\n'),
               ('brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]', "")],
         "algebra.brackets: is missing; give it with basis, or a name"),
        (OWN, [("dim = 3", "dim = 4")], "initial.x: x0 has the shape (3,); it must be (4,) or (members, 4)"),
        (OWN, [("dim = 3", "dim = 4"), ("[1.0, 0.1, 0.5]", "[[1.0, 0.1, 0.5]]")], "initial.x: x0 has the shape (1, 3)"),
        (READY_MADE, [("order = 4", "zzzzz = 4")], "method.zzzzz: unknown key; known here: adjoint, compensated, "),
        (READY_MADE, [("step = 0.1", "step = inf")], "run: step is inf; it must be finite"),
        (READY_MADE, [("step = 0.1", "accuracy = 1.0")], "run.accuracy: input should be less than 1, not 1.0"),
        (READY_MADE, [("[1.0, 0.1, 0.5]", "[1.0, true, 0.5]")], "initial.x: must be a list of numbers"),
        (READY_MADE, [("[1.0, 0.1, 0.5]", "[[1.0, 0.1, 0.5], [[1.0], [0.1], [0.5]]]")], "initial.x: must be a list "),
        (READY_MADE, [("[1.0, 0.1, 0.5]", "[[[1.0, 0.1], [0.5, 1.0]], [[1.0, 0.1]]]")], "initial.x: must be a list "),
        (READY_MADE, [("0.5]", '0.5]\nparameters = {seed = 1}')], "initial: parameters belong to a kind"),
    ],
)  # fmt: skip
def test_errors_have_the_key(read, text, changes, message):
    with pytest.raises(ConfigurationError) as error:
        read(text, *changes)
    assert str(error.value).startswith(f"run.toml: {message}"), str(error.value)
    assert "parameters, " not in str(error.value) and ", name" not in str(error.value)


def test_dimension_check_allows_states_in_a_file(read, tmp_path):
    np.save(tmp_path / "x.npy", [1.0, 0.1, 0.5])
    assert read(OWN, ("[1.0, 0.1, 0.5]", '"x.npy"')).x0.tolist() == [1.0, 0.1, 0.5]
    np.save(tmp_path / "x.npy", np.array([True, False, True]))
    with pytest.raises(ConfigurationError, match=r"initial.x: 'x.npy' holds no array of numbers"):
        read(OWN, ("[1.0, 0.1, 0.5]", '"x.npy"'))


def test_named_state_with_an_attitude(read):
    text = (
        'system = {name = "torus_euler", parameters = {N = 3}}\ninitial = {kind = "random", seed = 1, attitude = A}\n'
    )
    text += "run = {t_span = [0, 1], step = 0.5}\n"
    assert read(text.replace("A}", "false}")).attitude is False
    with pytest.raises(ConfigurationError, match=r"run.toml: initial.attitude: must be true, false"):
        read(text.replace("A}", '"yes"}'))


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("x is wrong"), "x is wrong"),
        (TypeError("x\nis wrong"), "x is wrong"),
        (ZeroDivisionError("division by zero"), "a number is too large, or too small, to compute with (division"),
        (OverflowError("huge"), "a number is too large, or too small, to compute with (huge)"),
        (RecursionError("deep"), "lists or tables are nested too deeply"),
        (MemoryError(), "does not fit into memory"),
    ],
)
def test_errors_in_a_section_have_its_key(error, message):
    with pytest.raises(ConfigurationError) as raised, configurations.section("run.toml", "forces[1]"):
        raise error
    assert str(raised.value).startswith(f"run.toml: forces[1]: {message}") and raised.value.__cause__ is error
    own = ConfigurationError("run.toml: run.step: step is 0")
    with pytest.raises(ConfigurationError) as raised, configurations.section("run.toml", "forces[1]"):
        raise own
    assert raised.value is own


# Dry runs.


def test_plan_describes_the_run(read):
    found = plan(read(FULL))
    sol = found.configuration.integrate()
    assert (found.dim, found.members) == (3, 4)
    saved = [sol.x, sol.attitude, sol.energy, *sol.casimirs.values()]
    assert found.memory >= sum(array.nbytes for array in saved)
    assert found.preparation_seconds > 0.0 and found.seconds > 0.0
    example = dataclasses.replace(
        found, preparation_seconds=60.0, seconds=30.0, memory=7_000_000, written=59_300, tried=5
    )
    lines = dict(line.split(maxsplit=1) for line in str(example).splitlines())
    assert list(lines) == ["system", "members", "scheme", "keeps", "steps", "saved", "memory", "output", "time"]
    assert lines["system"] == "rigid_body, dimension 3" and lines["members"] == "4"
    assert lines["steps"] == "24 of 0.125, from t = 2 to -1" and lines["saved"] == "9 points of 4 members"
    assert lines["memory"].startswith("7 MB, ") and lines["memory"].endswith(" are free")
    assert lines["output"] == "59 kB before compression; to a.nc, a.png, a.gif"
    assert (
        lines["time"] == "about 1.5 minutes; estimated from a trial of 5 of its steps, 1 minutes of it for preparation"
    )
    archived = dataclasses.replace(example.configuration, archive="a.zarr", output=None, figure=None, movie=None)
    assert str(dataclasses.replace(example, configuration=archived)).splitlines()[7].endswith("compression; to a.zarr")
    nowhere = dataclasses.replace(archived, archive=None)
    assert "; the file names no output" in str(dataclasses.replace(example, configuration=nowhere))
    assert "so that nothing can be written" in str(dataclasses.replace(example, written=None))


def test_plan_of_a_sweep_names_the_swept_keys(read):
    more = '[sweep.over]\n"system.parameters.inertia[2]" = [2.5, 2.25]\n"initial.x[0]" = [1.0, 0.5, 0.25]\n'
    lines = dict(line.split(maxsplit=1) for line in str(plan(read(READY_MADE + more))).splitlines())
    assert lines["system"] == "rigid_body, dimension 3; 6 systems, one for each member"
    assert lines["swept"] == "system.parameters.inertia[2], initial.x[0]" and lines["members"] == "6"


def test_plan_of_a_chosen_step_and_of_forces(read):
    found = plan(read(READY_MADE, ("step = 0.1", "accuracy = 1e-6")))
    choice = found.configuration.choice
    assert f"Splitting(order=4), of order 4; chosen, expected error {choice.error:.1e}\n" in str(found)
    found = plan(read(READY_MADE + '[[forces]]\nname = "LinearDamping"\nrate = 0.1\n'))
    assert found.properties.broken_by == ("Poisson map: LinearDamping", "Casimirs: LinearDamping")
    assert "broken by forces (Poisson map: LinearDamping, Casimirs: LinearDamping)" in str(found)


def test_trial_run_detects_events(read):
    found = read(READY_MADE + '[events.zero]\ng = "x1 - 0.99"\n')
    ready, times = found.ready(), times_of(found.t_span, found.step, found.save_every)
    assert planning._trial_run(found, ready, times, 4, 1).events.names == ("zero",)


def test_trial_run_grows_until_it_is_long_enough(read, monkeypatch):
    """Trials of 0.15 s, each with at least twice the steps of the previous one, and one of a second."""
    clock, tried = [0.0], []

    def short_run(configuration, ready, times, steps, every, short=planning._trial_run):
        clock[0] += 0.15 if len(tried) < 3 else 1.0
        tried.append(steps)
        return short(configuration, ready, times, steps, every)

    monkeypatch.setattr(planning, "_trial_run", short_run)
    monkeypatch.setattr(planning, "time", types.SimpleNamespace(perf_counter=lambda: clock[0]))
    found = plan(read(READY_MADE, ("[0, 1]", "[0, 100]")))
    assert tried[:4] == [1, 2, 4, 8] and found.tried == 8


# Accuracy and output times.

ACCURATE = READY_MADE.replace("step = 0.1", "accuracy = 1e-8")
BODY, X0 = co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.1, 0.5)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", [None, co.Splitting(order=4)])
@pytest.mark.parametrize("span", [(0, 1), (1, -2)])
def test_accuracy_gives_the_bits_of_python(read, method, span):
    without = () if method else (('[method]\nname = "Splitting"\norder = 4\n', ""),)
    found = read(ACCURATE, ("[0, 1]", str(list(span))), *without)
    sol, expected = found.integrate(), co.integrate(BODY, X0, span, accuracy=1e-8, method=method)
    assert (found.step, found.method) == (expected.step, expected.method) and sol.choice == expected.choice
    assert sol.x.tobytes() == expected.x.tobytes()
    assert np.linalg.norm(sol.x[-1] - BODY.exact(X0, float(span[1] - span[0]))) < 1e-8


def test_accuracy_with_an_archive(read, tmp_path):
    found = read(ACCURATE)
    sol = found.integrate(archive=tmp_path / "run.zarr")
    assert np.asarray(sol.x).tobytes() == found.integrate().x.tobytes() and sol.choice is found.choice is not None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (READY_MADE.replace("step = 0.1", ""), "run: step is missing; give step, or accuracy"),
        (READY_MADE.replace("step = 0.1", "step = 0.1\naccuracy = 1e-8"), "run: step and accuracy"),
        (ACCURATE.replace("1e-8", "1.5"), "run.accuracy: "),
        (ACCURATE.replace("1e-8", "1e-19"), "run.accuracy: "),
        (ACCURATE.replace("1e-8", "1e-8\nt_eval = [2.0]"), "run: "),
        (ACCURATE + '[sweep.over]\n"system.parameters.inertia[2]" = [2.5, 3.0]\n', "run.accuracy: .*batch"),
    ],
)
def test_invalid_accuracy_is_refused(read, text, message):
    with pytest.raises(ConfigurationError, match=message):
        read(text)


TIMED = READY_MADE.replace("0.5]", "0.5]\nattitude = true").replace("[0, 1]", "[0, 10]")


def test_output_times_of_a_file(read):
    found = read(TIMED + "t_eval = [0.25, 3, 9.99]\n").integrate()
    expected = co.integrate(BODY, X0, (0, 10), 0.1, co.Splitting(order=4), attitude=True, t_eval=[0.25, 3, 9.99])
    assert np.array_equal(found.t, [0.25, 3, 9.99]) and np.array_equal(found.x, expected.x)
    assert np.array_equal(found.attitude, expected.attitude)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("t_eval = [11]", r"run: t_eval\[0\] is 11; .*t_span"),
        ("t_eval = [3, 2]", r"run: t_eval\[1\] is 2 .*3"),
        ("t_eval = [3]\nsave_every = 2", "run: .*save_every and t_eval"),
        ("t_eval = 3", "run.t_eval: must be a"),
        ("t_eval = []", "run"),
    ],
)
def test_invalid_output_times_are_refused(read, line, message):
    with pytest.raises(ConfigurationError, match=message):
        read(TIMED + line)


def test_dataset_with_output_times_is_rebuilt():
    times = np.array([0.33, 0.5, 1.77])
    for x0 in ((1.0, 0.1, 0.5), [(1.0, 0.1, 0.5), (0.1, 1.0, 0.5)]):
        sol = co.integrate(BODY, x0, (0, 2), 0.1, co.Splitting(order=4), attitude=True, t_eval=times)
        data = sol.to_xarray()
        assert np.array_equal(data["time"], times) and np.array_equal(data["x0"], sol.x0)
        assert np.array_equal(data["attitude0"], sol.attitude0)
        again = rebuild(data)
        assert np.array_equal(again.x, sol.x) and np.array_equal(again.t, times)
        assert np.array_equal(again.attitude, sol.attitude) and again.drift() == sol.drift()


def test_times_that_are_sums_of_steps(read):
    """They are accepted up to their rounding in a file too, and refused beyond it with the digits that differ."""
    sums = [0.0, *np.cumsum(np.full(3000, 0.01)).tolist()]
    assert sums[-1] > 30.0
    expected = co.integrate(read(READY_MADE).system, (1.0, 0.1, 0.5), (0, 30), 0.01, co.Splitting(order=4))
    for lines in (f"t_span = [0, {sums[-1]!r}]\nstep = 0.01", f"t_span = [0, 30]\nstep = 0.01\nt_eval = {sums}"):
        found = read(READY_MADE, ("t_span = [0, 1]\nstep = 0.1", lines))
        solution = found.integrate()
        assert np.array_equal(solution.x[-1], expected.x[-1]) and len(solution.t) == 3001
        assert "3000 of 0.01, from t = 0 to 30" in str(plan(found))
    for lines, message in (
        ("t_span = [0, 30.0000000003]\nstep = 0.01", "step 0.01 does not divide the time 30.0000000003"),
        (
            "t_span = [0, 30]\nstep = 0.01\nt_eval = [1, 30.0000000003]",
            "t_eval[1] is 30.0000000003; it must lie within t_span, from 0 to 30",
        ),
    ):
        with pytest.raises(ConfigurationError) as refused:
            read(READY_MADE, ("t_span = [0, 1]\nstep = 0.1", lines))
        assert message in str(refused.value)
