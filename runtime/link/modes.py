"""PX4's flight modes: numbers in a heartbeat's custom_mode and names (PX4 px4_custom_mode.h)."""

from __future__ import annotations

OFFBOARD = "OFFBOARD"
MAIN_MODES: dict[int, str] = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: OFFBOARD, 7: "STABILIZED", 8: "RATTITUDE",
    9: "SIMPLE", 10: "TERMINATION", 11: "ALTITUDE_CRUISE",
}  # fmt: skip
AUTO_MODES: dict[int, str] = {
    1: "READY", 2: "TAKEOFF", 3: "HOLD", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW_TARGET", 9: "PRECLAND",
    10: "VTOL_TAKEOFF",
}  # fmt: skip
_NUMBERS: dict[str, tuple[int, int]] = {
    **{name: (main, 0) for main, name in MAIN_MODES.items() if main != 4},
    **{name: (4, sub) for sub, name in AUTO_MODES.items()},
}


def split_custom_mode(custom_mode: int) -> tuple[int, int]:
    """Main and sub mode of a heartbeat's custom_mode."""
    return custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF


def mode_name(main: int, sub: int) -> str:
    """The name of a mode, such as OFFBOARD, HOLD, RTL or LAND."""
    if main == 4:
        return AUTO_MODES.get(sub, f"AUTO_{sub}")
    name = MAIN_MODES.get(main, f"MODE_{main}")
    return f"{name}_{sub}" if sub else name


def mode_numbers(name: str) -> tuple[int, int]:
    """Main and sub mode of a name. Raises KeyError for a name that PX4 does not have."""
    return _NUMBERS[name.upper()]
