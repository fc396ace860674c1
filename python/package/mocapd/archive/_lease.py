"""Leases: objects that say that a process adds takes to an archive, so that none of them is collected before its row is
there.
"""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ._store import Entry, Store, StoreError

FOLDER = "writing"

RENEWED_S = 20 * 60.0
"""Time after which a lease is renewed. A thread does it, so that it does not depend on how long a task lasts."""

DEAD_S = 3 * RENEWED_S
"""Age of a lease whose process is gone: it would have been renewed twice, with a third for the clocks of two machines."""


@contextmanager
def writing(store: Store) -> Iterator[None]:
    """Holds a lease. It is left if the process is killed, and dead an hour later."""
    run, ended = uuid.uuid4().hex, threading.Event()
    held = [f"{FOLDER}/{run}-0"]
    text = f"{socket.gethostname()}, process {os.getpid()}\n".encode()
    store.put_if_absent(held[0], text)

    def renew() -> None:
        number = 0
        while not ended.wait(RENEWED_S):
            number += 1
            with suppress(StoreError, OSError):
                store.put_if_absent(f"{FOLDER}/{run}-{number}", text)
                held.append(f"{FOLDER}/{run}-{number}")
                store.remove(held.pop(0))

    renewing = threading.Thread(target=renew, name="mocapd-archive-lease", daemon=True)
    renewing.start()
    try:
        yield
    finally:
        ended.set()
        renewing.join()
        with suppress(StoreError, OSError):
            for name in held:
                store.remove(name)


def leases(store: Store) -> list[Entry]:
    """The leases that are held."""
    now_s = time.time()
    return [entry for entry in store.list(f"{FOLDER}/") if entry.modified_s is None or now_s - entry.modified_s < DEAD_S]
