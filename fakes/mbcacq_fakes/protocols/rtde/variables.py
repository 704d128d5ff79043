"""The variables of RTDE that the fake controller knows, with their types, as the guide lists them."""

from __future__ import annotations

_BY_TYPE = {
    "DOUBLE": (
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage actual_robot_voltage "
        "actual_robot_current standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
        "tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar payload"
    ),
    "VECTOR6D": (
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current joint_control_output actual_TCP_pose "
        "actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage ft_raw_wrench "
        "payload_inertia actual_current_as_torque"
    ),
    "VECTOR3D": "actual_tool_accelerometer payload_cog elbow_position elbow_velocity",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage tool_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types output_bit_registers0_to_31 output_bit_registers32_to_63 "
    "tool_analog_input_types",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
    "VECTOR6INT32": "joint_mode",
}
OUTPUTS = {name: kind for kind, names in _BY_TYPE.items() for name in names.split()}
OUTPUTS |= {f"output_int_register_{k}": "INT32" for k in range(48)} | {f"output_double_register_{k}": "DOUBLE" for k in range(48)}
INPUTS = {f"input_int_register_{k}": "INT32" for k in range(48)} | {f"input_double_register_{k}": "DOUBLE" for k in range(48)}
INPUTS |= {f"{kind}_digital_output{part}": "UINT8" for kind in ("standard", "configurable") for part in ("", "_mask")}
FORMAT = {"UINT8": "B", "DOUBLE": "d", "VECTOR6D": "6d", "VECTOR3D": "3d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "VECTOR6INT32": "6i"}
WIDTH = {"VECTOR6D": 6, "VECTOR3D": 3, "VECTOR6INT32": 6}
