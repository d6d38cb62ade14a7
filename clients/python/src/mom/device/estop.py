"""The emergency stop at the device itself: what its button says, and what the hub does not know of it yet."""

from __future__ import annotations

from typing import Optional

from ..events import Event, LinkDown, Message, Rejoined


class Estop:
    """Whether it is pressed, and whether the hub owes a number for that.

    Each press and each reset is a stop of its own, also of a device that is stopped already, so that an `unstop` said before it lifts
    nothing: until the hub has given the device's own stop a number, no `unstop` lets it go.
    """

    def __init__(self) -> None:
        self.known: Optional[bool] = None
        """What the device has said last; `None`: it knows of no such button."""
        self.owed: Optional[str] = None
        """Why nothing lets the device go: it has stopped itself, and the hub has not given that a number."""
        self._said: Optional[int] = None
        """The id of the newest message that says so."""
        self._linked = True

    @property
    def is_pressed(self) -> bool:
        """Whether it is pressed."""
        return self.known is True

    def look(self, known: Optional[bool]) -> Optional[str]:
        """Takes in what the device says of its button; why it has to stop, if that is another thing than before."""
        was_pressed, self.known = self.is_pressed, known
        if was_pressed == self.is_pressed:
            return None
        self.owed, self._said = f"its emergency stop was {'pressed' if self.is_pressed else 'reset'}", None
        return self.owed

    def hear(self, event: Event, name: Optional[str], is_back: bool) -> None:
        """Takes in an event of the device's channel, where it is called so; `is_back`: its link is."""
        if isinstance(event, LinkDown):
            self._linked = False
        elif is_back or isinstance(event, Rejoined):
            self._linked = True
        elif isinstance(event, Message) and event.name == "stop" and event.parcel.sender == name:
            # Its own stop comes back with a number; one that was said for an earlier press says nothing of this one.
            if self._said is not None and event.parcel.id is not None and event.parcel.id >= self._said:
                self.owed = None

    def to_say(self) -> Optional[str]:
        """Why it is to be said now that it has stopped itself, if that is so: it is said again when a lost link is back."""
        return self.owed if self._linked else None

    def said(self, number: Optional[int]) -> None:
        """It was said by a message of this id."""
        self._said = number
