"""The program of a device: whatever ends it, its devices are halted."""

from __future__ import annotations

import asyncio
import inspect
import logging
import signal
import threading
from typing import Any, Coroutine, List, Sequence, TypeVar

from ..core.devices import OBEYED

T = TypeVar("T")
LOG = logging.getLogger("mom")

_ENDS = ("SIGTERM", "SIGHUP", "SIGINT")


def run(main: Coroutine[Any, Any, T]) -> T:
    """Runs the program of a device as `asyncio.run` does, and ends it at SIGTERM and SIGHUP as at Ctrl-C: with its devices halted.

    `main` is cancelled then, as all else that runs; further signals end what does not end by that. The exit code is that of a program
    which the signal has ended, such as 143. What is ignored when it begins, as SIGHUP by `nohup`, goes on being ignored.

    Each device that has obeyed in it is halted once more when all of that has ended: what is cancelled or closed with the loop, such as
    a task that nobody awaited, may have moved it.
    """
    heard: List[int] = []
    before, OBEYED.devices = OBEYED.devices, {}
    try:
        found = asyncio.run(_heed(main, heard))
    except asyncio.CancelledError:
        if not heard:
            raise
    finally:
        devices, OBEYED.devices = list(OBEYED.devices.values()), before
        try:
            # Where it was interrupted before it began.
            main.close()
        finally:
            if devices:
                _halt(devices)
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


def _halt(devices: Sequence[Any]) -> None:
    """Has devices stand whose loop is gone, each, whatever it raises."""
    try:
        loop = asyncio.new_event_loop()
    except OSError:
        LOG.exception("no loop for the last halts")
        for device in devices:
            _stand(device)
        return
    try:
        loop.run_until_complete(_stand_all(devices))
    finally:
        loop.close()


async def _stand_all(devices: Sequence[Any]) -> None:
    for device in devices:
        found = _stand(device)
        if inspect.isawaitable(found):
            asyncio.ensure_future(_await(device, found))
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    if tasks:
        # What a halt has begun, too.
        _, late = await asyncio.wait(tasks, timeout=max(device.stops_within for device in devices) / 1000)
        if late:
            LOG.error("a halt at the end of the program does not end")


def _stand(device: Any) -> Any:
    try:
        return device.halt()
    except Exception:
        LOG.exception("the %s: it cannot be halted", device.called())


async def _await(device: Any, halting: Any) -> None:
    try:
        await halting
    except Exception:
        LOG.exception("the %s: it cannot be halted", device.called())
