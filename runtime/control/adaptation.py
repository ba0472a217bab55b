"""Lets a model follow the flight: a disturbance and chosen parameters, estimated from commands and estimates.

Offset-free MPC (Pannocchia and Rawlings 2003). Parameters of effects (wind, drag, ...) come from a fit over the last
seconds: what they explain leaves the disturbance, and what no data shows keeps its value.
Derived in docs/adaptation.md. Pure: times are arguments.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.state import ATTITUDE, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import GRAVITY
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.flight_filter import MAX_INTERVAL, FlightFilter
from runtime.control.followed_parameters import followed_parameters, rotor_loss_effect
from runtime.control.last_layer import LastLayer, rotation_of
from runtime.control.moment_fit import MomentFit, with_moments
from runtime.control.network_features import NetworkFeatures
from runtime.control.rotor_loss import RotorLoss
from runtime.control.rotor_watch import RotorWatch
from runtime.control.rti.solver import AXES, RtiSolver
from runtime.control.sag_fit import SagFit

REFUSED = 0.5  # share of what is estimated, below which it counts as not flown
MAX_PAUSE = 10.0  # s without an estimate, after which nothing that was estimated holds any more
SAME_TIME = 1e-6  # s
DESCRIBE_EVERY = 10  # commands
MOTION = np.r_[VELOCITY, RATE]
FLOWN_FADES = slice(AXES, 2 * AXES)  # of a solver's disturbance


class FollowedValue(msgspec.Struct, frozen=True):
    """A parameter that follows. before: as the flown model has it. std: standard deviation. unit: SI."""

    value: float
    std: float
    before: float
    unit: str


class Followed(msgspec.Struct, frozen=True):
    """Quantities that a model follows.

    parameters: by name, such as "wind.x".
    disturbance: (6,) accelerations beyond the model, linear m/s^2 in world axes, then angular rad/s^2 in body axes.
    trust: (2,) share with which this is flown: linear disturbance and parameters; angular disturbance.
    network_change: (3,) RMS over the training's inputs, m/s^2, of the change of a network's last layer; empty without.
    network_errors: (2,) of forecasts with that change and without, m/s^2.
    """

    parameters: dict[str, FollowedValue]
    disturbance: tuple[float, ...]
    trust: tuple[float, float]
    network_change: tuple[float, ...] = ()
    network_errors: tuple[float, ...] = ()


class Measured(NamedTuple):
    """An estimate with the model's hidden states at its time: state (nx,); predicted: (13,) of it, None to be found.

    view: what a network had as inputs then, None where its last layer does not follow.
    """

    time: float
    state: Floats
    predicted: Floats | None
    view: NetworkView | None = None


class NetworkView(NamedTuple):
    """Inputs of a network's last layer at an estimate.

    psi: (k,) whitened inputs of its last layer, as far as the network was flown.
    rotation: (3, 3) from its outputs' axes to the world's.
    flown: (3,) m/s^2, world, what the change of its last layer added.
    """

    psi: Floats
    rotation: Floats
    flown: Floats


class Adaptation:
    """Lets a solver's model follow the flight: commands and estimates in, disturbance and parameters out.

    changed: which parameters are surely not as in the model, with values and 95 % intervals; empty for none.
    newest: time of the last estimate, s, which a reset does not forget; -inf before the first.
    rotors: compares them with how the vehicle moves; None beside a learned model.
    network: what a learned model's last layer lacks; None where it does not follow.
    """

    def __init__(
        self,
        solver: RtiSolver,
        settings: AdaptationSettings,
        *,
        thrust_constants: Floats,
        period: float,
        learned: bool = False,
        features: NetworkFeatures | None = None,
    ) -> None:
        """thrust_constants: (n,) N s^2/rad^2. period: between commands, s.

        learned: whether predictions come with the estimates, from a learned model.
        features: by which its last layer follows, None where it does not.

        Raises RequestError for a kernel of an older version.
        """
        if not learned and not solver.follows:
            raise RequestError("the kernel is of an older version, whose models cannot follow. Export the model again.")
        self.network = None if features is None else LastLayer(features, settings)
        self._flown_change = np.zeros((0, 0)) if self.network is None else np.zeros_like(self.network.change)
        self.changed = ""
        priors = {"prior_scale": settings.prior_scale, "drag_share": settings.known_drag}
        parameters = () if learned else followed_parameters(solver.model, settings.follow, **priors)
        if not learned:
            parameters = with_moments(solver, parameters)
        self.filter = FlightFilter(solver, settings, parameters)
        self._moments, self._sag = MomentFit(solver, parameters), SagFit(parameters)
        self._solver, self._settings, self._learned = solver, settings, learned
        self._thrust_constants = thrust_constants
        self._highest_speed = solver.input_upper.copy()
        noise = settings.linear, settings.angular
        solver.disturbance[2 * AXES :] = [1 / kind.fading_time for kind in noise]
        watched = settings.rotors, self._moments
        self.rotors = None if learned else RotorWatch(solver, *watched, motor_lag=settings.motor_lag)
        self._drag_state = solver.model.initial_state(np.zeros(RIGID_BODY_STATES))  # rotors turn as in hover
        hover = solver.trim.rotor_speed
        weight = float(thrust_constants @ (hover * hover))  # N
        self._max_thrust = float(thrust_constants @ self._highest_speed**2) / weight  # thrust of all rotors, in weights
        self._available = self._max_thrust
        self._loss_effect = rotor_loss_effect(solver.model)
        if not learned:
            solver.begin_thrust(hover, lag=settings.thrust_lag, period=period)
        self._commands = 0
        self._last: tuple[float, Floats] | None = None
        self._sent: tuple[float, float] | None = None
        self.newest = -math.inf
        self._measured: Measured | None = None
        self._compared: Measured | None = None

    @property
    def followed(self) -> Followed:
        """Estimates so far."""
        filtered, layer = self.filter, self.network
        return Followed(
            dict(self.values),
            tuple((filtered.staying + filtered.fading).tolist()),
            (float(filtered.trust[0]), float(filtered.trust[1])),
            () if layer is None else tuple(np.linalg.norm(layer.change, axis=1).tolist()),
            () if layer is None else tuple(np.sqrt(layer.squares).tolist()),
        )

    @property
    def values(self) -> list[tuple[str, FollowedValue]]:
        """The parameters that are followed, then the losses of rotors that were named, by name."""
        filtered = self.filter
        parts = zip(filtered.parameters, filtered.values.tolist(), filtered.deviations.tolist(), strict=True)
        others = self._moments.named | self._sag.named
        named = ((p, *others.get(p.name, (value, std))) for p, value, std in parts)
        return [(p.name, FollowedValue(value, std, p.value, p.unit)) for p, value, std in named] + self.losses

    @property
    def losses(self) -> list[tuple[str, FollowedValue]]:
        """Losses of rotors that were named, by the name of the effect's parameter."""
        if self.rotors is None or self._loss_effect is None:
            return []
        effect, parameter = self._loss_effect
        named = ((f"{effect}[{loss.rotor}].{parameter}", loss) for loss in self.rotors.losses)
        return [(name, FollowedValue(loss.share, loss.deviation, 0.0, "1")) for name, loss in named]

    def load_of(self, loss: RotorLoss) -> float:
        """Mass under the rotor that would look the same, kg: its weight is the thrust that the rotor lost in hover."""
        hover = self._solver.trim.rotor_speed[loss.rotor]
        return float(loss.share * self._thrust_constants[loss.rotor] * hover * hover) / GRAVITY

    def specific_drag(self, state: Floats) -> float:
        """Specific force along body z that the model has beside its thrust, m/s^2: its drag, and not the disturbance.

        As far as it is flown; it would pass for effectiveness otherwise. What pushes along body z beyond the model is
        effectiveness: two estimates of one force would go wherever their difference takes them. 0 for a network's
        model. state: (13,).
        """
        if not self.flies or self._learned:
            return 0.0
        self._drag_state[:RIGID_BODY_STATES] = state
        return self._solver.specific_drag(self._drag_state, self._solver.trim.rotor_speed)

    def read_force(self, time: float, specific_force: float) -> None:
        """Take a specific force along body z, m/s^2, as it arrived; NaN when there is no new one."""
        if self.rotors is not None:
            self.rotors.read_force(time, specific_force)

    def read_rotors(self, time: float, speed: Floats, *, measured: bool) -> None:
        """Take speeds (n,) of all rotors, rad/s: of their ESCs, or as the autopilot's outputs command them."""
        if self.rotors is not None:
            self.rotors.read(time, speed, measured=measured)

    def _describe_changes(self) -> str:
        filtered, limit = self.filter, self._settings.drag_deviations
        if not filtered.parameters:
            return ""
        values, deviations = filtered.values.tolist(), filtered.deviations.tolist()
        parts = zip(filtered.parameters, values, deviations, filtered.followed.tolist(), strict=True)
        texts = [
            f"{p.name} {value:.3g} +- {2 * std:.2g} {p.unit}"
            for p, value, std, followed in parts
            if followed and abs(value - p.value) > limit * std
        ]
        texts += [
            f"{p.name} {value:.3g} +- {2 * std:.2g} {p.unit}"
            for fit in (self._moments, self._sag)
            for p, (value, std) in zip(fit.parameters, fit.named.values(), strict=True)
            if abs(value - p.value) > limit * std
        ]
        return ", ".join(texts)

    @property
    def refusal(self) -> str:
        """By how much forces and parameters forecast worse than the file's model; empty where most of them is flown."""
        if self.filter.trust[0] >= REFUSED:
            return ""
        own, file = self.filter.squares[0]
        return f"{math.sqrt(own / max(file, 1e-12)):.2g} times its error"

    @property
    def excess(self) -> str:
        """Push beyond the limit of the estimate, or of the thrust, in words; else empty."""
        staying, fading = self.filter.staying.tolist(), self.filter.fading.tolist()
        x, y, z = staying[0] + fading[0], staying[1] + fading[1], staying[2] + fading[2]
        needed = math.hypot(x, y, GRAVITY - z) / GRAVITY
        limit = self._settings.linear.limit
        if needed < self._available and abs(x) < limit and abs(y) < limit and abs(z) < limit:
            return ""
        return f"{math.hypot(x, y, z):.1f} m/s^2"

    @property
    def flies(self) -> bool:
        """Whether what is estimated is flown."""
        return self._settings.mode == "on"

    def read_voltage(self, time: float, voltage: float, effectiveness: float) -> None:
        """Take the battery's newest voltage, V, NaN for none, and the effectiveness of thrust in flight."""
        self._sag.add(time, voltage, effectiveness)

    def reset(self, time: float) -> None:
        """Forget commands and estimates; after a long pause what they showed, too."""
        self._last = self._sent = self._measured = self._compared = None
        if time - self.newest > MAX_PAUSE:
            self.filter.clear()
            if self.network is not None:
                self.network.clear()
                self._flown_change = np.zeros_like(self._flown_change)
            self._fly()
        self._commands = 0
        if not self._learned:
            self._solver.clear_thrust()
        if self.rotors is not None:
            self.rotors.clear()

    def command(self, time: float, speed: Floats) -> None:
        """Add rotor speeds (n,) rad/s that act from a time on."""
        self._last = time, speed

    def sent(self, collective_thrust: float, acts_at: float, effectiveness: float) -> None:
        """Tell what left in place of this tick's command, N, and from when on it acts, s.

        effectiveness: thrust per modelled thrust; below 1 the rotors do not give their thrust at full speed any more.
        """
        if self.flies:
            share = min(effectiveness, 1.0)
            np.multiply(self._highest_speed, math.sqrt(share), out=self._solver.input_upper)
            self._available = share * self._max_thrust
        self._sent = acts_at, collective_thrust

    def measure(self, time: float, state: Floats, predicted: Floats | None) -> None:
        """Take an estimate with the model's hidden states (nx,), to be compared by the next `update`."""
        self._measured, self.newest = Measured(time, state.copy(), predicted), time
        if self.rotors is not None:
            self.rotors.add_estimate(time, self._measured.state)

    def explain(self, time: float) -> None:
        """Take a network's inputs at an estimate: its features where a prediction from that time on began, s."""
        measured, layer = self._measured, self.network
        if layer is None or measured is None or measured.view is not None or time - measured.time > SAME_TIME:
            return
        solver = self._solver
        share, rotation = float(solver.certainty[1]), rotation_of(measured.state[ATTITUDE], body=layer.features.body)
        psi = share * layer.features.of(solver.last_input)
        change = solver.output_change[:3]
        flown = share * (rotation @ (change[:, :-1] @ solver.last_input + change[:, -1]))
        self._measured = measured._replace(view=NetworkView(psi, rotation, flown))

    def update(self) -> None:
        """Compare the last estimate with its prediction from the one before, and fly what follows."""
        self._add_command()
        if self.rotors is not None:
            self.rotors.update()
        before, now = self._compared, self._measured
        if now is None or (before is not None and now.time <= before.time):
            return
        self._compared = now
        if before is None or (self._learned and now.predicted is None):
            self.filter.restart(now.state, now.time)
            if self.network is not None:
                self.network.restart()
        elif now.predicted is not None:
            elapsed = now.time - before.time
            change = (now.predicted - before.state[:RIGID_BODY_STATES])[MOTION]
            change -= elapsed * (self._solver.disturbance[:AXES] + self._solver.disturbance[FLOWN_FADES])
            trained = change.copy()
            if before.view is not None:
                trained[:3] -= elapsed * before.view.flown
            self.filter.compare(before.state, change, trained, now.state, now.time)
            self._follow_network(before, now, trained)
        else:
            self.filter.follow_commands(before.state, before.time, now.state, now.time)
        if self._commands % DESCRIBE_EVERY == 0:
            self.changed = self._describe_changes()
        self._fly()

    def _follow_network(self, before: Measured, now: Measured, trained: Floats) -> None:
        """Let the last layer follow. trained: (6,) change of velocity and rate by the network as it was trained."""
        layer, elapsed = self.network, now.time - before.time
        if layer is None:
            return
        if before.view is None or elapsed > MAX_INTERVAL:
            layer.restart()
            return
        beyond = (now.state - before.state)[VELOCITY] - trained[:3]
        layer.add(beyond, before.view.psi, before.view.rotation, elapsed, float(self._solver.filter_level[0]))

    def _fly_network(self) -> None:
        """Give the solver the change of the last layer, and take what it adds now out of the disturbance."""
        layer, view = self.network, None if self._compared is None else self._compared.view
        if layer is None or view is None or self._settings.network.mode != "on":
            return
        share = min(layer.trust, float(self.filter.trust[0])) * layer.within(view.psi)
        change = share * layer.change
        self._solver.output_change[:3] = change @ layer.features.projection
        self.filter.staying[:3] -= view.rotation @ ((change - self._flown_change) @ view.psi)
        self._flown_change = change

    def _fly(self) -> None:
        """Give the solver what was estimated, as far as it is trusted."""
        if not self.flies:
            return
        if not self._learned:
            self._solver.fly(self._settings.moments)
            return
        self._fly_network()
        self._solver.fly_disturbance(self._settings.moments)

    def _add_command(self) -> None:
        """Let thrust follow the last command as it left, be it this controller's or one that it tracks."""
        last, sent = self._last, self._sent
        self._last = self._sent = None
        if sent is not None and (last is None or last[0] != sent[0]):
            self._compared = None  # a fallback that is no controller's command
        if last is None:
            return
        time, speed = last
        self._commands += 1
        if not self._learned:
            self._solver.add_thrust(time, speed, sent[1] if sent is not None and sent[0] == time else math.nan)
