"""Memory that pictures arrive in, lent out without a copy and taken back when nobody looks."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

RING_PICTURES = 17
"""How many pictures can be on their way or looked at; Aravis needs 8 of them on USB, one rests."""

KEPT_BACK = 9
"""When no more than these are left to arrive in, a picture is copied instead of lent."""


class Ring:
    """Slots of `size_bytes`; `push` hands a slot back to the camera.

    A view can end in any thread and in the middle of `take`, when Python collects garbage: there is
    no lock that such an end could wait for.

    The slot of the latest picture rests until the next one has arrived. Aravis hands a USB picture
    out before its callback is over, which then forgets the slot's buffer: one that was back by then
    would be filled and never come again (arv_uv_stream_trailer_cb, 0.8.26). Callbacks follow one
    another, so a later picture proves that it is over.
    """

    def __init__(self, size_bytes: int, push: Callable[[int], None]) -> None:
        self._size_bytes = size_bytes
        self._push = push
        self._slots = [np.empty(size_bytes, np.uint8) for _ in range(RING_PICTURES)]
        self._lent: set[int] = set()
        self._latest: int | None = None
        self._resting: set[int] = set()
        self._open = True

    @property
    def lent(self) -> int:
        """Return how many slots somebody looks at."""
        return len(self._lent)

    def address(self, slot: int) -> int:
        """Return where a slot lies in memory."""
        return int(self._slots[slot].ctypes.data)

    def arrived(self, slot: int) -> None:
        """Note that a slot holds the latest picture; those that rested go back."""
        self._latest = slot
        for rested in list(self._resting):
            self._resting.discard(rested)
            self._hand_back(rested)

    def take(self, slot: int, size_bytes: int) -> NDArray[np.uint8]:
        """Return the first bytes of a slot; the slot goes back when the last view of them is gone.

        While many slots are lent the bytes are copied, so that the camera never runs dry.
        """
        if self.lent >= RING_PICTURES - KEPT_BACK:
            copy = self._slots[slot][:size_bytes].copy()
            self.give_back(slot)
            return copy
        self._lent.add(slot)
        lease = (ctypes.c_uint8 * size_bytes).from_buffer(self._slots[slot].data)
        weakref.finalize(lease, self._returned, slot).atexit = False
        return np.frombuffer(memoryview(lease).cast("B"), np.uint8)

    def give_back(self, slot: int) -> None:
        """Let the camera use a slot again, that of the latest picture after the next one."""
        if slot == self._latest:
            self._resting.add(slot)
        else:
            self._hand_back(slot)

    def close(self) -> None:
        """Hand no slot back any more; views of lent ones stay valid."""
        self._open = False

    def _returned(self, slot: int) -> None:
        self._lent.discard(slot)
        self.give_back(slot)

    def _hand_back(self, slot: int) -> None:
        if self._open:
            self._push(slot)
