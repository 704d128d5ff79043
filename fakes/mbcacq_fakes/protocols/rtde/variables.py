"""The variables of RTDE that the fake controller knows, with their types, as Universal Robots' guide lists them."""

from __future__ import annotations

from collections.abc import Iterator

REGISTERS = 48  # integers, and doubles; those from 24 on are for clients beside the fieldbus
SINGLE_BITS = range(64, 128)

_OUTPUTS_BY_TYPE = {
    "DOUBLE": (
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage actual_robot_voltage "
        "actual_robot_current joint_position_deviation_ratio payload tcp_force_scalar dexterity io_current "
        "standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1 tool_analog_input0 "
        "tool_analog_input1 tool_output_current tool_output_current_2 tool_temperature euromap67_24V_voltage euromap67_24V_current"
    ),
    "VECTOR6D": (
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current actual_current_window "
        "actual_current_as_torque joint_control_output joint_temperatures actual_joint_voltage actual_TCP_pose actual_TCP_speed "
        "actual_TCP_force target_TCP_pose target_TCP_speed tcp_offset payload_inertia ft_raw_wrench external_force_torque"
    ),
    "VECTOR3D": "actual_tool_accelerometer payload_cog elbow_position elbow_velocity",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage tool_output_voltage_2 encoder0_raw encoder1_raw",
    "UINT32": (
        "runtime_state robot_status_bits safety_status_bits script_control_line tool_mode analog_io_types tool_analog_input_types "
        "euromap67_input_bits euromap67_output_bits"
    ),
    "UINT64": (
        "actual_digital_input_bits actual_digital_output_bits actual_configurable_digital_input_bits "
        "actual_configurable_digital_output_bits"
    ),
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "VECTOR6INT32": "joint_mode",
}
_INPUTS_BY_TYPE = {
    "UINT32": "speed_slider_mask",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "UINT8": (
        "standard_digital_output standard_digital_output_mask configurable_digital_output configurable_digital_output_mask "
        "tool_digital_output tool_digital_output_mask standard_analog_output_mask standard_analog_output_type"
    ),
    "VECTOR6D": "external_force_torque",
}


def _registers(side: str) -> Iterator[tuple[str, str]]:
    """Those that a client writes (input) or the program on the controller (output)."""
    yield from ((f"{side}_int_register_{k}", "INT32") for k in range(REGISTERS))
    yield from ((f"{side}_double_register_{k}", "DOUBLE") for k in range(REGISTERS))
    yield from ((f"{side}_bit_registers{part}", "UINT32") for part in ("0_to_31", "32_to_63"))
    yield from ((f"{side}_bit_register_{k}", "BOOL") for k in SINGLE_BITS)


def _named(by_type: dict[str, str]) -> dict[str, str]:
    return {name: kind for kind, names in by_type.items() for name in names.split()}


INPUTS = _named(_INPUTS_BY_TYPE) | dict(_registers("input"))
OUTPUTS = _named(_OUTPUTS_BY_TYPE) | dict(_registers("output")) | dict(_registers("input"))  # what clients wrote is read back
FORMAT = {
    **{"BOOL": "?", "UINT8": "B", "INT32": "i", "UINT32": "I", "UINT64": "Q", "DOUBLE": "d"},
    **{"VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i"},
}
WIDTH = {"VECTOR6D": 6, "VECTOR3D": 3, "VECTOR6INT32": 6}
