"""The queue between reader and loop holds frames and states, and never more than it may."""

import threading

import numpy as np
from rigs.wait import WITHIN_S

from drivers.frame import Frame
from drivers.pad.sensor import FrameQueue, SensorState


def frame(number: int) -> Frame:
    return Frame(number, number * 19, 0.0, np.zeros((8, 8), np.uint16))


def test_a_full_queue_drops_old_frames_but_no_state() -> None:
    queue = FrameQueue(4)
    down, up = SensorState("down", "unplugged"), SensorState("up", "back")
    for item in (down, frame(0), up, frame(1), frame(2), frame(3)):
        queue.put(item)
    assert len(queue) == 4
    assert queue.dropped == 2
    assert [queue.get(0.0), queue.get(0.0)] == [down, up]
    assert [item.number for item in (queue.get(0.0), queue.get(0.0)) if isinstance(item, Frame)] == [2, 3]
    assert queue.get(0.01) is None


def test_a_queue_of_nothing_but_states_is_bounded_too() -> None:
    queue = FrameQueue(3)
    for number in range(10):
        queue.put(SensorState("down", str(number)))
    assert len(queue) == 3
    assert queue.get(0.0) == SensorState("down", "7")


def test_a_waiting_reader_is_woken_by_the_next_item() -> None:
    queue = FrameQueue()
    threading.Timer(0.05, queue.put, [frame(7)]).start()
    item = queue.get(WITHIN_S)
    assert isinstance(item, Frame)
    assert item.number == 7
