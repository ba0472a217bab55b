"""Figures of the paper that ours stand beside: Saviolo, Li, Loianno, RA-L 2022, doi 10.1109/LRA.2022.3192609."""

from collections.abc import Mapping

# Table II, position RMSE in m of the real vehicle under MPC with the nominal and with the learned model: mean and
# standard deviation.
TRACKING_NOMINAL: Mapping[str, tuple[float, float]] = {
    "Ellipse_1": (0.061, 0.001),
    "Ellipse_2": (0.126, 0.011),
    "WarpedEllipse_1": (0.051, 0.012),
    "WarpedEllipse_2": (0.098, 0.014),
    "Lemniscate": (0.199, 0.032),
    "ExtendedLemniscate": (0.272, 0.033),
    "Parabola": (0.111, 0.006),
    "TransposedParabola": (0.322, 0.049),
}
TRACKING_LEARNED: Mapping[str, tuple[float, float]] = {
    "Ellipse_1": (0.059, 0.002),
    "Ellipse_2": (0.088, 0.023),
    "WarpedEllipse_1": (0.044, 0.009),
    "WarpedEllipse_2": (0.069, 0.017),
    "Lemniscate": (0.098, 0.011),
    "ExtendedLemniscate": (0.101, 0.019),
    "Parabola": (0.092, 0.021),
    "TransposedParabola": (0.162, 0.051),
}
