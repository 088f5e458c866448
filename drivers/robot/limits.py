"""How long the robot may take, how often it is asked, and how much is kept for it."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every wait and every buffer of the link to the robot, in seconds unless named otherwise.

    connect_s, service_s, call_s: for a connection, for the proxy of a service, for any call on the event path
    (measured: 12 ms, 1 ms and 0.3 ms on loopback; a robot on a bad network needs a hundred times that).
    action_s: for one action; speech and behaviours answer only when they are over, a dance after a minute.
    stale_s: what has waited longer than this is dropped, since a late answer is worse than none.
    heartbeat_s: the robot is asked something after this much silence. With call_s it bounds how long a hang
    goes unnoticed, because a hung robot still looks connected.
    shown_s: how long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does it.
    backoff_first_s, backoff_cap_s: pause before another attempt, doubling from the one to the other. The cap
    bounds how long a robot that is back goes unnoticed.
    capacity: messages, or reactions, that wait at most; the oldest is dropped.
    """

    connect_s: float = 3.0
    service_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 120.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    shown_s: float = 1.0
    backoff_first_s: float = 0.1
    backoff_cap_s: float = 1.0
    capacity: int = 64
