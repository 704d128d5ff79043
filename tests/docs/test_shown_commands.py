"""Every ``mbcacq`` command that a page shows and no test executes is one that the program has, with the options that it is shown with.

Commands that would move a real arm or take minutes stand in ``text`` blocks or in the running text.
"""

import re

import click
import pytest
from doc_pages import pages

from mbcacq.cli.app import app

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
    return []


@pytest.mark.parametrize("page", sorted({name for name, _ in SHOWN}))
def test_the_commands_of_a_page_exist_with_their_options(page):
    assert {command: wrong for name, command in SHOWN if name == page and (wrong := faults(command))} == {}


def test_commands_are_found_in_blocks_and_in_the_text():
    text = "see `mbcacq data check X --nonsense`\n```text\nmbcacq check runs/latest \\\n  my.yaml --arm  # nightly\n```\n"
    assert list(commands(text)) == ["mbcacq check runs/latest    my.yaml --arm", "mbcacq data check X --nonsense"]
    assert faults("mbcacq check a b --arms") == ["--arms"]
    assert faults("mbcacq chek a") == ["chek"]
    assert faults("mbcacq plan design PLAN --order") == []
