"""The program of a device: whatever ends it, its devices are halted."""

from __future__ import annotations

import asyncio
import signal
import threading
from typing import Any, Coroutine, List, TypeVar

T = TypeVar("T")

_ENDS = ("SIGTERM", "SIGHUP", "SIGINT")


def run(main: Coroutine[Any, Any, T]) -> T:
    """Runs the program of a device as `asyncio.run` does, and ends it at SIGTERM and SIGHUP as at Ctrl-C: with its devices halted.

    `main` is cancelled then, as all else that runs; further signals end what does not end by that. The exit code is that of a program
    which the signal has ended, such as 143. What is ignored when it begins, as SIGHUP by `nohup`, goes on being ignored.
    """
    heard: List[int] = []
    try:
        found = asyncio.run(_heed(main, heard))
    except asyncio.CancelledError:
        if not heard:
            raise
    finally:
        # Where it was interrupted before it began.
        main.close()
    if heard:
        _end_by(heard[0])
    return found


async def _heed(main: Coroutine[Any, Any, T], heard: List[int]) -> T:
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(main)

    def end(number: int) -> None:
        heard.append(number)
        if len(heard) > 1:
            _end_by(heard[0])
        task.cancel()

    if threading.current_thread() is threading.main_thread():
        for name in _ENDS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                _on_signal(loop, number, end)
    return await task


def _on_signal(loop: asyncio.AbstractEventLoop, number: int, end: Any) -> None:
    try:
        loop.add_signal_handler(number, end, number)
    except NotImplementedError:
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(end, number))


def _end_by(number: int) -> None:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)
