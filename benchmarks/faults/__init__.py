"""What the campaigns of faults share; ``system_call_faults.c`` is the library that is preloaded into the program under test.

``preloaded``: that library, and work in a child process. ``replayed_disk``: what a disk may hold after a power cut. ``small_run``: runs of
a small plan in processes of their own. ``strikes``: a command that is killed, finds the disk full, or loses what was not synchronised.
``replaced_outputs``, ``resumed_sessions`` and ``measured_checks`` are the kinds of such commands. ``replacing_commands`` are those of the
first kind, and ``command_inputs`` are their inputs.
"""
