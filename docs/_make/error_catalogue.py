"""Every message that can end a command, with its exit code: read from the places in the code that raise it."""

from __future__ import annotations

import ast
from pathlib import Path

from mbcacq import errors
from mbcacq.errors import EXIT_CODE_MEANING, MbcacqError

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("mbcacq", *sorted(f"drivers/{path.name}" for path in (ROOT / "drivers").glob("mbcacq_*")))
CLASSES = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, MbcacqError)}


def error_catalogue() -> str:
    """Markdown: the messages by class of error, each with the module it comes from; parts that vary stand in braces."""
    found: dict[str, dict[str, str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            module = ".".join(path.relative_to(ROOT / package).with_suffix("").parts[:-1]) or path.stem
            for kind, text in raised(path):
                found.setdefault(kind, {}).setdefault(text, f"{package.split('/')[-1]}.{module}")
    out = [
        "# Errors and their cures",
        "",
        "Every message is one sentence: what happened, where, and what to do. This list is read from the code; what varies "
        "stands in braces. A sentence that begins in one place and is finished in another appears in its parts.",
        "",
    ]
    for name, kind in CLASSES.items():
        if name not in found:
            continue
        about = " ".join((kind.__doc__ or "").split())
        out += [f"## {name}", "", f"{about} Exit code {int(kind.exit_code)}: {EXIT_CODE_MEANING[kind.exit_code]}.", ""]
        rows = sorted(found[name].items(), key=lambda pair: (pair[1], pair[0]))
        out += ["| message | from |", "|---|---|", *(f"| {text} | `{module}` |" for text, module in rows)]
        out.append("")
    return "\n".join(out).rstrip() + "\n"


def raised(path: Path):
    """(class, message) of every ``raise Class("...")`` or construction of such an error in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CLASSES and node.args:
            text = template(node.args[0])
            if text:
                yield node.func.id, text.replace("|", r"\|").replace("<", "&lt;")


def shortened(node: ast.expr) -> str:
    """The last name in an expression: what stands there, without how it is computed."""
    if isinstance(node, ast.Attribute) and node.attr != "__name__":
        return node.attr
    if isinstance(node, ast.Name):
        return node.id
    names = [n for n in ast.walk(node) if isinstance(n, ast.Name) and n.id != "self" or isinstance(n, ast.Attribute) and n.attr[0] != "_"]
    return shortened(names[-1]) if names else "..."


def template(node: ast.expr) -> str:
    """The literal text of a string expression, its variable parts in braces; '' where nothing is literal."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        parts = [p.value if isinstance(p, ast.Constant) else "{" + shortened(p.value) + "}" for p in node.values]
        return "".join(parts) if any(isinstance(p, ast.Constant) and p.value.strip() for p in node.values) else ""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return ""
