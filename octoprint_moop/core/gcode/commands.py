"""Commands that lay nothing, and which of them a layer's retraction may have in its midst."""

from __future__ import annotations

# M codes and Klipper's words that neither move nor extrude nor wait.
QUIET_M = frozenset((73, 106, 107, 117, 118, 204, 205, 220, 221, 400, 486, 572, 593, 624, 625, 900))
QUIET_WORDS = frozenset(
    [
        "SET_VELOCITY_LIMIT",
        "SET_PRESSURE_ADVANCE",
        "SET_PRINT_STATS_INFO",
        "SET_FAN_SPEED",
        "SET_HEATER_TEMPERATURE",
        "SET_DISPLAY_TEXT",
        "SET_LED",
        "SET_PIN",
        "SET_GCODE_VARIABLE",
        "SET_INPUT_SHAPER",
        "SET_RETRACTION",
        "SET_IDLE_TIMEOUT",
        "SET_FILAMENT_SENSOR",
        "RESPOND",
        "UPDATE_DELAYED_GCODE",
    ]
)
# G codes and Klipper's words that move without a word about where, or not at all: homing's kin, probing, cleaning,
# parking, planes. What extrudes next says where it begins.
NO_PATH_G = frozenset((4, 11, 12, 17, 21, 26, 27, 29, 30, 31, 32, 33, 34, 60, 61, 80))
NO_PATH_WORDS = frozenset(
    [
        "TEMPERATURE_WAIT",
        "BED_MESH_CALIBRATE",
        "BED_MESH_PROFILE",
        "BED_MESH_CLEAR",
        "QUAD_GANTRY_LEVEL",
        "Z_TILT_ADJUST",
    ]
)
KEEPS_TAIL_G = frozenset((17,))
MEANT_M = frozenset((82, 83, 200, 221, 486))  # those that the interpreter does something with
