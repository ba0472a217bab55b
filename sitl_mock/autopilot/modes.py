"""PX4's flight modes as they travel in HEARTBEAT's custom_mode, main << 16 | sub << 24, and in commands."""

from __future__ import annotations

from enum import Enum


class Mode(Enum):
    """A flight mode: (main mode, sub mode)."""

    MANUAL = (1, 0)
    ALTITUDE = (2, 0)
    POSITION = (3, 0)
    TAKEOFF = (4, 2)
    HOLD = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    ACRO = (5, 0)
    OFFBOARD = (6, 0)
    STABILIZED = (7, 0)

    @property
    def custom_mode(self) -> int:
        """The mode as HEARTBEAT's custom_mode."""
        main, sub = self.value
        return main << 16 | sub << 24

    @property
    def needs_pilot(self) -> bool:
        """Whether the mode flies by sticks; there is no pilot here."""
        return self.value[0] in (1, 2, 3, 5, 7)

    @property
    def prevents_arming(self) -> bool:
        """Whether PX4 refuses to arm in this mode; such a mode is also left when the vehicle disarms."""
        return self in (Mode.RTL, Mode.LAND, Mode.MISSION)


# HEARTBEAT.base_mode without the armed bit: custom 1, test 2, auto 4, guided 8, stabilised 16, manual input 64
CUSTOM, AUTO, GUIDED, STABILISED, MANUAL_INPUT, ARMED = 1, 4, 8, 16, 64, 128


def mode_from_command(base_mode: int, main: int, sub: int) -> Mode | None:
    """The mode of DO_SET_MODE's three parameters, None where PX4 has none."""
    if not base_mode & CUSTOM:
        return Mode.MISSION if base_mode & AUTO else Mode.STABILIZED if base_mode & STABILISED else Mode.MANUAL
    sub = (sub or Mode.MISSION.value[1]) if main == Mode.HOLD.value[0] else 0  # an auto mode without sub is a mission
    try:
        return Mode((main, sub))
    except ValueError:
        return None


def mode_from_custom(base_mode: int, custom_mode: int) -> Mode | None:
    """The mode of a SET_MODE message, None where PX4 has none."""
    return mode_from_command(base_mode, custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
