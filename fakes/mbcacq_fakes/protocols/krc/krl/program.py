"""KRL sources to Python generators. Whatever waits on the controller (motions, WAIT, HALT, BRAKE) is a ``yield``."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING, Any

from mbcacq_fakes.protocols.krc.krl import values as V
from mbcacq_fakes.protocols.krc.krl.expression import expression
from mbcacq_fakes.protocols.krc.krl.values import Cells, KrlError, fit

_DEF = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\(([^)]*)\)$", re.I)
_DECLARE = re.compile(
    r"(?:DECL\s+)?(?:GLOBAL\s+)?(INT|REAL|BOOL|CHAR|AXIS|E6AXIS|FRAME|EKI_STATUS)\s+(\w+)\s*(?:\[\s*(\d*)\s*\])?"
    r"\s*(?:=\s*(.+))?$",
    re.I,
)
_ASSIGN = re.compile(r"([$A-Za-z_][\w$.]*(?:\[[^=]*?\])?(?:\.\w+)*)\s*=(?!=)\s*(.+)$")
_EKI_GET = re.compile(r"(EKI_GET\w+)\s*\((.*),\s*([\w.\[\]]+)\s*\)$", re.I)
_INTERRUPT = re.compile(r"(?:GLOBAL\s+)?INTERRUPT\s+DECL\s+(\d+)\s+WHEN\s+(.+?)\s+DO\s+(\w+)\s*\(\s*\)$", re.I)
_BLOCKS = {"IF": "ENDIF", "LOOP": "ENDLOOP", "WHILE": "ENDWHILE", "FOR": "ENDFOR"}


class Resume(Exception):
    """RESUME: everything below the program that declared the interrupt is left."""


class Globals:
    """Variables of the data lists."""

    if TYPE_CHECKING:  # members are named by the programs

        def __getattr__(self, name: str) -> Any: ...

        def __setattr__(self, name: str, value: Any) -> None: ...


class Program:
    """``sources``: name -> text of .src, .sub and .dat files. ``system``: the $ variables; ``functions``: what is built in.

    A built-in is called with the interpreter first and is a generator function. Raises KrlError, naming file and line.
    """

    def __init__(self, sources: dict[str, str], system: Any, functions: dict[str, Any]) -> None:
        self.globals = Globals()
        self._types: dict[str, str] = {}
        self._functions: dict[str, Any] = dict(functions)
        self.called: dict[str, None] = {}
        self._space = {
            "V": V,
            "G": self.globals,
            "S": system,
            "F": self._functions,
            "fit": fit,
            "Cells": Cells,
            "Resume": Resume,
            "EkiOk": 0,
        }
        self._given = frozenset(functions)
        for name, text in sorted(sources.items(), key=lambda s: not s[0].lower().endswith(".dat")):
            self._read_data(name, text) if name.lower().endswith(".dat") else self._read_program(name, text)
        if missing := [name for name in self.called if name not in self._functions]:
            raise KrlError(f"there is no {', '.join(missing)}")

    def start(self, name: str, interpreter: Any) -> Generator[Any, Any, Any]:
        """A fresh run of a program without parameters."""
        return self._functions[name.lower()](interpreter)

    def _read_data(self, name: str, text: str) -> None:
        for number, line in _lines(text):
            try:
                if declared := _DECLARE.match(line):
                    kind, variable, size, value = declared.groups()
                    variable = variable.lower()
                    if hasattr(self.globals, variable):
                        raise KrlError(f"{variable} is declared twice")
                    self._types[variable] = kind.upper()
                    setattr(self.globals, variable, Cells(int(size)) if size else None)
                    if value:
                        self._assign_now(variable, value)
                elif assigned := _ASSIGN.match(line):
                    self._assign_now(*assigned.groups())
                elif not line.upper().startswith(("DEFDAT", "ENDDAT")):
                    raise KrlError("not understood")
            except KrlError as error:
                raise KrlError(f"{name}:{number}: {error}: {line}") from error

    def _assign_now(self, target: str, value: str) -> None:
        code = self._store(target, value, _Scope(self, {}))
        exec("\n".join(code), dict(self._space))

    def _store(self, target: str, value: str, scope: _Scope) -> list[str]:
        reference = expression(target, scope.name)
        kind = scope.kind(target)
        if got := _EKI_GET.match(value):
            into, into_kind = expression(got[3], scope.name), scope.kind(got[3])
            call = expression(f"{got[1]}({got[2]})", scope.name)
            return [f"{reference}, _got = {call}", "if _got is not None:", f"   {into} = fit({into_kind!r}, _got)"]
        return [f"{reference} = fit({kind!r}, {expression(value, scope.name)})"]

    def _read_program(self, name: str, text: str) -> None:
        body: list[tuple[int, str]] = []
        head: re.Match[str] | None = None
        for number, line in _lines(text):
            if (found := _DEF.match(line)) is not None:
                head, body = found, []
            elif line.upper() in ("END", "ENDFCT"):
                if head is None:
                    raise KrlError(f"{name}:{number}: {line} without DEF")
                self._define(name, head, body)
                head = None
            elif head is None:
                raise KrlError(f"{name}:{number}: outside of any DEF: {line}")
            else:
                body.append((number, line))
        if head is not None:
            raise KrlError(f"{name}: END of {head[1]} is missing")

    def _define(self, file: str, head: re.Match[str], body: list[tuple[int, str]]) -> None:
        function = head[1].lower()
        if function in self._functions and function not in self._given:
            raise KrlError(f"{file}: {function} is defined twice")
        parameters = [p.split(":")[0].strip().lower() for p in head[2].split(",") if p.strip()]
        scope = _Scope(self, dict.fromkeys(parameters, ""))
        code = [f"def {function}(P{''.join(', v_' + p for p in parameters)}):", "   if False: yield"]
        code += self._translate(file, function, body, scope)
        for parameter, kind in scope.local.items():
            if parameter in parameters:
                code.insert(2, f"   v_{parameter} = fit({kind!r}, v_{parameter})")
        space: dict[str, Any] = {}
        exec(compile("\n".join(code), f"<{file}:{function}>", "exec"), self._space, space)
        self._functions[function] = space[function]

    def _translate(self, file: str, function: str, body: list[tuple[int, str]], scope: _Scope) -> list[str]:
        """The Python lines of one DEF's body."""
        code: list[str] = []
        closers: list[str] = []
        guarded = any(_INTERRUPT.match(line) for _, line in body)
        for number, line in body:
            try:
                word = line.split("(")[0].split()[0].upper()
                if word in ("ELSE", *_BLOCKS.values()):
                    code += _close(word, closers)
                    continue
                new, opens = self._statement(line, word, scope)
            except KrlError as error:
                raise KrlError(f"{file}:{number}: {error}: {line}") from error
            if guarded and new and new[0].startswith("yield from F["):
                new = ["try:", "   " + new[0], "except Resume:", "   pass"]
            code += ["   " * (len(closers) + 1) + text for text in new]
            if opens:
                closers.append(_BLOCKS[word])
                code.append("   " * (len(closers) + 1) + ("P.turn()" if word in ("LOOP", "WHILE") else "pass"))
        if closers:
            raise KrlError(f"{file}: {function}: {closers[-1]} is missing")
        return code

    def _statement(self, line: str, word: str, scope: _Scope) -> tuple[list[str], bool]:
        """Python lines, and whether they open a block."""

        def read(text: str) -> str:
            return expression(text, scope.name)

        if (opened := _block(line, word, scope, read)) is not None:
            return [opened], True
        for lines in (self._declaration(line, word, scope, read), _wait(line, read), _motion(line, word, read)):
            if lines is not None:
                return lines, False
        if assigned := _ASSIGN.match(line):
            return self._store(assigned[1], assigned[2], scope), False
        if re.match(r"\w+\s*\(", line):
            return [read(line).removeprefix("(").removesuffix(")")], False
        raise KrlError("not understood")

    def _declaration(self, line: str, word: str, scope: _Scope, read: Callable[[str], str]) -> list[str] | None:
        if declared := _DECLARE.match(line):
            kind, variable, size, value = declared.groups()
            new = variable.lower() not in scope.local
            scope.local[variable.lower()] = kind.upper()
            start = f"Cells({int(size)})" if size else "V.Struct()" if kind.upper() in ("AXIS", "FRAME") else "None"
            return ([f"v_{variable.lower()} = {start}"] if new else []) + (self._store(variable, value, scope) if value else [])
        if found := _INTERRUPT.match(line):
            return [f"P.declare({found[1]}, lambda: {read(found[2])}, {scope.name(found[3], True)})"]
        if word == "INTERRUPT":
            _, state, number = line.upper().split()
            return [f"P.enable({int(number)}, {state == 'ON'})"]
        return None


