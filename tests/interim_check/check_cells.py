"""The cell of checks: a plan whose arm and scanner are only simulated, without protocols."""

from pathlib import Path

import yaml

PLANS = Path(__file__).parents[2] / "plans"


def simulated_plan(folder: Path) -> Path:
    """plans/quick.yaml in a folder of its own."""
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text())
    plan["robot"] |= {"driver": "simulated", "options": {}, "model": str(PLANS / plan["robot"]["model"])}
    plan["scanner"] |= {"driver": "simulated", "options": {}}
    plan["artefacts"] = [str(PLANS / a) for a in plan["artefacts"]]
    (folder / "plan.yaml").write_text(yaml.safe_dump(plan))
    return folder / "plan.yaml"
