"""Robot programs: what a motion goes to as an absolute joint target is found, everything else stays byte for byte and is listed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from test_correct import arm, goals_of, result

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.errors import ConfigError
from mbcacq.exports.programs import program as programs
from mbcacq.exports.programs import rapid, read_program
from mbcacq.workflow.correct import correct


@pytest.fixture
def read(tmp_path):
    def read(name, text):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
        return read_program(path, 6)[0]

    return read


def targets(program):
    return [(point.name, point.line) for point in program.points]


def left(program):
    return {name: reason for name, _, reason in program.left_alone}


ANGLES = "A1 10,A2 -80,A3 80,A4 0,A5 30,A6 0"
RELATIVE = f"""&ACCESS RVP
DEF rel ( )
;FOLD INI;%{{PE}}
  BAS (#INITMOV,0 )
;ENDFOLD (INI)
DECL E6AXIS step
step={{A1 2.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0,E1 0}}
place={{{ANGLES}}}
both={{{ANGLES}}}
tolerance={{{ANGLES}}}
PTP {{{ANGLES}}}
PTP_REL {{A1 10,A2 0,A3 0,A4 0,A5 0,A6 0}}
SPTP_REL step
LIN_REL {{X 10,Y 0,Z 0}}
lin {{x 500,y 0,z 600,a 0,b 90,c 0}}
SPTP {{E6AXIS: {ANGLES},E1 0.0}} WITH $VEL_AXIS[1]=SVEL_JOINT(100.0) C_PTP
SPTP place C_SPL
PTP both
PTP_REL both
PTP XP7
IF check(tolerance)==TRUE THEN
MSG("go to {{{ANGLES}}} ; now")
PTP {{A1 12.5}}
PTP {{A1 x+1,A2 0,A3 0,A4 0,A5 0,A6 0}}
PTP {{A1 1,A2 0,A3 0,A4 0,A5 0,A6 0,A1 2}}
END
"""


def test_krl_frames_that_motions_use_are_listed(read):
    text = "DEF a()\ndelta={X 10,Y 0,Z 0,A 0,B 0,C 0}\nbase={X 10,Y 0,Z 0,A 0,B 0,C 0}\nplace={X 500,Y 0,Z 600,A 0,B 90,C 0}\n"
    left_alone = left(read("a.src", text + f"LIN_REL delta #BASE\n$BASE=base\nLIN place C_DIS\nPTP {{{ANGLES}}}\nEND\n"))
    assert left_alone["delta"] == "is the increment of a relative motion (line 5)"
    assert "is a pose" in left_alone["place"]
    assert "base" not in left_alone


def test_krl_increments_steps_tolerances_and_strings_are_no_targets(read):
    program = read("rel.src", RELATIVE)
    assert targets(program) == [("place", 8), ("line 11", 11), ("line 16", 16)]
    reasons = left(program)
    assert reasons["step"] == "is the increment of a relative motion (line 13)"
    assert reasons["both"] == "is the increment of a relative motion (line 19)"
    assert "used otherwise (line 21)" in reasons["tolerance"]
    assert reasons["line 12"] == "is the increment of PTP_REL"
    assert reasons["line 14"] == "is the increment of LIN_REL"
    assert "is a pose" in reasons["line 15"]
    assert reasons["line 22"] == "is text in a string"
    assert reasons["line 23"] == "has not the angles of all axes"
    assert reasons["line 24"] == "has angles that are computed"
    assert reasons["line 25"] == "has the angle of an axis twice"
    assert "another file" in reasons["XP7"]
    assert program.written(program.q + 0.1, [False] * 3) == RELATIVE
    changed = program.written(program.q + np.radians(1), [True] * 3).splitlines()
    assert [i for i, (a, b) in enumerate(zip(RELATIVE.splitlines(), changed, strict=True), 1) if a != b] == [8, 11, 16]
    assert changed[10] == "PTP {A1 11.000000,A2 -79.000000,A3 81.000000,A4 1.000000,A5 31.000000,A6 1.000000}"


def test_krl_data_lists_follow_the_program_beside_them(read, tmp_path):
    data = f"DEFDAT weld\nDECL E6AXIS XP1={{{ANGLES}}}\nE6AXIS XP2={{E6AXIS: {ANGLES}}}\nDECL E6AXIS P5TOL={{{ANGLES}}}\nDECL E6AXIS P[2]\nP[1]={{{ANGLES}}}\nENDDAT\n"
    alone = read("weld.dat", data)
    assert [name for name, _ in targets(alone)] == ["XP1", "XP2"]
    assert "by its name no place" in left(alone)["P5TOL"]
    assert "known by their names" in alone.notes[0]
    (tmp_path / "WELD.SRC").write_text("DEF weld()\nPTP XP1\nPTP_REL XP2\nFOR i=1 TO 2\nPTP P[i]\nENDFOR\nEND\n")
    beside = read("weld.dat", data)
    assert [name for name, _ in targets(beside)] == ["XP1", "P"]
    assert left(beside)["XP2"] == "is the increment of a relative motion (line 3)"
    assert left(beside)["P5TOL"] == "is the target of no motion in this program"
    assert not beside.notes


def test_only_line_ends_of_krl_end_a_line(read):
    """Byte 0x85 (a next-line character in Latin-1) inside of a comment does not make code of what follows."""
    program = read("a.src", f"; old \x85PTP {{{ANGLES}}}\x0bPTP {{{ANGLES}}}\nPTP {{{ANGLES}}}\rPTP {{{ANGLES}}}\r\n")
    assert targets(program) == [("line 2", 2), ("line 3", 3)]


@pytest.mark.parametrize(
    "line",
    [f"{'a' * 600_000} {{B}}", f"PTP {{A1 {'1' * 300_000}x}}", f"{' ' * 300_000}x", f"PTP{' ' * 300_000}{{"],
    ids=["a word", "a number", "spaces", "spaces behind a motion"],
)
def test_an_endless_line_is_read(read, line):
    """A pattern that begins again at every character, or tries every division of the digits, would take half an hour and more for it."""
    assert targets(read("a.src", f"{line}\nPTP {{{ANGLES}}}\n")) == [("line 2", 2)]


UR = """def prog():
  global Waypoint_1_p=p[.1,.2,.3,0,0,0]
  global Waypoint_1_q=[-1.6, -1.72, -2.2, -0.8, 1.59, -0.03]
  place = [0.1,0.2,0.3,0.4,0.5,0.6]
  counted = [0.1,0.2,0.3,0.4,0.5,0.6]
  # movej([1,2,3,4,5,6])
  while (True):
    movej(get_inverse_kin(Waypoint_1_p, qnear=Waypoint_1_q), a=1.39, v=1.04)
    movej(place, a=1.4, v=1.05, r=0.01)
    movej([d2r(10), d2r(-90), 1.5, 0, -.5, 1e-1], a=1.4)
    movel(p[.1,.2,.3,0,0,0], a=1.2)
    counted[0] = counted[0] + 0.1
    movej(counted)
    speedj([0.2,0.3,0.1,0.05,0,0], 0.5, 0.5)
    textmsg("movej([1,2,3,4,5,6])")
    servoj([0.0,1.0,2.0,3.0,4.0,5.0], 0, 0, 0.002, 0.1, 300)
    movej([0.0,1.0+x,2.0,3.0,4.0,5.0])
  end
end
"""


def test_urscript(read):
    program = read("prog.script", UR)
    assert sorted(targets(program), key=lambda t: t[1]) == [("place", 4), ("line 10", 10), ("line 16", 16)]
    reasons = left(program)
    assert "is a pose" in reasons["Waypoint_1_p"]
    assert reasons["Waypoint_1_q"] == "is the target of no motion in this program"
    assert "used otherwise too (line 12)" in reasons["counted"]
    assert reasons["line 14"] == "is a speed"
    assert reasons["line 17"] == "has angles that are computed"
    degrees = next(point for point in program.points if point.line == 10)
    assert degrees.angles == pytest.approx([np.radians(10), np.radians(-90), 1.5, 0, -0.5, 0.1])
    changed = program.written(program.q + 0.01, [True] * 3).splitlines()
    assert changed[9] == "    movej([d2r(10.572958), d2r(-89.427042), 1.510000000, 0.010000000, -0.490000000, 0.110000000], a=1.4)"


UR_FORMS = """grid = [[0,0,0,0,0,1], [0,0,0,0,0,2]]
across = [0.1, -1.2, # movej([
  1.3, -0.4, 0.5, 0.6]
movej(across)
optimovej([0.1,-1.2,
  1.3,-0.4,0.5,0.6], a=1)
movej([0.1,-1.2,1.3,-0.4,0.5])
movej(get_inverse_kin(p[.1,.2,.3,0,0,0], qnear=[0,0,0,0,0,1]))
home = [0,-1,1,0,1,0]
movej(home)
if home[0] > [ $:
"""


def test_urscript_over_several_lines_in_lists_and_by_other_words(read):
    program = read("forms.script", UR_FORMS)
    assert targets(program) == [("across", 2), ("line 5", 5)]
    reasons = left(program)
    assert reasons["grid"] == "is part of a list"
    assert reasons["line 7"] == "has not 6 angles"
    assert "is a pose" in reasons["line 8"]
    assert "used otherwise too (line 11)" in reasons["home"]
    assert reasons["line 11"] == "is a line that is not understood"
    changed = program.written(program.q + 0.01, [True, False]).splitlines()
    assert changed[1:3] == ["across = [0.110000000, -1.190000000, # movej([", "  1.310000000, -0.390000000, 0.510000000, 0.610000000]"]
    assert changed[3:] == UR_FORMS.splitlines()[3:]


def test_a_target_whose_elements_make_another_one_stays(read):
    program = read("prog.script", "home = [0,-1,1,0,1,0]\nmovej(home)\nmovej([home[0],-1,1,0,1,0])\nmovej([0,-1,1,0,1,0])\n")
    assert targets(program) == [("line 4", 4)]
    assert left(program)["home"] == "is a target, and is used otherwise too (line 3)"


RAPID = """MODULE MainModule
  CONST jointtarget jp10:=[[0,-20,30.5,0,30,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PERS jointtarget jcounted := [[0.1,0.1,0.1,0.1,0.1,0.1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget p10:=[[600,0,800],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  ! MoveAbsJ [[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z50,tool0;
  PROC main()
    MoveAbsJ jp10\\NoEOffs,v1000,z50,tool0;
    MoveAbsJ \\Conc, [[10,0,0,0,45,0],
       [9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs, v1000, fine, tool0\\WObj:=wobj0;
    MoveL p10,v500,z10,tool0;
    jcounted.robax.rax_1 := jcounted.robax.rax_1 + 5;
    MoveAbsJ jcounted,v1000,z50,tool0;
    IF bCheck THEN
      TPWrite "jp10; [[1,2,3,4,5,6]]";
    ENDIF
  ENDPROC
ENDMODULE
"""


E9 = "[9E9,9E9,9E9,9E9,9E9,9E9]"
RAPID_FORMS = f"""MODULE forms
  VAR jointtarget j1;
  VAR jointtarget grid{{2}}:=[[[0,0,0,0,0,1],{E9}],[[0,0,0,0,0,2],{E9}]];
  PROC main()
    j1:=[[10,0,0,0,45,0],{E9}];
    MoveAbsJ j1,v1,fine,tool0;
    MoveAbsJDO [[20,0,0,0,45,0],{E9}],v1,fine,tool0,do1,1;
    MoveExtJ [{E9},[90,9E9,9E9,9E9,9E9,9E9]],vrot10,fine;
    rel [[1,0,0,0,0,0],{E9}];
  ENDPROC
ENDMODULE
"""


class Compared(str):
    """A name as the grammar finds it, which counts how often it is compared."""

    count = 0
    type, start_pos = "NAME", 0
    __hash__ = str.__hash__

    def __eq__(self, other):
        Compared.count += 1
        return str.__eq__(self, other)

    def __str__(self):
        return self

    def lower(self):
        return self


def test_names_of_a_rapid_statement_are_compared_once_each(monkeypatch):
    """A statement of 100,000 names took minutes where all of them were searched for every name."""

    def comparisons(names):
        tree = SimpleNamespace(children=[Compared(f"n{k}") for k in range(names)])
        monkeypatch.setattr(programs, "parser_of", lambda grammar: SimpleNamespace(parse=lambda code: tree))
        Compared.count = 0
        rapid._RapidStatements().statement(0, "", lambda place: 1)
        return Compared.count

    assert 0 < comparisons(400) <= 2 * comparisons(200)


def test_rapid_sets_a_target_before_it_moves_and_moves_by_other_words(read):
    program = read("forms.mod", RAPID_FORMS)
    assert targets(program) == [("j1", 5), ("line 7", 7)]
    reasons = left(program)
    assert reasons["line 8"] == "moves external axes alone"
    assert reasons["line 3"] == reasons["line 9"] == "is no target of a motion"


def test_rapid(read):
    program = read("main.mod", RAPID)
    assert targets(program) == [("jp10", 2), ("line 8", 8)]
    assert "used otherwise too (line 11)" in left(program)["jcounted"]
    assert "is a pose" in left(program)["p10"]
    changed = program.written(program.q + np.radians(1), [True, False])
    assert changed == RAPID.replace("0,-20,30.5,0,30,0", "1.000000,-19.000000,31.500000,1.000000,31.000000,1.000000")
    data = read("data.sys", RAPID.split("  PROC")[0].replace("jcounted", "jtolerance") + "ENDMODULE\n")
    assert targets(data) == [("jp10", 2)]
    assert "by its name no place" in left(data)["jtolerance"]


def position(number, more=""):
    angles = ",\t".join(f"J{i}= {v:9.3f} deg" for i, v in enumerate((0, -30, 10, 0, -60, 0), 1))
    return f"P[{number}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n\t{angles}{more}\n}};\n"


LS = (
    """/PROG  TEST
/ATTR
COMMENT\t\t= "a : b";
/MN
   1:  !J P[9] comment ;
   2:J P[1] 100% FINE    ;
   3:L P[2] 500mm/sec CNT50    ;
   4:J P[3] 50% FINE INC    ;
   5:J P[4:home] 50% CNT100 Offset,PR[1]    ;
   6:C P[5]
    :  P[6] 500mm/sec CNT50    ;
   7:  PR[1]=P[7]    ;
   8:J @P[8] 100% FINE ;
/POS
"""
    + position(1)
    + "P[2]{\n   GP1:\n\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX =   500.000  mm,\tY =     0.000  mm,\tZ =   600.000  mm,\n"
    + "\tW =   180.000 deg,\tP =     0.000 deg,\tR =     0.000 deg\n};\n"
    + position(3)
    + position('4:"home"')
    + position(5, ",\n\tE1=  100.000  mm\n   GP2:\n\tUF : 0, UT : 1,\n\tJ1=     5.000 deg")
    + "".join(map(position, (6, 7, 8, 9)))
    + "/END\n"
)


LS_FORMS = """/PROG  FORMS
/MN
   1:J P[1] 100% FINE ;
   2:J P[02] 100% FINE INC ;
   3:J P[3] 100% FINE COFFSET,PR[1] ;
/POS
"""


def test_fanuc_untaught_positions_offsets_by_any_word_and_numbers_with_zeros(read):
    untaught = position(4).replace("    0.000 deg", "  ********* deg")
    program = read("forms.ls", LS_FORMS + position(1) + position(2) + position(3) + untaught + "/END\n")
    assert [name for name, _ in targets(program)] == ["P[1]"]
    reasons = left(program)
    assert "relative motion (line 4)" in reasons["P[2]"]
    assert "used otherwise (line 5)" in reasons["P[3]"]
    assert reasons["P[4]"] == "is not taught, or has axes in mm"


def test_an_endless_gap_in_a_statement_of_fanuc_is_read(read):
    """A pattern with white space twice, and nothing needed between, would take a quarter of an hour for it."""
    program = read("a.ls", LS_FORMS.replace("   1:", f"{' ' * 1_000_000}1:") + position(1) + "/END\n")
    assert [name for name, _ in targets(program)] == ["P[1]"]


def test_fanuc_ls(read):
    program = read("test.ls", LS)
    assert [name for name, _ in targets(program)] == ["P[1]", "P[5]", "P[6]", "P[8]"]
    reasons = left(program)
    assert "is a pose" in reasons["P[2]"]
    assert "relative motion (line 8)" in reasons["P[3]"]
    assert "used otherwise (line 9)" in reasons["P[4:home]"]
    assert "used otherwise (line 12)" in reasons["P[7]"]
    assert reasons["P[9]"] == "is the target of no motion in this program"
    # The pendant counts J3 from the horizontal.
    assert np.degrees(program.q[0]) == pytest.approx([0, -30, -20, 0, -60, 0])
    moved = program.q.copy()
    moved[0] += np.radians([0, 1, 0, 0, 0, 0])
    changed = program.written(moved, [True, False, False, False])
    assert changed.split("P[1]{")[1].split("P[2]{")[0].split()[7:13] == ["J1=", "0.000000", "deg,", "J2=", "-29.000000", "deg,"]
    assert "J3=    9.000000 deg" in changed
    assert changed.split("P[2]{")[1] == LS.split("P[2]{")[1]
    with pytest.raises(ConfigError, match=r"test.ls: line \d+: these positions are not understood"):
        read("test.ls", LS.replace("P[5]{", "P[5]"))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_programs_keep_their_encoding(tmp_path, encoding):
    path = tmp_path / "a.src"
    path.write_bytes(f"PTP {{{ANGLES}}} ; nach oben\r\n".encode(encoding))
    text = correct(path, result()).file.read_bytes().decode(encoding)
    assert text.startswith("PTP {A1 ")
    assert text.endswith("} ; nach oben\r\n")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.script", "movej([0.2,-1.4,1.2,0.3,0.7,-0.1])\n"),
        ("a.mod", "MoveAbsJ [[10,-80,70,15,40,-5],[9E9,9E9,9E9,9E9,9E9,9E9]],v1,fine,tool0;"),
    ],
)
def test_the_corrected_targets_of_every_language_reach_the_nominal_places(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    before = read_program(path, 6)[0].q
    after = read_program(correct(path, result()).file, 6)[0].q
    there = CalibratedCell.from_dict(result()).frames(after)[:, -1]
    assert np.abs(there - goals_of(np.degrees(before)))[:, :3, 3].max() < 5e-5
    assert np.abs(after - before).max() > 1e-5


def test_an_arm_of_seven_axes_has_no_rapid(tmp_path):
    assert arm().n == 6
    (tmp_path / "a.mod").write_text(RAPID)
    with pytest.raises(ConfigError, match="has six axes, this arm has 7"):
        read_program(tmp_path / "a.mod", 7)
