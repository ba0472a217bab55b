"""Which sender of MAVLink heartbeats is a vehicle's autopilot: one rule for the link and for recorded frames.

MAVLink gives every component on a network a heartbeat. A camera, an ADS-B receiver or a winch may name an autopilot in
it (MAV_AUTOPILOT_GENERIC) and may speak first; its numbers are of minimal.xml and common.xml.
"""

from __future__ import annotations

from collections.abc import Iterable

AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID
KNOWN_AUTOPILOTS = {3: "ardupilotmega", 12: "px4"}  # MAV_AUTOPILOT
# MAV_TYPE of aircraft, and of a vehicle that is not described (0, generic); all others are ground stations, companions
# and peripherals, or move on land and water
AIRCRAFT = frozenset((0, 1, 2, 3, 4, 13, 14, 15, 16, 19, 20, 21, 22, 23, 24, 25, 29, 35, 43))


def is_autopilot(component: int, vehicle_type: int, autopilot: int) -> bool:
    """Whether a heartbeat is that of a vehicle's autopilot.

    It is an aircraft's, and the sender is the autopilot's own component or an autopilot of a known kind.

    component: MAVLink's component id of the sender. vehicle_type: MAV_TYPE. autopilot: MAV_AUTOPILOT.
    """
    if autopilot == NO_AUTOPILOT or vehicle_type not in AIRCRAFT:
        return False
    return component == AUTOPILOT_COMPONENT or autopilot in KNOWN_AUTOPILOTS


def first_vehicle(autopilots: Iterable[tuple[int, int]], system: int | None) -> tuple[int, int] | None:
    """The first of several autopilots, or the first with the system id that was chosen; None where there is none.

    autopilots: system and component of each, in the order in which they were heard.
    """
    return next((address for address in autopilots if system in (None, address[0])), None)