def _close(word: str, closers: list[str]) -> list[str]:
    """ELSE, or the end of the innermost block, which is taken off ``closers``."""
    if not closers or word not in ("ELSE", closers[-1]):
        raise KrlError(f"{word} closes nothing")
    if word == "ELSE":
        return ["   " * len(closers) + "else:"]
    closers.pop()
    return []


def _block(line: str, word: str, scope: _Scope, read: Callable[[str], str]) -> str | None:
    """The Python line of a statement that opens a block."""
    if word == "IF" and line.upper().endswith("THEN"):
        return f"if V.logical({read(line[2:-4])})[0]:"
    if word == "LOOP":
        return "while True:"
    if word == "WHILE":
        return f"while V.logical({read(line[5:])})[0]:"
    if word == "FOR" and (parts := re.match(r"FOR\s+(\w+)\s*=\s*(.+?)\s+TO\s+(.+)$", line, re.I)):
        variable, low, high = parts.groups()
        return f"for {scope.name(variable, False)} in range({read(low)}, {read(high)} + 1):"
    return None


def _wait(line: str, read: Callable[[str], str]) -> list[str] | None:
    if line.upper().startswith("WAIT SEC"):
        return [f"yield 'wait', {read(line[8:])}"]
    if line.upper().startswith("WAIT FOR"):
        return [f"while not V.logical({read(line[8:])})[0]:", "   yield 'idle', None"]
    return None


