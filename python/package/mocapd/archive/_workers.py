"""Runs tasks on the workers of a Ray cluster, or in this process."""

from __future__ import annotations

import logging
import os
import random
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from ._store import StoreError

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS = 5
"""Attempts of an operation whose store fails, and of a task whose worker dies: a task that was
running on a node that left the cluster succeeds elsewhere; one that fails five times will not succeed."""

WAIT_S = 0.5
"""Before the second attempt when a store failed; twice as long before each further one, 7.5 s in all."""

QUEUED_PER_WORKER = 3
"""Tasks that are handed to Ray for each worker: one that runs and two that wait, so that no worker waits for the driver."""


def run_tasks(
    run: Callable[[list[Item]], Result],
    items: Sequence[list[Item]],
    workers: int | None,
    lost: Callable[[Item, str], Result] | None = None,
) -> Iterator[tuple[list[Item], Result]]:
    """Calls a function for each list of items, on at most so many workers, and yields the lists with their results, as they
    are done. ``workers=0`` calls it in this process.

    If a worker dies, the items of its list follow one by one, so that others are not lost with one that needs too much
    memory; ``lost`` gives the result of an item that has ended its worker in each attempt, from the item and Ray's reason.

    Raises
    ------
    StoreError
        If the store of a task failed in each of its attempts, a worker died in each of them without ``lost``, or Ray cannot
        run tasks.
    """
    if workers == 0:
        for item in items:
            yield item, call(run, item)
        return
    import ray

    started = not ray.is_initialized()
    if started:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if not os.environ.get("RAY_ADDRESS"):
            options |= {"address": "local", "num_cpus": workers, "include_dashboard": False}
        # Ray's client, whose addresses are URLs, sends no folders.
        if "://" not in os.environ.get("RAY_ADDRESS", ""):
            options["job_config"] = _job_config()
        ray.init(**options)
    try:
        yield from _on_ray(ray, run, items, workers, lost)
    finally:
        if started:
            ray.shutdown()


def ended_process(what: str, reason: str) -> str:
    """The error of an item that is lost."""
    return f"{what} ended the process {ATTEMPTS} times, out of memory? {reason}"


def call(run: Callable[[Any], Result], item: Any) -> Result:
    """Calls a function again when its store fails."""
    for attempt in range(ATTEMPTS - 1):
        try:
            return run(item)
        except StoreError:
            time.sleep(WAIT_S * 2**attempt)
    return run(item)


def wait_at_random(attempt: int) -> None:
    """Before a further attempt where another process came first: each waits for another time, up to 4 s."""
    time.sleep(random.uniform(0, WAIT_S * min(2**attempt, 8)))


def _job_config() -> Any:
    """The configuration of a job whose workers import no modules from the current folder, which may have others' data.

    Ray adds that folder after the one of the driver's script, and has no option against it. To leave the folder while Ray
    starts is no way: names in the environment, such as that of a file with a key, may be relative, and workers stay in the
    folder in which Ray was started.
    """
    from ray.job_config import JobConfig

    class WithoutCurrentFolder(JobConfig):
        def _serialize(self) -> Any:
            folders = self._py_driver_sys_path
            if folders and folders[-1] == os.path.abspath(os.curdir):
                folders.pop()
            return super()._serialize()

    return WithoutCurrentFolder()


def _on_ray(ray: Any, run: Any, items: Any, workers: int | None, lost: Any) -> Iterator[Any]:
    # Put once: every task would otherwise carry the function with its data.
    shared = ray.put(run)
    # Ray would repeat a task whose worker was killed for its memory for ever.
    task = ray.remote(num_cpus=1, max_retries=0)(call)
    cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
    # Ray has no limit on the workers of a function: on a larger cluster, no more tasks than workers are handed out.
    queued_max = workers if workers and workers < cores else cores * QUEUED_PER_WORKER
    waiting: dict[Any, tuple[list[Any], int]] = {}
    ahead = iter(items)
    again: list[tuple[list[Any], int]] = []
    try:
        while True:
            while len(waiting) < queued_max:
                item, died = again.pop() if again else (next(ahead, None), 0)
                if item is None:
                    break
                waiting[task.remote(shared, item)] = item, died
            if not waiting:
                return
            done, _ = ray.wait(list(waiting), num_returns=1)
            for reference in done:
                item, died = waiting.pop(reference)
                try:
                    result = ray.get(reference)
                except ray.exceptions.RayTaskError as error:
                    if isinstance(error.cause, Exception):
                        raise error.cause from error
                    raise
                except ray.exceptions.RayError as error:
                    # Others, such as of an environment that cannot be set up, are of every task.
                    if not isinstance(error, _deaths(ray)):
                        raise StoreError(f"Ray cannot run a task: {type(error).__name__}: {error}") from error
                    if len(item) > 1:
                        again += [([one], 1) for one in item]
                        continue
                    if died + 1 < ATTEMPTS:
                        again.append((item, died + 1))
                        continue
                    if lost is None:
                        raise StoreError(f"a worker died {ATTEMPTS} times on the same task: {error}") from error
                    result = lost(item[0], _first_line(error))
                yield item, result
    finally:
        for reference in waiting:
            ray.cancel(reference, force=False)


def _deaths(ray: Any) -> tuple[type[Exception], ...]:
    """Ray's errors of a task whose worker or node ended, with the result that was there."""
    found = ray.exceptions
    return found.WorkerCrashedError, found.OutOfMemoryError, found.NodeDiedError, found.ObjectLostError


def _first_line(error: Exception) -> str:
    """Of what Ray says, which goes on with its configuration and lists of processes."""
    return f"{type(error).__name__}: {error}".splitlines()[0][:200]
