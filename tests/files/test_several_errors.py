"""Files with several errors are refused with all of them: one message, or one line each from the command."""

import pytest

from coadjoint import cli
from coadjoint.errors import in_one_line
from coadjoint.files.configuration.construction import MAX_LINE_LENGTH, join_messages
from coadjoint.files.configuration.loading import ConfigurationError, load

FILE = """
[system]
name = "{name}"
[initial]
x = {x}
[method]
name = "{method}"
[run]
t_span = [0.0, {end}]
{step} = 0.125
"""
RIGHT = {"name": "rigid_body", "x": "[1.0, 0.1, 0.5]", "method": "Splitting", "end": "1.0", "step": "step"}
MISTAKES = {
    "name": ("rigid_bodi", "system: unknown system"),
    "x": ("[1.0, 0.1]", "initial.x: x0 has the shape (2,)"),
    "method": ("Spliting", "method: unknown method"),
    "end": ("1.01", "run: "),
}


def refused(tmp_path, text=FILE, **wrong):
    path = tmp_path / "run.toml"
    path.write_text(text.format(**{**RIGHT, **wrong}))
    with pytest.raises(ConfigurationError) as error:
        load(path)
    return str(error.value)


def test_three_errors_are_joined(tmp_path):
    message = refused(tmp_path, step="stepp", x='[1.0, "a", 0.5]', end='"late"')
    assert "run.stepp: unknown key; did you mean 'step'?" in message
    assert "initial.x: " in message and "run.t_span: must be a list of numbers, not [0.0, 'late']" in message
    assert "run.step: is missing" not in message and "\n" not in message and message.count("; and ") == 2


def test_misspelled_key_is_not_reported_as_missing(tmp_path):
    message = refused(tmp_path, FILE.replace("t_span", "t_spam"))
    assert message.endswith("run.toml: run.t_spam: unknown key; did you mean 't_span'?")


def test_unknown_system_beside_wrong_keys(tmp_path):
    message = refused(tmp_path, name="rigid_bodi", step="stepp", end='"late"')
    assert "system: unknown system 'rigid_bodi'; did you mean 'rigid_body'?" in message
    assert "run.stepp: " in message and "run.t_span: " in message


@pytest.mark.parametrize("wrong", [("x", "method", "end"), ("x", "end"), ("method", "end"), ("x", "method")])
def test_errors_of_the_system_are_joined(tmp_path, wrong):
    message = refused(tmp_path, **{key: MISTAKES[key][0] for key in wrong})
    assert all(MISTAKES[key][1] in message for key in wrong) and message.count("; and ") == len(wrong) - 1


def test_many_long_errors_stay_in_one_line():
    message = join_messages([f"key{k}: " + "long " * 100 for k in range(7)])
    assert (
        len(message) <= MAX_LINE_LENGTH + 30
        and message.endswith("; and 3 more")
        and all(f"key{k}" in message for k in range(4))
    )
    assert in_one_line(message) == message
    assert join_messages(["a", "a"]) == "a"


MANY = """
[system]
name = "heavy_top"
[system.parameters]
inertai = [1.0, 2.0, 3.0]
[initial]
x = [0.3, 0.2, 3.0, 0.6, 0.0]
[method]
name = "Splitting"
odrer = 4
[run]
t_span = [0, 10]
stepp = 0.3
save_evry = 10
[observe]
area = "x1*x9"
[events.flip]
g = "m9 + 1"
[output]
figur = "a.png"
"""


