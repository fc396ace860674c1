"""Clients that may wait for ever, in processes that can be ended."""

import multiprocessing


def in_child(function, *arguments, within_s):
    """The result of a function, which runs in a process of its own; an AssertionError if it fails or does not return in time."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def run():
        try:
            sender.send((True, function(*arguments)))
        except Exception as problem:  # the caller reports it
            sender.send((False, f"{type(problem).__name__}: {problem}"))

    process = context.Process(target=run)
    process.start()
    sender.close()
    try:
        if not receiver.poll(within_s):
            raise AssertionError(f"{function.__name__} has not ended after {within_s} s")
        has_succeeded, result = receiver.recv()
    except EOFError:
        raise AssertionError(f"{function.__name__} has ended without a result") from None
    finally:
        process.kill()
        process.join()
    if not has_succeeded:
        raise AssertionError(result)
    return result
