"""What commands kept in the folder of a run: absent, damaged and newer are three answers."""

import json

import pytest

from mbcacq.errors import ConfigError
from mbcacq.report.sources.run_folder import read_run_info

KEPT = ("diagnosis.json", "with-effects/result.json")


@pytest.mark.parametrize("name", KEPT)
def test_absent_damaged_and_newer_are_three_answers(tmp_path, name):
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    assert not {"diagnosis", "with_effects"} & set(read_run_info(tmp_path))
    kind = "mbcacq-diagnosis/2" if name.startswith("diagnosis") else "mbcacq-result/1"
    text = json.dumps({"format": kind, "x": 1.0})
    file.write_text(text)
    assert {"diagnosis", "with_effects"} & set(read_run_info(tmp_path))
    for cut in (0, 1, len(text) * 6 // 10, len(text) - 1):
        file.write_text(text[:cut])
        with pytest.raises(ConfigError, match=r"json.*(breaks off|empty).*write it anew with mbcacq diagnose"):
            read_run_info(tmp_path)
    file.write_text(text.replace(kind, kind[:-1] + "99"))
    with pytest.raises(ConfigError, match="newer mbcacq wrote"):
        read_run_info(tmp_path)


def test_damaged_pictures_of_a_diagnosis_are_not_left_out_without_a_word(tmp_path):
    (tmp_path / "diagnosis.json").write_text('{"format": "mbcacq-diagnosis/2"}')
    assert read_run_info(tmp_path)["pictures"] is None
    (tmp_path / "diagnosis-pictures.json").write_text('{"format": "mbcacq-diagnosis-pictures/1", "cur')
    with pytest.raises(ConfigError, match="diagnosis-pictures.json.*write it anew with mbcacq diagnose"):
        read_run_info(tmp_path)


def test_a_changed_number_in_the_result_with_effects_is_refused(tmp_path):
    from mbcacq.model.json_text import sealed_text

    (tmp_path / "with-effects").mkdir()
    text = sealed_text({"format": "mbcacq-result/1", "rms_mm": 0.125})
    (tmp_path / "with-effects" / "result.json").write_text(text.replace("0.125", "0.124"))
    with pytest.raises(ConfigError, match="not as it was written"):
        read_run_info(tmp_path)
