"""What no device can run is found by `plan check`, and before anything is opened by `run`, `fakes` and `doctor`: the drivers say so."""

import json
import re
import shutil
from pathlib import Path

import jsonschema
import pytest
import yaml
from click.testing import CliRunner

from mbcacq.acquisition.device_check import device_findings
from mbcacq.cli.app import app
from mbcacq.plan import load

PLANS = Path(__file__).parents[2] / "plans"


@pytest.fixture
def plan(tmp_path):
    """Writes the shipped KUKA plan with something replaced; its path."""

    def write(old, new, name="kuka.yaml"):
        for folder in ("robots", "artefacts"):
            shutil.copytree(PLANS / folder, tmp_path / folder, dirs_exist_ok=True)
        text = (PLANS / name).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new, 1), encoding="utf-8")
        return tmp_path / name

    return write


OPTIONS = "options: {bind: 127.0.0.1, port: 49152, cycle_ms: 12}"
IMPOSSIBLE = [
    ("driver: kuka_rsi", "driver: fanuc_rmi", "there is no driver 'fanuc_rmi' among the robots"),
    ("driver: gocator", "driver: photoneo", "there is no driver 'photoneo' among the scanners"),
    ("positioner: {driver: manual}", "positioner: {driver: turntable9}", "there is no driver 'turntable9' among the positioners"),
    (OPTIONS, OPTIONS.replace("49152", "70000"), "port must be a whole number from 0 to 65535, not 70000"),
    (OPTIONS, OPTIONS.replace("49152", "-1"), "not -1"),
    (OPTIONS, OPTIONS.replace("12}", "0}"), "cycle_ms must be one of 4, 12, not 0"),
    (OPTIONS, OPTIONS.replace("127.0.0.1", "everywhere"), "bind must be an IP address"),
    (OPTIONS, "options: {address: 172.31.1.147, acceleration_percent: 50}", "unknown option"),
    ("options: {address: 127.0.0.1}", "options: {address: 127.0.0.1, cycle_ms: 12}", "unknown option 'cycle_ms'"),
    ("options: {address: 127.0.0.1}", "options: {}", "the option address is missing"),
    ("options: {address: 127.0.0.1}", "options: {address: no such host}", "must be a host name or an IP address"),
    (OPTIONS, OPTIONS.replace("49152", "1:30"), "not '1:30'"),
    (OPTIONS, OPTIONS.replace("12}", "1e6}"), "cycle_ms must be one of 4, 12, not 1000000"),
    (
        "positioner: {driver: manual}",
        "positioner: {driver: modbus, options: {port: 70000}}",
        "port must be a whole number from 1 to 65535, not 70000",
    ),
]


@pytest.mark.parametrize(("old", "new", "says"), IMPOSSIBLE)
def test_what_its_driver_refuses_is_an_error_of_the_plan_with_its_line(plan, old, new, says):
    path = plan(old, new)
    found = list(device_findings(load(path)))
    assert len(found) == 1
    assert says in found[0].sentence
    line = int(found[0].place.rpartition(":")[2])
    text = path.read_text(encoding="utf-8").splitlines()
    assert re.search(r"driver|options", text[line - 1])


def test_the_line_is_that_of_the_option_in_question_among_several(plan):
    path = plan(OPTIONS, "options:\n    bind: 127.0.0.1\n    port: 70000\n    cycle_ms: 12")
    (found,) = device_findings(load(path))
    line = int(found.place.rpartition(":")[2])
    assert path.read_text(encoding="utf-8").splitlines()[line - 1].strip() == "port: 70000"


@pytest.mark.parametrize("driver", ["kuka_rsi", "kuka_eki", "simulated"])
def test_a_scanner_that_an_output_of_the_arm_shall_trigger_needs_one_that_the_plan_names(plan, driver):
    path = plan("trigger: {person: true}", "trigger: {output: 3}", "folder.yaml")
    options = {"kuka_rsi": "{bind: 127.0.0.1}", "kuka_eki": "{address: 127.0.0.1}", "simulated": "{}"}[driver]
    text = re.sub(r"driver: kuka_rsi", f"driver: {driver}", path.read_text(encoding="utf-8"), count=1)
    text = re.sub(r"options: \{[^}]*bind[^}]*\}", f"options: {options}", text, count=1)
    path.write_text(text, encoding="utf-8")
    (found,) = device_findings(load(path))
    if driver == "simulated":
        assert "trigger.output needs a robot whose driver switches outputs, which this one does not; trigger it by tcp" in found.sentence
        return
    assert "trigger.output is 3, which the robot may not switch; add digital_outputs: [3] to the robot's options" in found.sentence
    path.write_text(text.replace(options, options[:-1] + ", digital_outputs: [3]}"), encoding="utf-8")
    assert list(device_findings(load(path))) == []


