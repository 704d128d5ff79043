"""The programs are run as KRL is: its precedence, its types, its interrupts. What a controller would refuse is refused here."""

import pytest
from mbcacq_fakes.protocols.krc.krl import Interpreter, KrlError, Program, Struct


class Motion:
    """An arm that takes three ticks a move, or a brake."""

    def __init__(self):
        self.log, self.left = [], 0

    @property
    def moving(self):
        return self.left > 0

    def begin(self, target):
        self.log.append(("ptp", target))
        self.left = 3

    def brake(self):
        self.log.append("brake")
        self.left = min(self.left, 1)

    def abandon(self):
        self.log.append("abandon")
        self.left = 0


class System:
    def __init__(self):
        self.flag = [False] * 8


def program(body, data="", functions=None, system=None):
    lists = {"p.dat": f"DEFDAT p\n{data}\nENDDAT"} if data else {}
    return Program({"p.src": body, **lists}, system or System(), functions or {})


def run(body, data="DECL INT out=0"):
    made = program(f"DEF main()\n{body}\nEND", data)
    interpreter = Interpreter(made, "main")
    interpreter.tick(0.0)
    assert interpreter.halted
    return made.globals.out


@pytest.mark.parametrize(
    ("expression", "value"),
    [("7/2", 3), ("-7/2", -3), ("2+3*4", 14), ("(2+3)*4", 20), ("11-(11/8)*8+1", 4), ("7/2.0", 4), ("2.5", 2), ("3.5", 4)],
)
def test_arithmetic(expression, value):
    """INT by INT cuts off; a REAL given to an INT is rounded."""
    assert run(f"out={expression}") == value


@pytest.mark.parametrize(
    ("condition", "value"),
    [
        ("(1<2) AND (2<3)", 1),
        ("NOT a", 1),
        ("(out==0) OR a", 1),
        ("(1>2) EXOR (2>1)", 1),
        ("NOT (a OR a)", 1),
        ("a==FALSE", 1),
        ("(2<>2)", 0),
    ],
)
def test_conditions(condition, value):
    assert run(f"IF {condition} THEN\nout=1\nENDIF", "DECL INT out=0\nDECL BOOL a=FALSE") == value


def test_comparisons_bind_least():
    """1==1 AND 2==2 is 1==(1 AND 2)==2 on a controller."""
    with pytest.raises(KrlError, match="no BOOL"):
        run("IF 1==1 AND 2==2 THEN\nout=1\nENDIF")


def test_structures_are_copied():
    data = (
        "DECL INT out=0\nDECL AXIS a={A1 1.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0}\nDECL AXIS b={A1 0.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0}"
    )
    assert run("b=a\na.A1=5.0\nout=b.A1", data) == 1


def test_loops_functions_and_arrays():
    text = """DEF main()
    DECL INT k
    FOR k=1 TO 4 ; a comment
       list[k]=twice(k)
    ENDFOR
    WHILE out<20
       out=out+list[4]
    ENDWHILE
    LOOP
       IF out>30 THEN
          RETURN
       ELSE
          out=out+1
       ENDIF
    ENDLOOP
    END
    DEFFCT INT twice(n:IN)
    DECL INT n
    RETURN (2*n)
    ENDFCT"""
    made = program(text, "DECL INT out=0\nDECL INT list[4]")
    Interpreter(made, "main").tick(0.0)
    assert (made.globals.list[3], made.globals.out) == (6, 31)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("out=nobody", "p.src:2: nobody is not declared"),
        ("IF TRUE THEN", "ENDIF is missing"),
        ("ENDLOOP", "p.src:2: ENDLOOP closes nothing"),
        ("fly()", "there is no fly"),
        ("out 3", "p.src:2: not understood"),
        ("out=(3", "p.src:2: .* is no expression"),
        ("out=3 4", "p.src:2: .* is no expression"),
    ],
)
def test_mistakes_are_named(body, says):
    with pytest.raises(KrlError, match=says):
        program(f"DEF main()\n{body}\nEND", "DECL INT out=0")


def test_mistakes_that_only_running_shows():
    for body, says in (
        ("out=TRUE", "no INT"),
        ("out=list[5]", "not between 1 and 4"),
        ("IF out THEN\nout=1\nENDIF", "no BOOL"),
        ("LOOP\nout=out+1\nENDLOOP", "circle"),
        ("PTP a", "submit program cannot move"),
    ):
        with pytest.raises(KrlError, match=says):
            run(body, "DECL INT out=0\nDECL INT list[4]\nDECL AXIS a={A1 0.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0}")


def test_letters_beyond_ascii_are_refused():
    with pytest.raises(KrlError, match="ASCII"):
        program("DEF main()\n; für\nEND")


INTERRUPTED = """DEF main()
INTERRUPT DECL 21 WHEN $FLAG[1]==TRUE DO brake_it()
LOOP
   work()
   came_back=came_back+1
ENDLOOP
END
DEF work()
   INTERRUPT ON 21
   LOOP
      PTP {A1 1.0,A2 0.0,A3 0.0,A4 0.0,A5 0.0,A6 0.0}
      WAIT FOR $FLAG[2]==TRUE
   ENDLOOP
END
DEF brake_it()
   INTERRUPT OFF 21
   BRAKE
   RESUME
END"""


def interrupted():
    system, motion = System(), Motion()
    made = program(INTERRUPTED, "DECL INT came_back=0", system=system)
    interpreter = Interpreter(made, "main", motion)

    def tick(times=1):
        for _ in range(times):
            tick.now += 0.004
            interpreter.tick(tick.now)
            motion.left = max(0, motion.left - 1)

    tick.now = 0.0
    return system, motion, made.globals, tick


def test_an_interrupt_leaves_what_it_interrupted_by_resume():
    system, motion, variables, tick = interrupted()
    tick(2)
    assert motion.log == [("ptp", Struct(a1=1.0, a2=0.0, a3=0.0, a4=0.0, a5=0.0, a6=0.0))]
    system.flag[1] = True
    tick(6)
    assert motion.log[1:3] == ["brake", "abandon"]
    assert variables.came_back == 1


def test_interrupts_fire_on_the_edge_only():
    system, motion, variables, tick = interrupted()
    system.flag[1] = True  # before INTERRUPT ON: there is no edge any more
    tick(10)
    assert (variables.came_back, "brake" in motion.log) == (0, False)
    system.flag[1] = False
    tick(1)
    system.flag[1] = True
    tick(6)
    assert variables.came_back == 1
