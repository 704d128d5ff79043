"""Commands that replace what they wrote before from other data: how each is called, and which of its files belong together."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from bench import PLANS

import mbcacq
from faults.command_inputs import JOINTS, briefly_designed, copied_and_edited, finding_changes, make_torques, measure_checks, rehearsal
from faults.preloaded import called, command
from faults.replaced_outputs import EACH, Case
from mbcacq.simulation.model_match import ModelMatch

NEW_PLAN = ("plan", "new", "--robot", "kr6_r900_2", "--scanner", "gocator-3210", "--artefact", "mbc-8", "--poses", 6, "--stations", 2)
TRACKED, MOTION = ("--eye-to-hand", "--force"), ("--seconds", 5)
MEASURED = {"a": "run", "b": "mended"}
RUN_FILES = {"diagnosis": "diagnosis", "with-effects": "with-effects", "report.html": "report", "": ""}


def designed(*how: object, plan: str = "plan-a.yaml") -> Case:
    """A plan that ``plan design`` writes beside the plan that it begins with."""
    return Case(
        make=lambda of, f: command("plan", "design", f / plan, *how, "--seed", "ab".index(of), "--out", f / "chosen.yaml", "--force"),
        prepare=lambda folder: shutil.copy(folder.parent / plan, folder),
        sets={"chosen": "plan", "": ""},
        strikes=4,
    )


def matched_model(of: str) -> ModelMatch:
    """What ``diagnose --simulation`` found in a model file."""
    return ModelMatch(model="arm.xml", xml=f"<mujoco model='{of}'/>\n" * 1000, parameters=(), compared="poses", errors=())


def cases(work: Path) -> dict[str, Case]:
    """The commands by name."""
    force = ("--force", "--simulated-anyway")

    def copied(name: str) -> Callable[[Path], object]:
        return lambda folder: shutil.copytree(work / name, folder, dirs_exist_ok=True)

    def other(of: str) -> str:
        return "b" if of == "a" else "a"

    def held(of: str) -> tuple[str, ...]:
        return ("--hold", "d_2", "--hold", "a_3") if of == "a" else ()

    return {
        "correct": Case(
            make=lambda of, f: command("correct", work / "points.csv", "--with", work / f"{of}.json", "--out", f / "points.csv", *force)
        ),
        "apply": Case(
            make=lambda of, f: command(
                "apply", work / f"{of}.json", work / "scan.ply", f"--joints={JOINTS}", "--out", f / "s.ply", "--force"
            )
        ),
        "export --results": Case(make=lambda of, f: command("export", work / f"{of}.json", "--results", f, *force)),
        "export --observations": Case(make=lambda of, f: command("export", work / of, "--observations", f, "--force")),
        "calibrate --out": Case(make=lambda of, f: command("calibrate", work / of, "--out", f / "result.json"), strikes=4),
        "report": Case(make=lambda of, f: command("report", work / of, "--out", f / "report.html"), strikes=4),
        "fleet": Case(
            make=lambda of, f: command("fleet", work / f"arms-{of}", "--out", f, "--workers", 1),
            sets={"fleet": "fleet", "recordings/a": "first", "recordings/b": "second", "": ""},
            strikes=3,
        ),
        "diagnose --calibrate": Case(
            make=lambda of, f: command("diagnose", f, "--workers", 1, "--calibrate", *held(of)),
            prepare=copied("run"),
            sets=RUN_FILES,
            strikes=3,
            run_folder=True,
        ),
        "diagnose --out --report --rrd": Case(
            make=lambda of, f: command(
                "diagnose", work / "run", "--workers", 1, *held(of), "--out", f / "d.json", "--report", f / "e.html", "--rrd", f / "g.rrd"
            ),
            sets={"d.json": "json", "e.html": "page", "g.rrd": "recording", "": ""},
            strikes=2,
            runs=True,
        ),
        "diagnose --next": Case(
            make=lambda of, f: called(lambda: mbcacq.next_plan(work / MEASURED[of], f / "next.yaml")), runs=True, strikes=2
        ),
        "diagnose --write-model": Case(make=lambda of, f: called(lambda: matched_model(of).write(f / "found.xml"))),
        "compare --report": Case(
            make=lambda of, f: command("compare", work / f"{of}.json", work / f"{other(of)}.json", "--report", f / "changes.html")
        ),
        "simulate": Case(
            make=lambda of, f: command("simulate", PLANS / "quick.yaml", "--noise", "--seed", "ab".index(of), "--out", f, "--force")
        ),
        "robot import": Case(
            make=lambda of, f: command(
                "robot", "import", work / f"rows-{of}.csv", "--convention", "standard", "--out", f / "arm.yaml", "--force"
            )
        ),
        "plan new": Case(make=lambda of, f: command(*NEW_PLAN, "--seed", "ab".index(of), "--out", f / "plan.yaml", "--force")),
        "plan copy": Case(make=lambda of, f: command("plan", "copy", "kuka", f, "--force") if of == "b" else copied_and_edited("kuka", f)),
        "plan program": Case(
            make=lambda of, f: command("plan", "program", work / f"plan-{of}.yaml", "--for", "rapid", "--out", f, "--replace")
        ),
        "controller-files": Case(make=lambda of, f: command("controller-files", work / f"plan-{of}.yaml", "--out", f, "--replace")),
        "data new": Case(
            make=lambda of, f: command(
                "data", "new", work / f"hand-eye-{of}.csv", "--flange", "kuka", "--eye-in-hand", "--out", f, "--force"
            )
        ),
        "check --from": Case(
            make=lambda of, f: finding_changes(
                command("check", work / "a.json", work / "check.yaml", "--from", work / f"check-{of}", "--history", f / "history.json")
            ),
            prepare=lambda folder: measure_checks(work),
            sets={".run.lock": ""},
            strikes=3,
        ),
        "data merge": Case(
            make=lambda of, f: command(
                "data", "merge", *(work / f"{log}-{of}.csv" for log in ("arm", "tracker")), "--robot", "ur10e", *TRACKED, "--out", f
            )
        ),
        "plan check --fix": Case(
            make=lambda of, f: command("plan", "check", f / "plan.yaml", "--quick", "--fix") if of == "b" else lambda: None,
            prepare=lambda folder: shutil.copy(work / "far.yaml", folder / "plan.yaml"),
        ),
        "plan show --rrd": Case(make=lambda of, f: command("plan", "show", work / f"plan-{of}.yaml", "--rrd", f / "plan.rrd"), strikes=4),
        "plan design": designed("--poses", 6),
        "plan design --order": designed("--order", "--poses", 6, plan="ordered.yaml"),
        "plan design --motion": Case(
            make=lambda of, f: briefly_designed(
                command("plan", "design", PLANS / "quick.yaml", "--motion", work / f"torque-{of}", *MOTION, "--out", f / "m.csv", "--force")
            ),
            prepare=lambda folder: make_torques(work),
            strikes=3,
        ),
        "doctor --protocol": Case(make=lambda of, f: command("doctor", "--protocol", work / f"plan-{of}.yaml", "--out", f / "first.md")),
        "doctor --evidence": Case(
            make=lambda of, f: command("doctor", "--evidence", work / "run", *["--anonymous"] * (of == "b"), "--out", f / "evidence.json"),
            runs=True,
            strikes=4,
        ),
        "export --artefact": Case(
            make=lambda of, f: command("export", work / f"spheres-{of}.csv", "--artefact", "mbc", "--output", f / "mbc.yaml", "--force")
        ),
        "export --results --config-dat": Case(
            make=lambda of, f: command("export", work / f"{of}.json", "--results", f, "--config-dat", work / "config.dat", *force),
            strikes=4,
        ),
        "export --observations --scans": Case(
            make=lambda of, f: command("export", work / MEASURED[of], "--observations", f, "--scans", "--force"), runs=True, strikes=4
        ),
        "export --trajectory": Case(
            make=lambda of, f: command("export", work / MEASURED[of], "--trajectory", f, "--force"), runs=True, strikes=4
        ),
        "calibrate --l-curve": Case(
            make=lambda of, f: command("calibrate", work / of, "--method", "paper", "--l-curve", f / "l.html"), strikes=3
        ),
        "report --pdf": Case(make=lambda of, f: command("report", work / of, "--pdf", "--out", f / "report.pdf"), strikes=3),
        "view --screenshot": Case(
            make=lambda of, f: command("view", work / "run", "--screenshot", f, "--size", "400x300" if of == "a" else "500x300"),
            runs=True,
            strikes=2,
        ),
        "fakes --program": Case(
            make=lambda of, f: rehearsal(work / "plan-a.yaml", f, "ab".index(of)), sets={"clouds/": EACH, "": ""}, strikes=4
        ),
        "challenge --out": Case(
            make=lambda of, f: command("challenge", "--fast", "--count", 1, "--effects", "none", "--seed", "ab".index(of), "--out", f),
            sets={"000/observations": "observations", "000/": "diagnosis"},
            strikes=3,
        ),
        "recover": Case(
            make=lambda of, f: command("recover", f) if of == "b" else lambda: None,
            prepare=copied("torn"),
            sets={"run.recovered": "copy", "": ""},
            strikes=3,
            run_folder=True,
        ),
    }
