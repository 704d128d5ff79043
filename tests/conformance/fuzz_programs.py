"""Parsers of robot programs: KRL, URScript, RAPID, FANUC LS; what is read is written anew with other angles."""

from __future__ import annotations

from pathlib import Path

from fuzz_target import Target, in_file

from mbcacq.exports.programs import read_program

ANGLES = "A1 10,A2 -80,A3 80,A4 0,A5 30,A6 0"
SRC = f"""&ACCESS RVP
DEF weld ( )
DECL E6AXIS step
step={{A1 2.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0,E1 0}}
place={{{ANGLES}}}
PTP {{{ANGLES}}}   ; go
PTP_REL step
SPTP {{E6AXIS: {ANGLES},E1 0.0}} WITH $VEL_AXIS[1]=SVEL_JOINT(100.0) C_PTP
SPTP place C_SPL
IF check(place)==TRUE THEN
MSG("go to {{{ANGLES}}} ; now")
END
""".encode()
DAT = f"DEFDAT weld\nDECL E6AXIS XP1={{{ANGLES}}}\nE6AXIS XP2={{E6AXIS: {ANGLES}}}\nDECL E6AXIS P[2]\nP[1]={{{ANGLES}}}\nENDDAT\n".encode()
SCRIPT = b"""def prog():
  global Waypoint_1_p=p[.1,.2,.3,0,0,0]
  place = [0.1,0.2,0.3,0.4,0.5,0.6]
  # movej([1,2,3,4,5,6])
  while (True):
    movej(get_inverse_kin(Waypoint_1_p, qnear=place), a=1.39, v=1.04)
    movej(place, a=1.4, v=1.05, r=0.01)
    movej([d2r(10), d2r(-90), 1.5, 0, -.5, 1e-1], a=1.4)
    speedj([0.2,0.3,0.1,0.05,0,0], 0.5, 0.5)
  end
end
"""
MOD = b"""MODULE MainModule
  CONST jointtarget jp10:=[[0,-20,30.5,0,30,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST robtarget p10:=[[600,0,800],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveAbsJ jp10\\NoEOffs,v1000,z50,tool0; ! go
    MoveAbsJ \\Conc, [[10,0,0,0,45,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs, v1000, fine, tool0\\WObj:=wobj0;
    TPWrite "jp10; [[1,2,3,4,5,6]]";
  ENDPROC
ENDMODULE
"""
LS = b"""/PROG  TEST
/MN
   1:  !J P[9] comment ;
   2:J P[1] 100% FINE    ;
   3:J P[2:home] 50% FINE INC    ;
/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=     0.000 deg,\tJ2=   -30.000 deg,\tJ3=    10.000 deg,
\tJ4=     0.000 deg,\tJ5=   -60.000 deg,\tJ6=     0.000 deg
};
P[2:"home"]{
   GP1:
\tUF : 0, UT : 1,\tCONFIG : 'N U T, 0, 0, 0',
\tX =   500.000  mm,\tY =     0.000  mm,\tZ =   600.000  mm,
\tW =   180.000 deg,\tP =     0.000 deg,\tR =     0.000 deg
};
/END
"""


def program(path: Path) -> bytes:
    """Read, and written with other angles, as ``correct`` does."""
    found, encode = read_program(path, 6)
    return encode(found.written(found.q + 1e-3, [True] * len(found.points)))


def program_targets() -> list[Target]:
    """All of them."""
    return [
        Target("program KRL", (SRC,), in_file("weld.src", program)),
        Target("data list KRL", (DAT,), in_file("weld.dat", program, {"weld.src": b"DEF weld()\nPTP XP1\nPTP P[i]\nEND\n"})),
        Target("program URScript", (SCRIPT,), in_file("prog.script", program)),
        Target("program RAPID", (MOD,), in_file("main.mod", program)),
        Target("program LS", (LS,), in_file("test.ls", program)),
    ]
