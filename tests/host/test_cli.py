"""The command line: bad input gives one line and exit code 2, and nothing is started or left behind."""

import json

import pytest

from noctule import bench, cli, settings


def run(capsys, *arguments):
    try:
        code = cli.main([str(a) for a in arguments])
    except SystemExit as error:
        code = error.code
    out = capsys.readouterr()
    return code, out.out, out.err


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert not (tmp_path / "runs").exists(), "bad input must not leave a run directory"


BAD = [
    (["fly", "no_such_world"], "no world 'no_such_world'"),
    (["fly", "missing.yaml"], "no such file"),
    (["fly", "maze_a", "--seed", "-1"], "--seed"),
    (["fly", "maze_a", "--seed", "x"], "--seed"),
    (["fly", "maze_a", "--max-time", "0"], "--max-time"),
    (["fly", "maze_a", "--max-time", "nan"], "--max-time"),
    (["fly", "maze_a", "--param", "speed_max_m_s"], "NAME=VALUE"),
    (["fly", "maze_a", "--param", "speed_max_ms=1"], "did you mean speed_max_m_s?"),
    (["fly", "maze_a", "--param", "speed_max_m_s=fast"], "not a number"),
    (["fly", "maze_a", "--param", "speed_max_m_s=nan"], "outside"),
    (["fly", "maze_a", "--param", "SPEED_MAX=99"], "outside 0.1 to 3 m/s"),
    (["fly", "maze_a", "--fault", "odometry-cut"], "NAME@SECONDS"),
    (["fly", "maze_a", "--fault", "gremlins@3"], "no such fault; there are"),
    (["fly", "maze_a", "--profile", "best"], "--profile"),
    (["fly", "maze_a", "--frobnicate"], "--frobnicate"),
    (["fly"], "WORLD"),
    (["bench", "nothing"], "no bench 'nothing'"),
    (["report", "nowhere"], "not a run directory"),
    (["compare", "a", "b"], "no report.json"),
    (["dance"], "dance"),
    ([], "COMMAND"),
]


@pytest.mark.parametrize("arguments, expected", BAD, ids=[" ".join(a) or "nothing" for a, _ in BAD])
def test_bad_input_is_one_line_and_exit_code_2(capsys, arguments, expected):
    code, out, err = run(capsys, *arguments)
    assert code == 2
    assert err.count("\n") == 1 and expected in err
    assert out == ""


@pytest.mark.parametrize("text, expected", [
    ("{", "JSON"),
    ("[]", "walls"),
    ('{"walls": [[0, 0, 1, 1]]}', "start"),
    ('{"walls": [[0, 0, 1]], "start": [0, 0]}', "walls[0]"),
    ('{"walls": [[0, 0, 4, 0]], "start": [1, 0.1]}', "start"),
])
def test_a_bad_plan_is_one_line_and_exit_code_2(capsys, tmp_path, text, expected):
    path = tmp_path / "plan.json"
    path.write_text(text)
    code, _, err = run(capsys, "fly", path)
    assert code == 2 and err.count("\n") == 1 and expected in err


def test_a_program_that_is_not_built_is_named_with_what_to_do(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("NOCTULE_BUILD", str(tmp_path))
    code, _, err = run(capsys, "fly", "maze_a", "--no-camera")
    assert code == 2 and "make build" in err


def test_an_out_directory_that_holds_a_run_is_not_overwritten(tmp_path):
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(settings.InputError, match="holds a run already"):
        settings.run_folder(settings.FlightSettings("maze_a", out=tmp_path), "maze_a")


def test_help_teaches_every_option_and_the_exit_codes(capsys):
    code, out, _ = run(capsys, "fly", "--help")
    assert code == 0
    for word in ("--seed", "--out", "--realtime", "--no-camera", "--max-time", "--param", "--preset", "--profile", "--fault",
                 "--log-images", "--autopilot-flavour", "exit code", "14550"):
        assert word in out


def test_worlds_lists_the_shipped_ones(capsys):
    code, out, _ = run(capsys, "worlds")
    assert code == 0
    for name in ("maze_a", "maze_b", "two_floor", "levels", "office"):
        assert any(line.startswith(name) for line in out.splitlines())


def test_a_parameter_is_set_by_name_or_by_id():
    assert settings.parse_parameter("SPEED_MAX=0.7") == ("speed_max_m_s", 0.7)
    values = settings.parameter_values(settings.FlightSettings("maze_a", parameters={"speed_max_m_s": 0.7}))
    assert values["speed_max_m_s"] == 0.7


def test_the_parameter_file_reads_back_as_the_same_table():
    import tomllib

    values = settings.parameter_values(settings.FlightSettings("maze_a", preset="paper"))
    back = tomllib.loads(settings.parameters_toml(values))
    assert back == values
    assert all(type(back[k]) is type(values[k]) for k in back)
    assert values != settings.parameter_values(settings.FlightSettings("maze_a"))


def test_a_broken_must_is_marked_and_a_missing_value_breaks_it():
    rows = [bench.row("a", 0.05, "m", None, "<= 0.08"), bench.row("b", None, "m", None, "<= 0.08"),
            bench.row("c", 0.9, "-", None, ">= 0.95"), bench.row("d", 1, "-")]
    assert [r["ok"] for r in bench.judged(rows)] == [True, False, False, None]
    assert bench.table(rows).count("MISSED") == 2
    assert set(json.loads(json.dumps(rows))[0]) == {"name", "value", "unit", "reference", "must", "aim"}


def test_a_flight_that_never_got_there_counts_as_its_longest_time():
    def flight(time_s):
        return {"floors": [{"time_to_95_s": time_s}], "max_time_s": 600.0}
    assert bench.mean_time([flight(100.0), flight(None)], "time_to_95_s") == 350.0
