"""Effects that are no part of the catalogue are tried while a diagnosis asks for them: functions, modules, files."""

import sys
import types

import pytest

from mbcacq.cli.app import LazyGroup
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Candidate, plain_effect, plain_report
from mbcacq.effects.functions import DescribedPart, linear, sine
from mbcacq.errors import ConfigError


def pull(name):
    return plain_effect(name, ["A1"], "q2", [DescribedPart("joint", 0, 0, (sine("q2", 1),))], {"A1.pull_rad": 1e-4})


def hose_pull(context):
    return [pull("hose_pull")]


def test_a_function_is_an_effect_of_its_name_while_it_is_asked_for():
    with catalogue.with_added([hose_pull]):
        (found,) = catalogue.effects()["hose_pull"].candidates(None)
        assert (found.name, found.where, found.k) == ("hose_pull", ("A1",), 1)
        assert catalogue.declaration("hose_pull") == catalogue.NOTHING_PARTICULAR
    assert "hose_pull" not in catalogue.effects()


def sunlit(context):
    return [plain_effect("sunlit", ["A1"], "sun_C", [DescribedPart("joint", 0, 0, (linear("sun_C"),))], {"A1.turned_rad_per_K": 1e-5})]


def test_an_effect_of_what_is_not_recorded_is_dropped_with_the_reason(context):
    with catalogue.with_added([sunlit]):
        found, dropped = catalogue.candidates(context)
    assert dropped["sunlit"] == "no sun_C recorded"
    assert "sunlit" not in {candidate.name for candidate in found}


def test_a_module_and_its_file_are_effects_too(tmp_path):
    module = types.ModuleType("hose")
    module.NAME, module.candidates = "by_module", lambda context: [pull("by_module")]
    file = tmp_path / "hose.py"
    file.write_text("NAME = 'by_file'\ndef candidates(context):\n    return []\n")
    with catalogue.with_added([module, file]):
        assert {"by_module", "by_file"} <= set(catalogue.effects())


def test_an_error_in_a_users_effect_is_said_with_its_line(tmp_path, monkeypatch, capsys, context):
    file = tmp_path / "hose.py"
    file.write_text("NAME = 'hose'\n\n\ndef candidates(context):\n    return [][1]\n")

    def diagnose(*args, **kwargs):
        with catalogue.with_added([file]):
            catalogue.candidates(context)

    monkeypatch.setattr(sys, "argv", ["mbcacq", "diagnose", f"--add-effect={file}"])
    monkeypatch.setattr(LazyGroup.__base__, "main", diagnose)
    with pytest.raises(SystemExit, match="2"):
        LazyGroup().main()
    assert capsys.readouterr().err == f"mbcacq: {file}:5: IndexError: list index out of range; correct this file\n"


def backlash(context):
    return []


def other_name(context):
    return [pull("hose_pull")]


def no_list(context):
    return pull("no_list")


def test_what_is_no_effect_is_refused_in_a_sentence():
    for wrong, words in ((3, "3 is no effect"), (backlash, "the function backlash is called backlash, as another one is")):
        with pytest.raises(ConfigError, match=words), catalogue.with_added([wrong]):
            pass
    for wrong, words in ((other_name, "makes candidates of an effect hose_pull"), (no_list, "returns no list of candidates")):
        with catalogue.with_added([wrong]), pytest.raises(ConfigError, match=words):
            catalogue.effects()[wrong.__name__].candidates(None)


def test_a_candidate_says_what_its_rows_must_be():
    parts = [DescribedPart("joint", 0, 0, (sine("q2", 1),))]
    with pytest.raises(ConfigError, match=r"hose_pull has a list for its rows; give StandstillRows\(parts, typical\)"):
        Candidate("hose_pull", ("A1",), "q2", parts, plain_report("A1.pull_rad"))
