"""Processes that work beside this one, and end with it, however it ends."""

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import Pipe, get_context
from multiprocessing.connection import Connection


@contextmanager
def pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor of `count` processes; where what is inside is stopped, they are too, in mid-work.

    The processes hold one end of a pipe, this one the other, which the system closes where this one is killed. A
    Ctrl-C is for this one alone.
    """
    reader, writer = Pipe(duplex=False)
    with ProcessPoolExecutor(count, get_context("spawn"), initializer=_follow, initargs=(reader,)) as executor:
        try:
            with _deaf():  # which those that are started now inherit
                for _ in range(count):
                    executor.submit(os.getpid)
            yield executor
        except BaseException:
            writer.close()
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    reader.close()
    writer.close()


def _follow(reader: Connection) -> None:
    """End this process once the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait() -> None:
        try:
            reader.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _deaf() -> Iterator[None]:
    """Put off Ctrl-C, where the system can do that.

    Masked in this thread, whose mask new processes inherit. Another thread may take the signal all the same, and Python
    then tells the main one: there it is noted, and raised at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    heard: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _frame: heard.append(number)) if is_main else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_main:
            signal.signal(signal.SIGINT, handler)
    if heard:
        signal.raise_signal(signal.SIGINT)
