"""Every parser of bytes from outside, by name; each kind of source has a file of its own."""

from __future__ import annotations

from functools import cache

from fuzz_bags import bag_targets
from fuzz_clouds import cloud_targets
from fuzz_descriptions import description_targets
from fuzz_files import file_targets
from fuzz_instruments import instrument_targets
from fuzz_programs import program_targets
from fuzz_tables import table_targets
from fuzz_target import Target
from fuzz_wire import wire_targets

SOURCES = (wire_targets, file_targets, table_targets, instrument_targets, program_targets, description_targets, cloud_targets, bag_targets)


@cache
def targets() -> dict[str, Target]:
    """Every parser, in the order of the page."""
    return {target.name: target for source in SOURCES for target in source()}
