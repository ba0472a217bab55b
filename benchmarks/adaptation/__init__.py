"""A model that follows in flight: what its measurements share."""

from runtime.flight_setup import FOLLOWED

VEHICLE = "arpl_250g"
DRAG = ("rotor_drag", {"coefficient": 2.2e-5})
MANOEUVRES = (
    "hover",
    "Lemniscate",
    "Ellipse_1",
    "Ellipse_2",
    "circle",
    "line",
    "WarpedEllipse_1",
    "ExtendedLemniscate",
)
MODES = {"file": ("off", ()), "disturbance": ("on", ()), "named": ("on", FOLLOWED)}