def lines_of(text, tmp_path, monkeypatch, capsys, *command):
    """Return the error lines of the command, without the name of the file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.toml").write_text(text)
    assert cli.main([*command, "run.toml"]) == 2
    message = capsys.readouterr()
    assert message.out == "" and all(line.startswith("run.toml: ") for line in message.err.splitlines())
    return [line.removeprefix("run.toml: ") for line in message.err.splitlines()]


MISPLACED = """
step = 0.1
[system]
name = "heavy_top"
levr = 2.0
[initial]
x = [0.3, 0.2, 3.0, 0.6, 0.0, 0.8]
t_span = [0.0, 1.0]
[method]
name = "Splitting"
lever = 2.0
save_every = 3
[run]
step = 0.1
t_span = [0.0, 1.0]
order = 4
method = "Splitting"
file = "a.nc"
"""


def test_unknown_keys_name_the_tables_to_which_they_belong(tmp_path, monkeypatch, capsys):
    assert set(lines_of(MISPLACED, tmp_path, monkeypatch, capsys, "run")) == {
        "step: unknown key; 'step' belongs to [run]",
        "system.levr: unknown key; did you mean 'lever', which belongs to [system.parameters]?",
        "initial.t_span: unknown key; 't_span' belongs to [run]",
        "method.lever: unknown key; 'lever' belongs to [system.parameters]",
        "method.save_every: unknown key; 'save_every' belongs to [run]",
        "run.order: unknown key; 'order' belongs to [method]",
        "run.method: unknown key; 'method' is a table of its own, [method]",
        "run.file: unknown key; 'file' belongs to [output]",
    }


def test_keys_of_named_states_name_their_tables(tmp_path, monkeypatch, capsys):
    text = MISPLACED.replace("x = [0.3, 0.2, 3.0, 0.6, 0.0, 0.8]", 'kind = "random"')
    text = text.replace("heavy_top", "sphere_euler").replace("levr = 2.0", "parameters = {N = 4}")
    text = "\n".join(line for line in text.splitlines() if not line.startswith(("step = 0.1", "lever", "method =")))
    lines = lines_of(text, tmp_path, monkeypatch, capsys, "run")
    assert "initial.t_span: unknown key; 't_span' belongs to [run]" in lines


@pytest.mark.parametrize("command", ["run", "check", "certify"])
def test_errors_of_all_stages_are_one_line_each(tmp_path, monkeypatch, capsys, command):
    lines = lines_of(MANY, tmp_path, monkeypatch, capsys, command)
    wanted = [
        "system.parameters.inertai: unknown key; did you mean 'inertia'?",
        "method.odrer: unknown key; did you mean 'order'?",
        "run.stepp: unknown key; did you mean 'step'?",
        "run.save_evry: unknown key; did you mean 'save_every'?",
        "output.figur: unknown key; did you mean 'figure'?",
        "run: step 0.3 does not divide",
        "initial.x: x0 has the shape (5,)",
        "observe.area: ",
        "events.flip: ",
    ]
    assert len(lines) == len(wanted)
    assert all(sum(line.startswith(one) for line in lines) == 1 for one in wanted)


@pytest.mark.parametrize(
    "line", [line for line in MANY.splitlines() if "=" in line and line[:4] not in ("name", "t_sp")]
)
def test_each_error_alone_is_one_line(tmp_path, monkeypatch, capsys, line):
    right = {
        "inertai": "inertia = [1.0, 2.0, 3.0]",
        "x = [": "x = [0.3, 0.2, 3.0, 0.6, 0.0, 0.8]",
        "odrer": "order = 4",
        "stepp": "step = 0.25",
        "save_evry": "save_every = 10",
        "area": 'area = "x1*x2"',
        "g = ": 'g = "m1"',
        "figur": 'figure = "a.png"',
    }
    text = MANY
    for key, mended in right.items():
        wrong = next(one for one in MANY.splitlines() if one.startswith(key))
        text = text if wrong == line else text.replace(wrong, mended)
    # A misspelled step is read as the step, and does not divide the span: two errors.
    assert len(lines_of(text, tmp_path, monkeypatch, capsys, "check")) == (2 if line.startswith("stepp") else 1)


@pytest.mark.parametrize(
    ("table", "wrong", "reported"),
    [
        ("initial", 'x = "one"', ["initial.x: must be", "method: unknown", "run: step"]),
        ("run", 't_span = "late"\nstep = 0.3', ["initial.x: x0", "method: unknown", "run.t_span: must be"]),
        ("system", "name = 3", ["method: unknown", "run: step", "system.name: must be"]),
        (
            "system",
            'name = "rigid_bodi"\nparameters = 3',
            ["method: unknown", "run: step", "system.parameters: must be", "system: unknown system 'rigid_bodi'"],
        ),
        ("output", "file = 3", ["initial.x: x0", "method: unknown", "output.file: must be", "run: step"]),
    ],
)
def test_invalid_table_hides_no_other_error(tmp_path, monkeypatch, capsys, table, wrong, reported):
    tables = {
        "system": 'name = "rigid_body"',
        "initial": "x = [1.0, 0.1]",
        "method": 'name = "Spliting"',
        "run": "t_span = [0, 10]\nstep = 0.3",
        table: wrong,
    }
    lines = lines_of(
        "\n".join(f"[{key}]\n{content}" for key, content in tables.items()), tmp_path, monkeypatch, capsys, "run"
    )
    assert len(lines) == len(reported) and all(
        line.startswith(one) for line, one in zip(sorted(lines), reported, strict=True)
    )


def test_misspelled_key_beside_the_right_one(tmp_path, monkeypatch, capsys):
    text = FILE.format(**RIGHT).replace("step = 0.125", "step = 0.3\nstepp = 0.125")
    lines = lines_of(text, tmp_path, monkeypatch, capsys, "check")
    assert (
        len(lines) == 2 and lines[0].startswith("run.stepp: ") and lines[1].startswith("run: step 0.3 does not divide")
    )


def test_errors_of_a_sweep_and_of_the_file(tmp_path, monkeypatch, capsys):
    text = FILE.format(**RIGHT).replace("Splitting", "Spliting")
    text += '[sweep.over]\n"initial.x[7]" = [1.0, 2.0]\n"initial.x[2]" = [1.0, "a"]\n"run.step" = [0.1]\n'
    lines = lines_of(text, tmp_path, monkeypatch, capsys, "check")
    assert lines[-1].startswith("method: unknown method 'Spliting'") and len(lines) > 1
    text = text.replace('[1.0, "a"]', "[1.0, 2.0]").replace('"initial.x[7]"', '"system.nam"')
    lines = lines_of(text, tmp_path, monkeypatch, capsys, "check")
    assert [line.split(": ")[0] for line in lines] == ["sweep.over.system.nam", "sweep.over.run.step", "method"]


def test_number_of_reported_errors_is_limited(tmp_path, monkeypatch, capsys):
    text = FILE.format(**RIGHT) + "".join(f"key{k} = {k}\n" for k in range(30))
    lines = lines_of(text, tmp_path, monkeypatch, capsys, "check")
    assert len(lines) == 21 and lines[-1] == "10 more" and len(set(lines)) == 21


# Keys as in Python, or as people call them, and where they belong in a file.
MEANT = {
    "[run] x0 = [1.0, 0.1, 0.5]": "run.x0: unknown key; give [initial] x",
    "[run] y0 = [1.0, 0.1, 0.5]": "run.y0: unknown key; give [initial] x",
    "[run] dt = 0.1": "run.dt: unknown key; give [run] step",
    "[run] t_end = 2.0": "run.t_end: unknown key; give [run] t_span",
    "[run] duration = 2.0": "run.duration: unknown key; give [run] t_span",
    "[run] rtol = 1e-6": "run.rtol: unknown key; give [run] accuracy",
    "[run] saveat = [0.5]": "run.saveat: unknown key; give [run] t_eval",
    "[run] every = 2": "run.every: unknown key; give [run] save_every",
    "[run] n_jobs = 2": "run.n_jobs: unknown key; give [run] threads",
    '[run] integrator = "Splitting"': "run.integrator: unknown key; give [method] name",
    '[run] plot = "a.png"': "run.plot: unknown key; give [output] figure",
    '[run] out = "a.nc"': "run.out: unknown key; give [output] file",
    '[run] animation = "a.mp4"': "run.animation: unknown key; give [output] movie",
    "[run] observables = 1": "run.observables: unknown key; give [observe] NAME",
    "[run] event = 1": "run.event: unknown key; give [events.NAME] g",
    "[run] ensemble = 10": "run.ensemble: unknown key; give [sweep] samples",
    "[initial] x0 = [1.0, 0.1, 0.5]": "initial.x0: unknown key; give [initial] x",
    "[system] params = 1": "system.params: unknown key; give [system.parameters]",
    "[system] inertia = [1, 2, 3]": "system.inertia: unknown key; 'inertia' belongs to [system.parameters]",
    '[system] H = "x1"': "system.H: unknown key; give [hamiltonian] polynomial",
}


@pytest.mark.parametrize("line", MEANT)
def test_keys_under_other_names_are_answered_with_their_place(tmp_path, line):
    """Alone, beside the right key, and in its place: one message."""
    table, _, key = line.partition(" ")
    known = {"x0": "x = ", "y0": "x = ", "dt": "step = ", "t_end": "t_span = ", "duration": "t_span = "}
    text = FILE.format(**RIGHT)
    replaced = [part for part in text.split("\n") if not part.startswith(known.get(key.split(" ")[0], "never"))]
    for lines in (text.split("\n"), replaced):
        changed = "\n".join(f"{part}\n{key}" if part == table else part for part in lines)
        path = tmp_path / "run.toml"
        path.write_text(changed)
        with pytest.raises(ConfigurationError) as refused:
            load(path)
        message = str(refused.value)
        if lines is replaced and line.startswith("[run]"):
            message = message.removesuffix("; and initial: x is missing; give it, or the kind of an initial state")
        assert message == f"{path}: {MEANT[line]}"


def test_keys_of_the_top_and_names_for_tables(tmp_path):
    text = FILE.format(**RIGHT)
    for changed, message in (
        (f"dt = 0.1\n{text}", "dt: unknown key; give [run] step"),
        (f"x0 = [1.0, 0.1, 0.5]\n{text}", "x0: unknown key; give [initial] x"),
        (
            'system = "rigid_body"\n' + text.replace('[system]\nname = "rigid_body"\n', ""),
            "system: must be a table, not 'rigid_body'; give [system] name",
        ),
        (
            'method = "Splitting"\n' + text.replace('[method]\nname = "Splitting"\n', ""),
            "method: must be a table, not 'Splitting'; give [method] name",
        ),
    ):
        path = tmp_path / "run.toml"
        path.write_text(changed)
        with pytest.raises(ConfigurationError) as refused:
            load(path)
        assert str(refused.value) == f"{path}: {message}"


def test_every_place_exists():
    from coadjoint.files.configuration.models import OTHER_NAMES, PLACES, File, known_keys

    for place in PLACES.values():
        table, _, key = place.partition(" ")
        path = table.strip("[]").split(".")
        assert path[0] in File.model_fields
        if path[0] in ("initial", "run", "output", "hamiltonian", "system") and path[1:] == []:
            assert key in known_keys(path), place
    assert set(OTHER_NAMES.values()) <= set(PLACES)
