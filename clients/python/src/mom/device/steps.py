"""The steps of a verb: each is taken only if it may be, and a halt follows each that is taken after a halt."""

from __future__ import annotations

import asyncio
import inspect
import logging
from typing import Any, Callable, Generator, List, Optional

LOG = logging.getLogger("mom")

_MOST_ENDS = 8
"""How often something is told that it ends; each `finally` in another one may need it once."""


class Steps:
    """Goes on with something that can be awaited step by step, each only if it may be taken; cancels it otherwise."""

    def __init__(self, may_go_on: Callable[[], None], stand: Callable[[Steps], None]) -> None:
        self._ask, self._stand = may_go_on, stand
        self._found: Any = None
        self._steps: Any = None
        self._has_begun, self._is_given_up, self._is_undead = False, False, False
        self._until: Optional[float] = None
        """Until when it may clear up, by the loop's time."""
        self.is_halted = False
        """From then on it only clears up, and a halt follows each of its steps."""
        self.is_taken_over = False
        """Another velocity takes its motion over, so that none does."""

    def take(self, found: Any) -> None:
        """What is to be awaited."""
        self._found, self._steps = found, found.__await__()

    def halt(self, until: float, is_taken_over: bool) -> None:
        """It may clear up until then."""
        self.is_halted, self._until, self.is_taken_over = True, until, is_taken_over

    def may_go_on(self) -> bool:
        """Whether the next step may be taken."""
        if not self.is_halted:
            self._ask()
        return not self.is_halted

    async def run(self) -> Any:
        """Takes them."""
        return await self

    def drop_unbegun(self) -> None:
        """It was halted before its first step."""
        if not self._has_begun and inspect.iscoroutine(self._found):
            self._found.close()

    def give_up(self) -> bool:
        """Ends it, and lets it take no step any more; whether it took that for its end."""
        if self._is_given_up or self._steps is None:
            return not self._is_undead
        self._is_given_up = True
        if not self._has_begun:
            return True
        for _ in range(_MOST_ENDS):
            if self._close():
                return True
        _keep(self._steps)
        self._steps, self._found, self._is_undead = None, None, True
        return False

    def _close(self) -> bool:
        try:
            close = getattr(self._steps, "close", None)
            if close is not None:
                close()
            return True
        except RuntimeError:
            # It took that for something else.
            return False
        except BaseException as error:
            LOG.warning("a verb failed when the device had to stand", exc_info=error)
            return True
        finally:
            self._stand(self)

    def __await__(self) -> Generator[Any, Any, Any]:
        error: Optional[BaseException] = None
        while True:
            if not self.is_halted and not self.may_go_on():
                # It was cancelled just now: that comes with the next turn of the loop, once.
                error = (yield from self._turn(None)) or asyncio.CancelledError()
            if not isinstance(error, GeneratorExit) and self._is_late():
                self.give_up()
                # What it has waited for may have taken steps until now.
                self._stand(self)
                raise TimeoutError("it still took steps when the device had to stand")
            if isinstance(error, GeneratorExit):
                # Its loop is gone.
                self.give_up()
                raise error
            try:
                waits_for = self._step(error)
            except StopIteration as end:
                return end.value
            error = yield from self._turn(waits_for)

    def _is_late(self) -> bool:
        return self._is_given_up or (self._until is not None and asyncio.get_running_loop().time() > self._until)

    def _step(self, error: Optional[BaseException]) -> Any:
        self._has_begun = True
        try:
            return self._steps.throw(error) if error is not None else next(self._steps)
        finally:
            if self.is_halted:
                self._stand(self)

    def _turn(self, waits_for: Any) -> Generator[Any, Any, Optional[BaseException]]:
        """Lets the loop go on until what is waited for is there; gives what is to be raised then."""
        try:
            yield waits_for
        except BaseException as raised:
            return raised
        return None


def _keep(steps: Any) -> None:
    """Keeps what takes nothing for its end from ever being collected, also at the end of Python: by that it would get another turn."""
    _UNDEAD.append(steps)
    try:
        import ctypes

        ctypes.pythonapi.Py_IncRef(ctypes.py_object(steps))
    except (ImportError, AttributeError):
        LOG.warning("a verb that takes nothing for its end may get one more turn at the end of Python")


_UNDEAD: List[Any] = []
