"""The interface of a link to one vehicle, over a wire against the clock or in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from runtime.link.dialect import Message
from runtime.link.estimate import StateEstimate
from runtime.link.peer import Peer
from runtime.link.telemetry import VehicleStatus

Answer = TypeVar("Answer")
ATTEMPTS = 4  # of a request
NO_ANSWER = "no_answer"  # result of a request that no attempt brought an answer to


class VehicleLink(Protocol):
    """Needs of commands, parameters and the control loop of a link.

    peer: the vehicle, as far as it was heard.
    """

    peer: Peer

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's identity and state."""

    @property
    def own_system(self) -> int:
        """Our system id."""

    @property
    def own_component(self) -> int:
        """Our component id."""

    @property
    def estimate(self) -> StateEstimate | None:
        """The newest accepted estimate."""

    def is_connected(self, now: float) -> bool:
        """Whether the vehicle was heard recently. now: s on the link's clock."""

    def wait_for_estimate(self, newer_than: StateEstimate | None, deadline: float) -> StateEstimate | None:
        """The newest estimate as soon as it is not `newer_than`, or None at the deadline (s, the link's clock)."""

    def send(self, message: Message) -> bool:
        """Send a message under our ids. Returns whether it left."""

    def send_rate_setpoint(self, rate_body: tuple[float, float, float], thrust: float) -> bool:
        """Send SET_ATTITUDE_TARGET with body rates, FLU, rad/s, and thrust, 0..1."""

    def exchange(
        self,
        request: Callable[[int], Message],
        read: Callable[[Message], Answer | None],
        *,
        timeout: float = 0.5,
        attempts: int = ATTEMPTS,
    ) -> Answer | None:
        """The first answer to a request that is repeated; None after all attempts."""
