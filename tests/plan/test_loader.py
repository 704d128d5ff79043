"""Every fault of a file becomes one sentence with the right file and line."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_folder import PLANS

from mbcacq.errors import ConfigError
from mbcacq.plan import load

FAULTS = {
    "unknown key": ([("  driver: kuka_rsi", "  driver: kuka_rsi\n  sped: 0.3")], "plan.yaml:5: unknown key 'sped'; correct or remove it"),
    "unknown key deep": (
        [("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 20, azimut_deg: 30}")],
        "plan.yaml:24: unknown key 'azimut_deg'; correct or remove it",
    ),
    "missing key": ([("  driver: kuka_rsi\n", "")], "plan.yaml:3: robot lacks 'driver'"),
    "text for a number": (
        [("tilt_deg: 20", "tilt_deg: steep")],
        "plan.yaml:24: steps[0].views[0].tilt_deg: input should be a valid number, not 'steep'",
    ),
    "quoted number": (
        [("tilt_deg: 20", "tilt_deg: '20'")],
        "plan.yaml:24: steps[0].views[0].tilt_deg: input should be a valid number, not '20'",
    ),
    "yes for a number": (
        [("tilt_deg: 20", "tilt_deg: yes")],
        "plan.yaml:24: steps[0].views[0].tilt_deg: input should be a valid number, not True",
    ),
    "out of range": ([("tilt_deg: 20", "tilt_deg: 95")], "plan.yaml:24: steps[0].views[0].tilt_deg: input should be less than 90, not 95"),
    "not finite": ([("[1, -0.5, 265]", "[1, .nan, 265]")], "plan.yaml:13: hand_eye.translation_mm[1] is .nan, not a finite number"),
    "infinite": (
        [("[600, 0, 150]", "[600, -.inf, 150]")],
        "plan.yaml:16: stations[0].pose_in_base.translation_mm[1] is -.inf, not a finite number",
    ),
    "duplicate key": (
        [("name: small\n", "name: small\nformat: mbcacq-plan/1\n")],
        "plan.yaml:3: key 'format' stands here a second time (first in line 1); remove one",
    ),
    "wrong format": (
        [("mbcacq-plan/1", "mbcacq-plan/9")],
        "plan.yaml:1: this plan was written by a newer mbcacq: its format is 'mbcacq-plan/9'",
    ),
    "no format of ours": ([("mbcacq-plan/1", "plan/1")], "plan.yaml:1: format: input should be 'mbcacq-plan/1', not 'plan/1'"),
    "bad step kind": (
        [("do: look", "do: dance")],
        "plan.yaml:19: steps[0]: do: dance is not one of 'translate', 'look', 'sweep', 'joints'",
    ),
    "step without kind": (
        [("    do: look\n", "")],
        "plan.yaml:19: steps[0] lacks 'do'; say which of 'translate', 'look', 'sweep', 'joints'",
    ),
    "too short a vector": ([("[600, 0, 100]", "[600, 0]")], "plan.yaml:17: stations[1].pose_in_base.translation_mm has too few values"),
    "unknown station": (
        [("stations: [1]", "stations: [1, 7]")],
        "plan.yaml:22: step 'views' names a station '7' that the plan does not have",
    ),
    "unknown artefact": (
        [("artefact: bar", "artefact: bat")],
        "plan.yaml:17: station '2' names an artefact 'bat' that the plan does not have (it has mbc, bar)",
    ),
    "station twice": ([("{id: 2", "{id: 1")], "plan.yaml:17: station '1' exists already; give each station an id of its own"),
    "step twice": ([("name: ends", "name: views")], "plan.yaml:26: step 'views' exists already; give each step a name of its own"),
    "artefact twice": (
        [("[mbc.yaml, bar.yaml]", "[mbc.yaml, bar.yaml, mbc.yaml]")],
        "plan.yaml:14: artefact 'mbc' is named twice; give each artefact an id of its own",
    ),
    "missing file": (
        [("model: robot.yaml", "model: robots/none.yaml")],
        "plan.yaml:5: there is no robot file {folder}/robots/none.yaml; correct the path (it is relative to the plan)",
    ),
    "short home": ([("90, 0, 90, 0]", "90, 0, 90]")], "plan.yaml:6: 5 joint angles are given, but the robot has 6 axes"),
    "home beyond limits": (
        [("[0, -90, 90, 0, 90, 0]", "[0, -90, 170, 0, 90, 0]")],
        "plan.yaml:6: the home position exceeds the limits of A3; choose another",
    ),
    "home in radians": (
        [("[0, -90, 90, 0, 90, 0]", "[0, -1.5708, 1.5708, 0, 1.5708, 0]")],
        "plan.yaml:6: all joint angles are within 2 pi, which looks like radians; give them in degrees ([0, -90, 90, 0, 90, 0])",
    ),
    "station in metres": (
        [("[600, 0, 150]", "[0.6, 0, 0.15]")],
        "plan.yaml:16: a translation of 0.618 mm looks like metres; give translation_mm in mm",
    ),
    "hand-eye in metres": (
        [("[1, -0.5, 265]", "[0.001, -0.0005, 0.265]")],
        "plan.yaml:13: a translation of 0.265 mm looks like metres; give translation_mm in mm",
    ),
    "mirror": (
        [("[0, 0, -1]]", "[0, 0, 1]]")],
        "plan.yaml:12: this is no rotation (rows of length 1, perpendicular, right-handed); correct it",
    ),
    "two orientations": (
        [("  translation_mm: [1, ", "  abc_deg: [0, 0, 0]\n  translation_mm: [1, ")],
        "plan.yaml:11: a frame has either 'rotation' or 'abc_deg', not both; remove one",
    ),
    "view upside down": (
        [("near_z_mm: 55, far_z_mm: -55", "near_z_mm: -55, far_z_mm: 55")],
        "plan.yaml:10: near_z_mm must exceed far_z_mm, since z points to the scanner; exchange them",
    ),
    "not a mapping": ([("format: mbcacq-plan/1\n", "- a\n- b\n#"), ("name: small", "#")], "plan.yaml:"),
    "tabs": (
        [("  driver: kuka_rsi", "\tdriver: kuka_rsi")],
        "plan.yaml:4: not valid YAML: found character that cannot start any token; indent with spaces, not with tabs",
    ),
    "open bracket": ([("[mbc.yaml, bar.yaml]", "[mbc.yaml, bar.yaml")], "plan.yaml:15: not valid YAML: did not find expected ',' or ']'"),
    "object": (
        [("name: small", "name: !!python/object/apply:os.getcwd []")],
        "plan.yaml:2: not valid YAML: could not determine a constructor for the tag 'tag:yaml.org,2002:python/object/apply:os.getcwd'",
    ),
}


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_fault_of_a_plan_is_named_with_its_line(folder, fault):
    changes, message = FAULTS[fault]
    with pytest.raises(ConfigError) as error:
        load(folder.plan(*changes))
    assert str(error.value).startswith(f"{folder.path}/{message}".replace("{folder}", str(folder.path)))
    assert "\n" not in str(error.value)


OTHER_FILES = {
    "ball in two artefacts": (
        "bar.yaml",
        ("id: 9,", "id: 3,"),
        "bar.yaml:9: ball 3 exists already in artefact 'mbc'; number the balls of a cell once",
    ),
    "ball twice": (
        "mbc.yaml",
        ("id: 2,", "id: 1,"),
        "mbc.yaml:11: ball 1 exists already in this artefact; number the balls of a cell once",
    ),
    "negative diameter": (
        "mbc.yaml",
        ("diameter_mm: 12.0", "diameter_mm: -12.0"),
        "mbc.yaml:10: balls[0].diameter_mm: input should be greater than or equal to 0, not -12.0; correct it",
    ),
    "unknown key in a link": ("robot.yaml", ("d_mm: 400", "d: 400"), "robot.yaml:8: links[0] lacks 'd_mm'; add it"),
    "limits swapped": (
        "robot.yaml",
        ("[-170, 170]", "[170, -170]"),
        "robot.yaml:8: limits of A1: the lower one must come first; exchange them",
    ),
    "sign": ("robot.yaml", ("{sign: -1", "{sign: 2"), "robot.yaml:8: links[0].sign: input should be -1 or 1, not 2; correct it"),
}


@pytest.mark.parametrize("fault", OTHER_FILES, ids=str)
def test_fault_of_another_file_is_named_in_that_file(folder, fault):
    name, change, message = OTHER_FILES[fault]
    folder.change(name, change)
    with pytest.raises(ConfigError) as error:
        load(folder.plan())
    assert str(error.value) == f"{folder.path}/{message}"


SPOILS = [
    "",
    "-",
    "[",
    "]",
    "{",
    "}",
    ":",
    "0",
    "-1",
    ".nan",
    "null",
    "true",
    '"',
    "\n",
    "  ",
    "&a ",
    "*a",
    "!!float x",
    "\t",
    "#",
    "1:30",
    "[]",
    "é",
    "1" * 30,
]


@given(file=st.sampled_from(["quick.yaml", "robots/kr10_r1100_2.yaml", "artefacts/mbc-8.yaml"]), data=st.data())
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_spoiled_file_is_read_or_refused_in_one_sentence(tmp_path, file, data):
    for name in ("quick.yaml", "robots/kr10_r1100_2.yaml", "artefacts/mbc-8.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        text = (PLANS / name).read_text()
        if name == file:
            at, cut = data.draw(st.integers(0, len(text) - 1)), data.draw(st.integers(0, 20))
            text = text[:at] + data.draw(st.sampled_from(SPOILS)) + text[at + cut :]
        (tmp_path / name).write_text(text, encoding="utf-8")
    loaded, message = None, ""
    try:
        loaded = load(tmp_path / "quick.yaml")
    except ConfigError as error:
        message = str(error)
    if loaded is None:
        assert message.startswith(str(tmp_path))
        assert "\n" not in message
    else:
        assert np.isfinite(loaded.cell.ball_centres).all()
        assert np.isfinite(loaded.cell.robot.chain.rows).all()


def test_a_missing_or_unreadable_plan_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: the plan cannot be read \(No such file or directory\); correct the path"):
        load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="the plan cannot be read"):
        load(tmp_path)
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match="it is a pipe or a device"):
        load(tmp_path / "pipe.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"a: 1\nname: Pr\xfcfling\n")
    with pytest.raises(ConfigError, match=r"latin\.yaml:2: the plan is not UTF-8 text"):
        load(tmp_path / "latin.yaml")
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(ConfigError, match=r"empty\.yaml:1: this is no plan, which must be a mapping"):
        load(tmp_path / "empty.yaml")


def test_size_and_nesting_are_bounded(tmp_path):
    (tmp_path / "big.yaml").write_text("a: " + "1" * 1_000_001)
    with pytest.raises(ConfigError, match="larger than 1000000 bytes"):
        load(tmp_path / "big.yaml")
    (tmp_path / "deep.yaml").write_text("a: " + "[" * 3000 + "]" * 3000)
    with pytest.raises(ConfigError, match=r"deep\.yaml:1: "):
        load(tmp_path / "deep.yaml")
    laughs = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10))
    (tmp_path / "laughs.yaml").write_text(laughs)
    with pytest.raises(ConfigError, match="too many or too deeply nested values"):
        load(tmp_path / "laughs.yaml")
    (tmp_path / "loop.yaml").write_text("a: &a [*a]\n")
    with pytest.raises(ConfigError, match="too many or too deeply nested values"):
        load(tmp_path / "loop.yaml")


def test_taught_positions_are_counted_and_their_balls_known(folder):
    def plan(steps):
        return folder.write("plan.yaml", folder.plan().read_text().split("steps:")[0] + "steps:\n" + steps)

    taught = "  - {name: t, phase: position, do: joints, station: 1, poses_deg: [[0, -90, 90, 0, 90, 0], [0, -90, 90, 0, 90]]}\n"
    with pytest.raises(ConfigError, match=r"plan\.yaml:19: 5 joint angles are given, but the robot has 6 axes"):
        load(plan(taught))
    taught = (
        "  - name: t\n    phase: position\n    do: joints\n    station: 1\n    balls: [1, 9]\n    poses_deg: [[0, -90, 90, 0, 90, 0]]\n"
    )
    with pytest.raises(ConfigError, match=r"plan\.yaml:23: step 't' expects ball 9, which the artefact at station '1' does not have"):
        load(plan(taught))


def test_the_loaded_plan_holds_what_its_files_say(folder):
    loaded = load(folder.plan())
    assert loaded.cell.ball_ids == (1, 2, 3, 4, 5, 6, 7, 8, 9, 10)
    assert loaded.cell.robot.name == "KUKA KR 10 R1100-2"
    assert [s.id for s in loaded.cell.stations] == ["1", "2"]
    assert loaded.lines[("steps", 0, "views", 1)] == 25
    assert loaded.cell.T_flange_scanner[:3, 3].tolist() == [1, -0.5, 265]
    assert loaded.text.startswith("format: mbcacq-plan/1\n")
    heavier = load(
        folder.plan(
            ("  driver: kuka_rsi", "  driver: kuka_rsi\n  payload: {mass_kg: 2.5, com_mm: [1, 2, 3]}\n  base_to_gravity: [0, 2, 0]")
        )
    )
    assert heavier.cell.robot.payload_mass == 2.5
    assert heavier.cell.robot.gravity.tolist() == [0, 1, 0]


def test_a_file_of_the_largest_size_is_refused_where_it_has_too_many_values(tmp_path):
    """The work is bounded by the number of values, not by the size: pure Python took eleven seconds for this."""
    from mbcacq.model import yaml_source

    counted = 0

    class Loader(yaml_source.LOADER):
        def check_event(self, *choices):
            nonlocal counted
            counted += 1
            return super().check_event(*choices)

    original, yaml_source.LOADER = yaml_source.LOADER, Loader
    try:
        with pytest.raises(ConfigError, match="too many or too deeply nested values"):
            yaml_source.parse("a: [" + "1," * 490_000 + "1]\n", tmp_path / "plan.yaml")
    finally:
        yaml_source.LOADER = original
    assert counted <= yaml_source.SMALL.nodes + 10


@pytest.mark.parametrize("text", ["a: " + "[" * 490_000, "a: " + "[" * 450_000 + "]" * 450_000, "a: " + "{b: " * 200_000])
def test_nesting_is_refused_before_it_can_end_the_process(text, tmp_path):
    from mbcacq.model import yaml_source

    with pytest.raises(ConfigError, match="deeply nested"):
        yaml_source.parse(text, tmp_path / "plan.yaml")


@pytest.mark.parametrize("value", ["!!timestamp 2", "!!binary 'xx'", "2024-99-99", "!!int x", "!!float ''"])
def test_a_tag_that_does_not_fit_its_value_is_a_sentence(value, tmp_path):
    from mbcacq.model import yaml_source

    with pytest.raises(ConfigError, match=r"plan\.yaml:1: not valid YAML"):
        yaml_source.parse(f"a: {value}\n", tmp_path / "plan.yaml")