def _motion(line: str, word: str, read: Callable[[str], str]) -> list[str] | None:
    """What moves the arm, stops it or leaves the program."""
    upper = line.upper()
    if word == "PTP":
        return [f"yield 'ptp', {read(line[3:])}"]
    if upper in ("HALT", "BRAKE"):
        return [f"yield {upper.lower()!r}, None"]
    if upper == "RESUME":
        return ["raise Resume"]
    if word == "RETURN":
        return [f"return {read(line[6:])}" if line[6:].strip() else "return"]
    return None


class _Scope:
    """What a name means inside one DEF."""

    def __init__(self, program: Program, local: dict[str, str]) -> None:
        self._program, self.local = program, local

    def name(self, name: str, call: bool) -> str:
        name = name.lower()
        if call:
            self._program.called.setdefault(name, None)
            return f"F[{name!r}]"
        if name in self.local:
            return f"v_{name}"
        if name == "ekiok":
            return "EkiOk"
        if not hasattr(self._program.globals, name):
            raise KrlError(f"{name} is not declared")
        return f"G.{name}"

    def kind(self, target: str) -> str:
        """The declared type behind a target; '' if any value may go."""
        found = re.match(r"\$?\w+", target)
        base = found[0].lower() if found else ""
        kind = self.local.get(base, self._program._types.get(base, ""))
        return "REAL" if "." in target.split("]")[-1] and kind in ("AXIS", "FRAME") else kind


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Statements with their line numbers, without comments, folds and file attributes."""
    if not text.isascii():
        raise KrlError("a program must be plain ASCII")
    for number, line in enumerate(text.splitlines(), 1):
        code = re.sub(r'("[^"]*")|;.*', lambda m: m[1] or "", line).strip()
        if code and not code.startswith("&"):
            yield number, code
