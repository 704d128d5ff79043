"""Faults that a running fake GoPxL sensor can be given."""

FAULTS = {
    "refuse_connections": "nothing listens on the control and the data port; connections that stand are kept",
    "silent": "set of paths that get no reply",
    "status": "dict of path to the status replied instead of executing the request",
    "close_control": "set of paths on which the control connection is closed",
    "notifications": "number of notifications and stream messages sent before every reply",
    "no_data": "exposures are made but no data set is sent",
    "stamp_only": "data sets hold only their stamp",
    "null_surface": "a null message with this status comes instead of the surface",
    "old_frame": "the stamp carries the frame index of long ago",
    "unknown_type": "a message of a type nobody knows comes before the surface",
    "short_message": "the surface message ends early, with a size field that agrees",
    "garbage": "random bytes instead of a message",
    "close_data": "the data connection is closed instead of sending",
    "close_in_message": "the data connection is closed in the middle of the surface message",
    "stall": "the data connection goes silent in the middle of the surface message",
    "restart": "counter and clock of the profiles begin anew",
}
