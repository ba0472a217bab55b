"""A Kalman filter of a disturbance, and chosen parameters beside it; by flight_filter.h and parameter_fit.h.

The disturbance has two parts by axis, accelerations beyond the model: one that stays (random walk), so that a constant
one leaves no error, and one that fades (first-order Gauss-Markov), so that a gust is not expected to last for a
horizon. Derived in docs/adaptation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.followed_parameters import FollowedParameter, Group, has_known_drag
from runtime.control.rti.solver import FADING, FILTER_SETTINGS, FOLLOWED, MAX_FOLLOWED, STAYING, RtiSolver

MAX_INTERVAL = 0.1  # s between two estimates, beyond which the filter goes on from the newer one


class FlightFilter:
    """Estimates what accelerates the vehicle beyond its model, and the parameters that are followed.

    A view of the filter in a solver's C code (flight_filter.h), for one model.

    staying, fading: (6,) parts of the disturbance, linear m/s^2 in world axes, then angular rad/s^2 in body axes.
    prior: (n,) values of the parameters before any flight.
    followed: (n,) whether the data can show a parameter now.
    trust: (2,) share with which what was estimated is flown: linear disturbance and parameters; angular disturbance.
    squares: (2, 2) mean square errors of forecasts, linear and angular, by what was estimated and by the file's model.
    rejected: number of estimates that jumped.
    """

    def __init__(
        self, solver: RtiSolver, settings: AdaptationSettings, parameters: Sequence[FollowedParameter] = ()
    ) -> None:
        """Raises RequestError for more parameters than the kernel has room for."""
        if len(parameters) > MAX_FOLLOWED:
            raise RequestError(
                f"{len(parameters)} parameters are to be followed in flight, at most {MAX_FOLLOWED} can."
            )
        self.settings, self.parameters = settings, tuple(parameters)
        self._solver = solver
        self._fill_options()
        last = FOLLOWED + len(self.parameters)
        self._spread = solver.filter_deviations[: len(self.parameters)]
        parts = slice(STAYING, FADING), slice(FADING, FOLLOWED), slice(FOLLOWED, last)
        self.staying, self.fading, self._moved = (solver.filter_state[part] for part in parts)
        self.trust, self.squares = solver.filter_trust, solver.filter_squares
        self.followed = solver.filter_followed[: len(self.parameters)]
        self.prior = np.array([p.value for p in self.parameters])
        self._scale = np.array([p.std for p in self.parameters])
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._solver.clear_filter()
        self.rejected = 0
        self._time = -np.inf

    def restart(self, state: Floats, time: float) -> None:
        """Go on from an estimate (nx,), as after a gap or where one jumped; what it estimates stays."""
        self._solver.restart_filter(state)
        self._time = time

    def compare(self, before: Floats, change: Floats, change_by_file: Floats, state: Floats, time: float) -> None:
        """Take an estimate (nx,) after the one before. change: (6,) of velocity and rate, by the model alone.

        change_by_file: by the model as it was trained.
        """
        if self._begins(time):
            self._count(self._solver.compare_in_filter(before, change, change_by_file, state, time - self._time), time)
        else:
            self.restart(state, time)

    def follow(
        self,
        before: Floats,
        speeds: Sequence[Sequence[float]] | Floats,
        seconds: Sequence[float] | Floats,
        state: Floats,
        time: float,
    ) -> None:
        """Take an estimate (nx,) after the one before. speeds: (k, n) rad/s, each acted for its seconds (k,)."""
        if self._begins(time):
            self._count(self._solver.follow(before, speeds, seconds, state), time)
        else:
            self.restart(state, time)

    def follow_commands(self, before: Floats, start: float, state: Floats, time: float) -> None:
        """Take an estimate (nx,) after the one before, of a time, by the solver's history of commands."""
        if self._begins(time):
            self._count(self._solver.follow_commands(before, start, state, time), time)
        else:
            self.restart(state, time)

    def _begins(self, time: float) -> bool:
        return 0 < time - self._time <= MAX_INTERVAL

    def _count(self, used: bool, time: float) -> None:
        self.rejected += not used
        self._time = time

    @property
    def values(self) -> Floats:
        """(n,) of the parameters."""
        return np.asarray(self.prior + self._scale * self._moved)

    @property
    def deviations(self) -> Floats:
        """(n,) standard deviations of the parameters."""
        return np.asarray(self._scale * self._spread)

    @property
    def disturbance_deviations(self) -> Floats:
        """(6,) standard deviations of the disturbance, the sum of both parts."""
        P, parts = self._solver.filter_covariance, (slice(STAYING, FADING), slice(FADING, FOLLOWED))
        variance = sum(np.diag(P[row, column]) for row in parts for column in parts)
        return np.sqrt(np.maximum(variance, 0.0))

    def _fill_options(self) -> None:
        options, settings = self._solver.filter_options, self.settings
        kinds = [settings.linear] * 3 + [settings.angular] * 3
        for name in ("measurement", "drift", "fading", "fading_time", "limit"):
            getattr(options, name)[:] = [getattr(kind, name) for kind in kinds]
        options.start[:] = [settings.start * kind.fading for kind in kinds]
        for name in FILTER_SETTINGS:
            setattr(options, name, getattr(settings, name))
        guard = settings.guard
        options.forecast, options.averaging, options.tolerance = guard.forecast, guard.averaging, guard.tolerance
        options.resolution[:] = guard.linear_resolution, guard.angular_resolution
        has_drag = bool(self.parameters) and has_known_drag(self._solver.model, settings.follow)
        options.known_drag = settings.known_drag if has_drag else 0.0
        options.count = len(self.parameters)
        for j, parameter in enumerate(self.parameters):
            options.prior[j], options.scale[j] = parameter.value, parameter.std
            options.lower[j], options.upper[j] = parameter.lower, parameter.upper
            options.index[j], options.group[j] = parameter.index, get_args(Group).index(parameter.group)
