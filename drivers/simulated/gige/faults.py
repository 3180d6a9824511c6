"""What can go wrong with a camera on the network, on demand."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Faults:
    """Faults of one camera; each count is worked off, each switch stays until it is turned back.

    Set them from any thread: the server looks at them when their moment comes.
    """

    lose_edges: int = 0
    """Edges that do not reach the input line."""
    ignore_triggers: int = 0
    """Triggers that arrive and start no exposure."""
    lose_pictures: int = 0
    """Pictures that are exposed and never sent."""
    lose_packets: int = 0
    """Packets in the middle of pictures that are not sent; a client may ask for them again."""
    refuse_resend: bool = False
    """Whether packets that were lost stay lost."""
    reorder_packets: bool = False
    """Whether neighbouring packets change places."""
    unplugged: bool = False
    """Whether the cable is out; the camera wakes up anew when it comes back."""
    drop_control: bool = False
    """Whether the camera forgets its client once, as after heartbeats that were not heard."""
