"""The paper's own figures, for comparison: Saviolo, Li, Loianno, RA-L 2022, doi 10.1109/LRA.2022.3192609."""

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

# Table I, RMSE of predicted accelerations on the real vehicle's test flights, linear and angular together. The starred
# models were trained in simulation alone.
PREDICTION: Mapping[str, Mapping[str, float]] = {
    "Ellipse_1": {
        "nominal": 0.40, "res_tcn": 0.07, "mse_tcn": 0.10, "pi_mlp*": 0.48, "pi_tcn*": 0.36, "pi_mlp": 0.25,
        "pi_tcn": 0.07,
    },
    "Ellipse_2": {
        "nominal": 1.49, "res_tcn": 0.21, "mse_tcn": 0.22, "pi_mlp*": 2.61, "pi_tcn*": 0.92, "pi_mlp": 0.73,
        "pi_tcn": 0.16,
    },
    "WarpedEllipse_1": {
        "nominal": 0.69, "res_tcn": 0.12, "mse_tcn": 0.21, "pi_mlp*": 0.93, "pi_tcn*": 0.53, "pi_mlp": 0.43,
        "pi_tcn": 0.11,
    },
    "WarpedEllipse_2": {
        "nominal": 2.02, "res_tcn": 0.99, "mse_tcn": 0.48, "pi_mlp*": 2.14, "pi_tcn*": 1.17, "pi_mlp": 1.01,
        "pi_tcn": 0.20,
    },
    "Lemniscate": {
        "nominal": 9.16, "res_tcn": 1.88, "mse_tcn": 1.39, "pi_mlp*": 9.19, "pi_tcn*": 5.73, "pi_mlp": 1.62,
        "pi_tcn": 0.39,
    },
    "ExtendedLemniscate": {
        "nominal": 1.34, "res_tcn": 1.01, "mse_tcn": 0.69, "pi_mlp*": 2.74, "pi_tcn*": 0.90, "pi_mlp": 0.49,
        "pi_tcn": 0.19,
    },
    "Parabola": {
        "nominal": 1.03, "res_tcn": 0.88, "mse_tcn": 0.33, "pi_mlp*": 2.17, "pi_tcn*": 0.77, "pi_mlp": 0.38,
        "pi_tcn": 0.15,
    },
    "TransposedParabola": {
        "nominal": 7.94, "res_tcn": 1.48, "mse_tcn": 1.01, "pi_mlp*": 9.01, "pi_tcn*": 3.46, "pi_mlp": 1.59,
        "pi_tcn": 0.51,
    },
}  # fmt: skip
# Table I, time of one prediction, ms, on the authors' laptop.
INFERENCE: Mapping[str, float] = {
    "nominal": 0.001,
    "res_tcn": 1.735,
    "mse_tcn": 1.735,
    "pi_mlp": 0.229,
    "pi_tcn": 1.735,
}
# Ablation: (history, physics-inspired loss) -> RMSE, mean and deviation over the test flights.
ABLATION: Mapping[tuple[bool, bool], tuple[float, float]] = {
    (True, True): (0.22, 0.15),
    (True, False): (0.55, 0.44),
    (False, True): (3.36, 1.21),
    (False, False): (3.52, 1.58),
}
# Choosing the history length (supplement): columns -> inference ms, RMSE mean and deviation.
HISTORY: Mapping[int, tuple[float, float, float]] = {
    20: (1.73, 0.23, 0.15),
    10: (1.55, 0.24, 0.22),
    4: (1.47, 0.82, 0.48),
    1: (1.42, 1.32, 1.01),
    0: (1.20, 3.36, 1.21),
}


def prediction_ratio(flight: str, kind: str) -> float | None:
    """The paper's RMSE over NOM's for a flight and a model, None for others. flight: a file's name."""
    row = PREDICTION.get(flight.split(".")[0], {})
    return row[kind] / row["nominal"] if kind in row else None
