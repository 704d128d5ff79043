"""Faults that can be injected into a running fake sensor."""

FAULTS = {
    "refuse_connections": "nothing listens on control, health and data port; connections that stand are kept",
    "protocol_version": "(major, minor) reported instead of the real one",
    "model": "model number reported instead of the real one",
    "silent": "set of command numbers that get no reply",
    "status": "dict of command number to the status replied instead of executing it",
    "wrong_reply": "set of command numbers that are answered as if another command had been sent",
    "close_control": "set of command numbers on which the control connection is closed",
    "mute_health": "no health messages",
    "no_data": "exposures are made but no data set is sent",
    "stamp_only": "data sets hold only their stamp",
    "old_stamp": "data sets carry a time stamp of long ago",
    "unknown_type": "a message of an unknown type comes before the surface",
    "short_message": "the surface message ends early, with a size field that agrees",
    "shifted_surface": "one flipped bit in the header of the surface shifts it by 0.512 mm",
    "garbage": "random bytes instead of a message",
    "close_data": "the data connection is closed instead of sending",
    "close_in_message": "the data connection is closed in the middle of the surface message",
    "restart": "counter and clock of the profiles begin anew",
    "stall": "the data connection goes silent in the middle of the surface message",
}
