"""``mbcacq schema``: the JSON Schema of a plan, for editors that complete and check YAML."""

from __future__ import annotations

import json

from mbcacq.cli.declared import argument, subcommand
from mbcacq.cli.terminal import echo


@subcommand("schema")
def command(kind: str = argument(["plan", "robot", "artefact"], default="plan")) -> None:
    """Print the JSON Schema of a plan, a robot or an artefact file.

    In VS Code (YAML extension): write it to plan.schema.json and put
    `# yaml-language-server: $schema=plan.schema.json` on the first line of the plan. It knows the options of every installed driver.
    """
    from mbcacq.devices.options_schema import with_driver_options
    from mbcacq.model.cell_schema import ArtefactSpec, RobotSpec
    from mbcacq.plan.schema import Plan

    model = {"plan": Plan, "robot": RobotSpec, "artefact": ArtefactSpec}[kind]
    content = model.model_json_schema()
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **(with_driver_options(content) if kind == "plan" else content)}
    echo(json.dumps(schema, indent=1))
