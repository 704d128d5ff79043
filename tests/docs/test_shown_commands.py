"""Every ``mbcacq`` command that a page shows and no test executes is one that the program has, with the options that it is shown with.

Commands that would move a real arm or take minutes stand in ``text`` blocks or in the running text.
"""

import ast
import re

import click
import pytest
from doc_pages import ROOT, pages

from mbcacq.cli.app import COMMANDS, app

BLOCK = re.compile(r"^```text\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`(mbcacq [a-z][^`\n]*)`")
PROGRAM = re.compile(r"^(?:\$ |\.venv/bin/)?(mbcacq [a-z].*)$", re.MULTILINE)


def commands(text):
    """The commands of the blocks, continued lines joined and comments left out, and those in the running text."""
    blocks = "\n".join(BLOCK.findall(text)).replace("\\\n", " ")
    shown = [found.partition("  #")[0].strip() for found in PROGRAM.findall(blocks)]
    return dict.fromkeys([*shown, *INLINE.findall(re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))])


SHOWN = [(page.name, command) for page in pages() for command in commands(page.text)]


def faults(command):
    """What of it the program does not have."""
    context, found, names = click.Context(app), app, set()
    for word in command.replace("|", " ").replace("…", " ").split()[1:]:
        if isinstance(found, click.Group) and not word.startswith("-"):
            known = found.get_command(context, word)
            if known is None:
                return [word] if word.islower() else []
            found = known
            names = {name for parameter in found.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help", "-h"}
        elif word.startswith("--") and word.partition("=")[0].rstrip(",.;:)") not in names | {"--version", "--debug"}:
            return [word]
    given = set(command.split())
    pasted = isinstance(found, click.Command) and re.search(rf" {found.name} [^ a-z-]*[A-Z./]", command)  # not its name in a sentence alone
    needed = [p for p in found.params if isinstance(p, click.Option) and p.required] if pasted else []
    return [p.opts[0] for p in needed if not given & set(p.opts)]


@pytest.mark.parametrize("page", sorted({name for name, _ in SHOWN}))
def test_the_commands_of_a_page_exist_with_their_options(page):
    assert {command: wrong for name, command in SHOWN if name == page and (wrong := faults(command))} == {}


def test_commands_are_found_in_blocks_and_in_the_text():
    text = "see `mbcacq data check X --nonsense`\n```text\nmbcacq check runs/latest \\\n  my.yaml --arm  # nightly\n```\n"
    assert list(commands(text)) == ["mbcacq check runs/latest    my.yaml --arm", "mbcacq data check X --nonsense"]
    assert faults("mbcacq check a b --arms") == ["--arms"]
    assert faults("mbcacq chek a") == ["chek"]
    assert faults("mbcacq controller-files PLAN") == ["--out"]
    assert faults("mbcacq controller-files") == []  # the name alone stands for the command


SOURCES = [path for room in ("mbcacq", "drivers", "fakes") for path in sorted((ROOT / room).rglob("*.py")) if ".venv" not in path.parts]
SAID = re.compile(r"mbcacq ((?:[a-z]+(?:-[a-z]+)*)(?: [-\w./]+)*)")


def proposed(path):
    """The commands in the sentences that a module can print, and those that it builds; X stands for what is known only then."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {
        id(n.body[0].value)
        for n in ast.walk(tree)
        if hasattr(n, "body") and isinstance(n.body, list) and n.body and isinstance(n.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "command_line":
            yield "mbcacq " + " ".join(str(a.value) if isinstance(a, ast.Constant) else "X" for a in node.args)
        elif isinstance(node, ast.JoinedStr):
            text = "".join(str(v.value) if isinstance(v, ast.Constant) else "X" for v in node.values)
            yield from (found[0] for found in SAID.finditer(text))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield from (found[0] for found in SAID.finditer(node.value))


@pytest.mark.parametrize("room", sorted({str(path.relative_to(ROOT).parent) for path in SOURCES}))
def test_the_commands_that_a_sentence_proposes_exist_with_their_options(room):
    here = [path for path in SOURCES if str(path.relative_to(ROOT).parent) == room]
    names = {*COMMANDS}
    said = {(path.name, command) for path in here for command in proposed(path) if command.split()[1] in names}
    assert {f"{name}: {command}": wrong for name, command in sorted(said) if (wrong := faults(command))} == {}
