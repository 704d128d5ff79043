"""What the written programs may say, as grammars: narrower than the languages, so that a word of another one is refused."""

from __future__ import annotations

from lark import Lark

_COMMON = r"""
NUMBER: /[-+]?\d+(\.\d+)?/
NAME: /[A-Za-z_]\w*/
%ignore /[ \t]+/
"""

RAPID = r"""
start: "MODULE" NAME NL (data NL)* proc+ "ENDMODULE" NL
data: "VAR" NAME NAME [":=" expr] ";" | "PERS" "tooldata" NAME ":=" "[" "TRUE" "," frame "," "[" NUMBER_E "," list "," list "," NUMBER_E "," NUMBER_E "," NUMBER_E "]" "]" ";"
frame: "[" list "," list "]"
proc: "PROC" NAME "(" [NAME NAME ("," NAME NAME)*] ")" NL (stmt NL)* "ENDPROC" NL
stmt: NAME ":=" expr ";"
    | "VAR" NAME NAME ";"
    | "FOR" NAME "FROM" expr "TO" expr "DO" NL (stmt NL)* "ENDFOR"
    | "MoveAbsJ" target switch* "," NAME switch* "," NAME "," NAME ";"
    | NAME [arg] (("," arg) | switch)* ";"
target: "[" list "," list "]"
list: "[" NUMBER_E ("," NUMBER_E)* "]"
arg: switch | expr
switch: "\\" NAME [":=" expr]
expr: term ("+" term)*
term: NAME "(" [expr ("," expr)*] ")" | NAME ("." NAME)* | STRING | NUMBER
STRING: /"[^"\n]{0,80}"/
NUMBER_E: /[-+]?\d+(\.\d+)?(E\d+)?/
NL: (/[ \t]*(![^\n]*)?\r?\n/)+
"""

URSCRIPT = r"""
start: NL? function NL
function: "def" NAME "(" [NAME ("," NAME)*] ")" ":" NL (stmt NL)* "end"
stmt: function | "while" expr ":" NL (stmt NL)* "end" | NAME "=" expr | call
call: NAME "(" [arg ("," arg)*] ")"
arg: [NAME "="] expr
expr: term (("+" | "<") term)*
term: call | "True" | "False" | NAME | NUMBER | STRING | "[" expr ("," expr)* "]"
STRING: /"[^"\n]*"/
NL: (/[ \t]*(#[^\n]*)?\r?\n/)+
"""

KAREL = r"""
start: "PROGRAM" NAME NL (directive NL)* "VAR" NL (decl NL)+ routine* "BEGIN" NL (stmt NL)* "END" NAME NL
directive: /%[A-Z]+(=[A-Z+]+)?/
decl: NAME ":" type
type: "FILE" | "ARRAY" "[" NUMBER "]" "OF" NAME | "STRING" "[" NUMBER "]" | NAME
routine: "ROUTINE" NAME "(" [NAME ":" NAME (";" NAME ":" NAME)*] ")" NL ["VAR" NL (decl NL)+] "BEGIN" NL (stmt NL)* "END" NAME NL
stmt: NAME ["[" expr "]"] "=" expr | "DELAY" NUMBER | "FOR" NAME "=" expr "TO" expr "DO" NL (stmt NL)* "ENDFOR"
    | "OPEN" "FILE" NAME "(" STRING "," STRING ")" | "CLOSE" "FILE" NAME
    | ("WRITE" | "READ") [NAME] "(" item ("," item)* ")" | NAME "(" [expr ("," expr)*] ")"
item: expr ["::" NUMBER "::" NUMBER]
expr: NAME "(" [expr ("," expr)*] ")" | NAME "[" expr "]" | NAME | NUMBER | STRING
STRING: /'[^'\n]*'/
NL: (/[ \t]*(--[^\n]*)?\r?\n/)+
"""

VPLUS = r"""
start: program+
program: ".PROGRAM" NAME "(" [NAME ("," NAME)*] ")" NL (stmt NL)* ".END" NL
stmt: "SPEED" NUMBER "ALWAYS" | "ACCEL" NUMBER "," NUMBER | "FINE" NUMBER "ALWAYS" | "CPOFF" "ALWAYS" | "BREAK"
    | "MOVE" "#PPOINT" "(" NUMBER ("," NUMBER)* ")" | "CALL" NAME "(" [NUMBER ("," NUMBER)*] ")" | "HERE" POINT
    | "LOCAL" NAME ["[" "]"] ("," NAME ["[" "]"])* | "DECOMPOSE" NAME "[" NUMBER "]" "=" POINT
    | "WAIT.EVENT" "," NUMBER | "SIGNAL" NUMBER | "PROMPT" STRING "," "$" NAME | "TYPE" item ("," item)*
    | "FOR" NAME "=" (NAME | NUMBER) "TO" (NAME | NUMBER) NL (stmt NL)* "END"
item: STRING | /\/[FIX]\d+(\.\d+)?/ | NAME ["[" NUMBER "]"]
POINT: /#\w+/
STRING: /"[^"\n]*"/
NL: (/[ \t]*(;[^\n]*)?\r?\n/)+
"""

INFORM = r"""
start: "/JOB" NL "//NAME" JOB NL "//POS" NL "///NPOS" NUMBER ("," NUMBER)~5 NL "///TOOL" NUMBER NL "///POSTYPE" "PULSE" NL "///PULSE" NL (POINT "=" NUMBER ("," NUMBER)* NL)+ "//INST" NL "///DATE" /\d{4}\/\d\d\/\d\d \d\d:\d\d/ NL "///ATTR" "SC,RW" NL "///GROUP1" "RB1" NL "NOP" NL (stmt NL)* "END" NL
stmt: "MOVJ" POINT "VJ=" NUMBER "PL=" NUMBER | "TIMER" "T=" NUMBER | "DOUT" "OT#(" NUMBER ")" ("ON" | "OFF") | "SET" /I\d{3}/ NUMBER | "PAUSE"
POINT: /C\d{5}/
JOB: /[A-Z0-9-]{1,8}/
NL: (/[ \t]*('[^\n]{0,32})?\r?\n/)+
"""

LS = r"""
start: "/PROG" NAME NL "/ATTR" NL (NAME "=" (STRING | GROUPS) ";" NL)* "/MN" NL (NUMBER ":" "J" "PR[" NUMBER "]" NUMBER "%" "FINE" /ACC\d+/ ";" NL)+ "/POS" NL "/END" NL
STRING: /"[^"\n]{0,16}"/
GROUPS: /[1*](,[1*]){4}/
NL: (/[ \t]*\r?\n/)+
"""

GRAMMARS = {".mod": RAPID, ".script": URSCRIPT, ".kl": KAREL, ".pg": VPLUS, ".jbi": INFORM, ".ls": LS}


def check(suffix: str, text: str) -> None:
    """Raises a lark error where a text is no program of its language."""
    Lark(GRAMMARS[suffix] + _COMMON, parser="earley").parse(text)
