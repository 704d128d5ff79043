"""What a newer mbcacq wrote is said to be newer, wherever it is read; anything else is not."""

import json

import pytest

from mbcacq.errors import ConfigError
from mbcacq.model.formats import newer_format


@pytest.mark.parametrize(
    ("found", "known", "newer"),
    [
        ("mbcacq-plan/2", "mbcacq-plan/1", True),
        ("mbcacq-plan/10", ("mbcacq-plan/1", "mbcacq-plan/9"), True),
        ("mbcacq-plan/9", ("mbcacq-plan/1", "mbcacq-plan/9"), False),
        ("mbcacq-robot/2", "mbcacq-plan/1", False),
        ("plan/2", "mbcacq-plan/1", False),
        (2, "mbcacq-plan/1", False),
        (None, "mbcacq-plan/1", False),
    ],
)
def test_a_higher_number_of_the_same_format_is_newer(found, known, newer):
    assert bool(newer_format(found, known)) is newer


@pytest.mark.parametrize("kind", ["mbcacq-result/2", "mbcacq-joint-result/7", "mbcacq-diagnosis/4"])
def test_a_newer_file_is_never_called_damaged(kind, tmp_path):
    from mbcacq.exports.result_json import load_result
    from mbcacq.workflow.diagnosis_result import DiagnosisResult
    from mbcacq.workflow.effects import as_effects

    file = tmp_path / "file.json"
    file.write_text(json.dumps({"format": kind, "what": "this program cannot know"}))
    readers = [as_effects] if "joint" not in kind else [load_result]
    readers += [lambda path: DiagnosisResult.from_json(path.read_text())] if "diagnosis" in kind else []
    for read in readers:
        with pytest.raises(ConfigError, match="was written by a newer mbcacq") as refused:
            read(file)
        assert "correct" not in str(refused.value)


def test_a_newer_set_is_never_called_wrong(tmp_path):
    from mbcacq.recording import load_observations

    (tmp_path / "cell.yaml").write_text("# notes\nformat: mbcacq-observation-set/2\nrobots: [{}]\n")
    (tmp_path / "poses.csv").write_text("pose\n")
    (tmp_path / "centres.csv").write_text("pose\n")
    with pytest.raises(ConfigError, match=r"cell.yaml:2: it was written by a newer mbcacq"):
        load_observations(tmp_path)
