"""Nothing but the atomic writer opens a file for writing, and no table that enters is read by another reader."""

import ast

from parsed import ROOT, nodes

PACKAGE = ROOT / "mbcacq"
WRITERS = {"write_text", "write_bytes", "savez", "savetxt", "savefig", "NamedTemporaryFile", "mkstemp"}
WRITERS |= {"write_html", "write_image", "write_table", "imsave", "tofile"}  # of plotly, pyarrow, matplotlib, numpy
WRITERS |= {"save", "FileSink"}  # of rerun: its writer ends at the first error, and a stream that shall write to it may wait for ever
# Streams that grow, locks and marks: what is not a file that leaves whole.
ALLOWED = {
    "files/atomic_write.py": "the writer itself",
    "recording/run_folder/lock.py": "the name of the owner of a lock, which goes with it",
    "recording/run_folder/latest.py": "the mark of the latest run, in place of a link",
    "recording/run_folder/journal.py": "a journal: lines are added, each with its checksum and synced",
    "recording/run_folder/recovery.py": "a temporary copy that is merged and removed",
    "recording/rrd/checksums.py": "lines are added, each with its own checksum",
    "recording/rrd/new_stream.py": "the temporary path that the atomic writer gave, and publishes",
    "cli/diagnose.py": "the page of a diagnosis, whose own method hands it to the atomic writer",
    "fleet/store.py": "the temporary path that the atomic writer gave, and publishes",
    "recording/rrd/scan_export.py": "temporary paths that the atomic writer gave, and publishes",
    "recording/rrd/sink.py": "the recording of a run, which grows; a disk that takes nothing is refused before",
    "parts/merge.py": "blocks in a temporary folder, and the temporary path that the atomic writer gave",
    "recording/rrd/quiet_environment.py": "settings in a temporary folder of the process",
}


def opens_for_writing(call: ast.Call) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if name in WRITERS:
        return True
    if name != "open":
        return False
    modes = [a.value for a in [*call.args, *(k.value for k in call.keywords)] if isinstance(a, ast.Constant) and isinstance(a.value, str)]
    return any(set(mode) & set("wax+") and set(mode) <= set("rwxabt+") for mode in modes)


def test_only_the_atomic_writer_opens_files_for_writing():
    calls = ((path, node) for path, node in nodes(ast.Call) if path.is_relative_to(PACKAGE))
    found = {path.relative_to(PACKAGE).as_posix() for path, node in calls if opens_for_writing(node)}
    assert found
    assert found - set(ALLOWED) == set()
