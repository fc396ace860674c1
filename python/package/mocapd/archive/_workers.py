"""Runs functions on a Ray cluster, or in this process."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from ._store import StoreError

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS = 5
"""Runs of a task, of which all but the last may end in a dead worker or a failing store. A node that leaves the cluster
takes a task with it once; a task that fails five times fails for a reason of its own."""

WAIT_S = 0.5
"""Before the second attempt when a store failed; twice as long before each further one, 7.5 s in all."""

QUEUED_PER_WORKER = 3
"""Tasks that are handed to Ray for each worker: one that runs and two that wait, so that no worker waits for the driver."""


def run_tasks(
    run: Callable[[Item], Result], items: Sequence[Item], workers: int | None
) -> Iterator[tuple[int, Result]]:
    """Calls a function for each item, on at most so many workers, and yields the indices of items with their results,
    as they are done. ``workers=0`` calls it in this process.

    Raises
    ------
    StoreError
        If the store of a task failed, or its worker died, in each of its attempts.
    """
    if workers == 0:
        for index, item in enumerate(items):
            yield index, call(run, item)
        return
    import ray

    started = not ray.is_initialized()
    if started:
        ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    try:
        yield from _on_ray(ray, run, items, workers)
    finally:
        if started:
            ray.shutdown()


def call(run: Callable[[Item], Result], item: Item) -> Result:
    """Calls a function again when its store fails."""
    for attempt in range(ATTEMPTS - 1):
        try:
            return run(item)
        except StoreError:
            time.sleep(WAIT_S * 2**attempt)
    return run(item)


def _on_ray(ray: Any, run: Callable[[Item], Result], items: Sequence[Item], workers: int | None) -> Iterator[Any]:
    # Put once: every task would otherwise carry the function with its data.
    shared = ray.put(run)
    task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(call)
    cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
    # Ray has no limit on the workers of a function: on a larger cluster, no more tasks than workers are handed out.
    queued_max = workers if workers and workers < cores else cores * QUEUED_PER_WORKER
    waiting: dict[Any, int] = {}
    ahead = iter(enumerate(items))
    try:
        while True:
            while len(waiting) < queued_max and (found := next(ahead, None)) is not None:
                index, item = found
                waiting[task.remote(shared, item)] = index
            if not waiting:
                return
            done, _ = ray.wait(list(waiting), num_returns=1)
            for reference in done:
                index = waiting.pop(reference)
                try:
                    result = ray.get(reference)
                except ray.exceptions.WorkerCrashedError as error:
                    message = f"a worker died {ATTEMPTS} times on the same files: see the logs of Ray"
                    raise StoreError(message) from error
                except ray.exceptions.RayTaskError as error:
                    raise error.cause from error
                yield index, result
    finally:
        for reference in waiting:
            ray.cancel(reference, force=False)