@pytest.mark.parametrize("command", ["fakes", "run"])
def test_it_ends_a_command_before_anything_is_opened(plan, command):
    """Exit code and sentence of a wrong plan; nobody is asked whether the arm may move."""
    path = plan(OPTIONS, OPTIONS.replace("49152", "70000"))
    done = CliRunner().invoke(app, [command, str(path)])
    assert done.exit_code == 2
    line = next(i for i, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if "70000" in text)
    assert f"{path}:{line}: options of robot 'kuka_rsi': port must be" in done.stderr


def test_every_shipped_plan_has_devices_that_can_be():
    for path in sorted(PLANS.glob("*.yaml")):
        assert list(device_findings(load(path))) == []


def test_two_sensors_of_one_value_are_an_error(plan):
    values = "options: {host: 127.0.0.1, values: {air_C: {address: 1, unit: °C}}}"
    sensors = f"sensors:\n  - {{driver: modbus, {values}}}\n  - {{driver: modbus, {values}}}\npositioner: {{driver: manual}}"
    (found,) = device_findings(load(plan("positioner: {driver: manual}", sensors)))
    assert "both deliver 'air_C'" in found.sentence


def test_the_schema_for_editors_knows_each_drivers_options():
    schema = json.loads(CliRunner().invoke(app, ["schema", "plan"]).stdout)
    checked = jsonschema.Draft202012Validator(schema)
    kuka = yaml.safe_load((PLANS / "kuka.yaml").read_text(encoding="utf-8"))
    for path in sorted(PLANS.glob("*.yaml")):
        assert list(checked.iter_errors(yaml.safe_load(path.read_text(encoding="utf-8")))) == []
    for section, key, value in (("robot", "cycle_s", 12), ("robot", "port", "x"), ("scanner", "bind", "127.0.0.1")):
        wrong = json.loads(json.dumps(kuka))
        wrong[section]["options"][key] = value
        assert list(checked.iter_errors(wrong)) != []
    wrong = json.loads(json.dumps(kuka))
    wrong["robot"]["driver"] = "fanuc_rmi"
    assert list(checked.iter_errors(wrong)) != []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "noise_mm: [0.005, 0.005, 0.009]",
            "noise_mm: [1000, 1000, 1000]",
            "scanner.noise_mm[0]: input should be less than or equal to 10",
        ),
        ("exposures: 3", "exposures: 1000000000000", "exposures: input should be less than or equal to 1000"),
        ("exposures: 3", "exposures: 1e12", "exposures: input should be less than or equal to 1000"),
        ("exposures: 3", "exposures: 2.5", "exposures: input should be a valid integer, not 2.5"),
        ("exposure_us: 8000", "exposure_us: 1e12", "scanner.exposure_us: input should be less than or equal to 100000000"),
        ("scan_time_s: 1.0", "scan_time_s: 1e9", "scanner.scan_time_s: input should be less than or equal to 3600"),
        ("settle_s: 0.3 ", "settle_s: 1e9 ", "robot.settle_s: input should be less than or equal to 3600"),
        ("speed: 0.3 ", "speed: 0.00001 ", "robot.speed: input should be greater than or equal to 0.001, not 1e-05"),
        ("mass_kg: 2.3", "mass_kg: -2.3", "robot.payload.mass_kg: input should be greater than or equal to 0"),
    ],
)
def test_what_no_scanner_and_no_arm_has_is_named_with_its_line(plan, old, new, says):
    path = plan(old, new)
    done = CliRunner().invoke(app, ["plan", "check", str(path), "--quick"])
    assert done.exit_code == 2
    line = next(i for i, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if new.strip() in text)
    assert f"{path}:{line}: {says}" in done.stderr


@pytest.mark.parametrize(
    ("old", "new", "value"),
    [
        ("exposures: 3", "exposures: 5.", lambda plan: plan.exposures == 5),
        ("exposures: 3", "exposures: 1e1", lambda plan: plan.exposures == 10),
        ("exposures: 3", "exposures: 1_000", lambda plan: plan.exposures == 1000),
        (OPTIONS, OPTIONS.replace("49152", "5e4"), lambda plan: plan.robot.options["port"] == 50000),
        (OPTIONS, OPTIONS.replace("49152", "49_153."), lambda plan: plan.robot.options["port"] == 49153),
        (OPTIONS, OPTIONS.replace("12}", "1.2e1}"), lambda plan: plan.robot.options["cycle_ms"] == 12),
        ("speed: 0.3 ", "speed: 3E-1 ", lambda plan: plan.robot.speed == 0.3),
    ],
)
def test_a_number_is_read_as_people_write_it(plan, old, new, value):
    loaded = load(plan(old, new))
    assert value(loaded.plan)
    assert list(device_findings(loaded)) == []


def test_a_scanner_of_coarse_noise_is_checked_to_the_end(plan):
    """What leaves no parameter determined is a sentence, no accident of an empty array."""
    done = CliRunner().invoke(app, ["plan", "check", str(plan("noise_mm: [0.005, 0.005, 0.009]", "noise_mm: [10, 10, 10]", "quick.yaml"))])
    assert done.exit_code in (0, 2)
    assert "bug" not in done.stderr
