"""Why no vehicle was heard on a link, and what to check."""

from __future__ import annotations

from collections.abc import Mapping

from runtime.link.connection import Endpoint


def explain_silence(
    endpoint: Endpoint,
    timeout: float,
    *,
    target_system: int | None,
    heard: Mapping[tuple[int, int], str],
    skipped_bytes: int,
    refusals: str,
) -> str:
    """The text of an error.

    timeout: s that were waited. target_system: the vehicle's system id, if it was given. heard: kinds of the senders by
    system and component. skipped_bytes: that were no frame. refusals: of frames by their signatures, empty for none.
    """
    who = ", ".join(f"{system}/{component} ({what})" for (system, component), what in sorted(heard.items()))
    if refusals:
        accepted = f" Accepted (system/component): {who}." if heard else ""
        return f"No vehicle was accepted on {endpoint} within {timeout:g} s. {refusals}{accepted}"
    if target_system is not None and heard:
        return (
            f"No vehicle with system id {target_system} on {endpoint} within {timeout:g} s. "
            f"Heard (system/component): {who}. Give one of these, or leave the system id out."
        )
    if heard:
        return f"No autopilot's heartbeat on {endpoint} within {timeout:g} s. Heard (system/component): {who}."
    what = "bytes that are no MAVLink, wrong baud rate?" if skipped_bytes else "nothing at all"
    return (
        f"No MAVLink arrived on {endpoint} within {timeout:g} s ({what}). Check that the vehicle is on and "
        "sends here: PX4 sends its offboard link to UDP port 14540 (instance i to 14540 + i), 127.0.0.1 hears this "
        "machine alone (0.0.0.0 or --link with your own address: the network), a telemetry port "
        "needs MAV_1_CONFIG set and the same baud rate at both ends, and a firewall may drop UDP."
    )
